"""From the process image to what control reads: tared tensions, drum rates, and which cables still
have fresh measurements behind them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.control import Control
from tonus.config.schema.robot import Robot
from tonus.drivers.process_image import NEVER, ProcessImage
from tonus.runtime.control.filters import ButterworthBank

Array = NDArray[np.float64]
_MISSING = -1
_CLOSEST = 0.25
"""of a period: samples that are closer tell no rate"""


@njit(cache=True)
def _drum_rates(
    angle: Array,
    age: NDArray[np.uint16],
    sampled_ns: NDArray[np.int64],
    tick: int,
    limits: tuple[float, Array],
    last: Array,
    sampled: tuple[NDArray[np.int64], NDArray[np.int64]],
    rate: Array,
    interval: Array,
    implausible: NDArray[np.bool_],
) -> None:
    """Difference of consecutive samples over the time between them; held while there is none. A
    step that no motor can make in that time is no sample. ``limits``: period, largest rates (n,);
    ``sampled``: tick and time (ns) of the last samples. Where a SYNC takes the samples, it is as
    late as its tick, so the time between two counts and not the number of ticks."""
    period, fastest = limits
    period_ns = round(period * 1e9)
    ticks, times_ns = sampled
    for i in range(angle.shape[0]):
        implausible[i] = False
        now = _MISSING if age[i] == NEVER else tick - age[i]
        apart = now - ticks[i]
        if now == _MISSING or apart <= 0:
            continue
        if ticks[i] == _MISSING:
            implausible[i] = not math.isfinite(angle[i])
        else:
            interval[i] = apart * period
            if sampled_ns[i] and times_ns[i]:
                late_ns = sampled_ns[i] - times_ns[i] - apart * period_ns
                interval[i] += late_ns * 1e-9
            shortest = max(interval[i], _CLOSEST * period)
            change = (angle[i] - last[i]) / shortest
            implausible[i] = not abs(change) <= fastest[i]
            if not implausible[i] and shortest == interval[i]:
                rate[i] = change
        if not implausible[i]:
            last[i] = angle[i]
            ticks[i], times_ns[i] = now, sampled_ns[i]


@njit(cache=True)
def _tared(
    reported: Array, tare: Array, largest: float, force: Array, implausible: NDArray[np.bool_]
) -> None:
    """Forces (n + 1,) without their offsets; one that no cable can bear is no sample."""
    for i in range(reported.shape[0]):
        value = reported[i] - tare[i]
        implausible[i] = not abs(value) <= largest
        if not implausible[i]:
            force[i] = value


@njit(cache=True)
def _count_silence(
    age: NDArray[np.uint16],
    last: NDArray[np.uint16],
    fresh: int,
    implausible: NDArray[np.bool_],
    silent: NDArray[np.int64],
) -> None:
    """Ticks in a row that brought nothing new, nothing fresh, or nothing to believe. A sample of an
    earlier tick is new as long as its age does not grow."""
    for i in range(age.shape[0]):
        nothing = age[i] > last[i] or age[i] > fresh or implausible[i]
        silent[i] = silent[i] + 1 if nothing else 0
        last[i] = age[i]


@njit(cache=True)
def _trust(
    ages: tuple[NDArray[np.uint16], NDArray[np.uint16]],
    silences: tuple[NDArray[np.int64], NDArray[np.int64]],
    implausible: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    limits: tuple[int, int],
    usable: NDArray[np.bool_],
    present: NDArray[np.bool_],
) -> None:
    fresh, stale = limits
    for i in range(usable.shape[0]):
        odd = implausible[0][i] or implausible[1][i]
        usable[i] = not odd and max(ages[0][i], ages[1][i]) <= fresh
        present[i] = max(silences[0][i], silences[1][i]) <= stale


@njit(cache=True)
def _sense(
    reported: tuple[Array, Array],
    ages: tuple[NDArray[np.uint16], NDArray[np.uint16]],
    sampled_ns: NDArray[np.int64],
    tick: int,
    limits: tuple[float, Array, float, int, int],
    drums: tuple[Array, tuple[NDArray[np.int64], NDArray[np.int64]], Array, Array],
    cells: tuple[Array, Array],
    last_ages: tuple[NDArray[np.uint16], NDArray[np.uint16]],
    implausible: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    silences: tuple[NDArray[np.int64], NDArray[np.int64]],
    usable: NDArray[np.bool_],
    present: NDArray[np.bool_],
) -> None:
    """All of a tick. Pairs are of axes and cells; ``limits``: period, largest rates (n,), largest
    force, fresh ticks, stale ticks; ``drums``: last angles, when sampled, rates, intervals;
    ``cells``: tare, force."""
    period, fastest, largest, fresh, stale = limits
    limit = (period, fastest)
    _drum_rates(reported[0], ages[0], sampled_ns, tick, limit, *drums, implausible[0])
    _tared(reported[1], cells[0], largest, cells[1], implausible[1])
    _count_silence(ages[0], last_ages[0], fresh, implausible[0], silences[0])
    _count_silence(ages[1], last_ages[1], fresh, implausible[1], silences[1])
    _trust(ages, silences, implausible, (fresh, stale), usable, present)


@njit(cache=True)
def _first_beyond(silent: NDArray[np.int64], limit: int, start: int) -> int:
    for i in range(start, silent.shape[0]):
        if silent[i] > limit:
            return i
    return -1


class Sensing:
    """One tick of measurements. Arrays keep the last good value while a device is silent."""

    def __init__(self, robot: Robot, control: Control) -> None:
        rates, freshness = control.rates, control.freshness
        cables, cells = robot.cables, robot.cells
        self._period = rates.period
        self._fresh_ticks = freshness.measurement_ticks
        self._stale_ticks = freshness.stale_stop_ticks
        self._limits = (
            rates.period,
            control.filters.plausible_speed * robot.motor_speed / robot.gear_ratio,
            control.filters.plausible_force,
            freshness.measurement_ticks,
            freshness.stale_stop_ticks,
        )
        self.filter = ButterworthBank(cells, control.filters.force_cutoff_hz, 1.0 / rates.period)
        self.tare = np.zeros(cells)
        self.force = np.zeros(cells)
        """N, tared, unfiltered: the cables, then the contact port"""
        self.angle = np.zeros(cables)
        self.rate = np.zeros(cables)
        """rad/s, difference of consecutive samples: no filter, so half a tick of delay"""
        self.usable = np.zeros(cables, dtype=bool)
        """drive and cell of a cable are both fresh: it may have a torque"""
        self.present = np.zeros(cables, dtype=bool)
        """neither is lost: it keeps its place in the distribution through a short silence"""
        self.interval = np.full(cables, self._period)
        """s between the two samples that a rate is made of"""
        self._sampled = (np.full(cables, _MISSING, dtype=np.int64), np.zeros(cables, np.int64))
        self.implausible_axes = np.zeros(cables, dtype=bool)
        self.implausible_cells = np.zeros(cells, dtype=bool)
        self._silent_axes = np.zeros(cables, dtype=np.int64)
        self._silent_cells = np.zeros(cells, dtype=np.int64)
        self._last_ages = (np.zeros(cables, dtype=np.uint16), np.zeros(cells, dtype=np.uint16))
        self._drums = (self.angle, self._sampled, self.rate, self.interval)
        self._sum = np.zeros(cells)
        self._samples = 0

    @property
    def tension(self) -> Array:
        """N, (n,), unfiltered."""
        return self.force[:-1]

    @property
    def contact(self) -> float:
        """N, filtered."""
        return float(self.filter.value[-1])

    def step(self, image: ProcessImage, tick: int) -> None:
        axes, cells = image.axes, image.cells
        _sense(
            (axes["angle"], cells["force"]),
            (axes["age"], cells["age"]),
            axes["sampled_ns"],
            tick,
            self._limits,
            self._drums,
            (self.tare, self.force),
            self._last_ages,
            (self.implausible_axes, self.implausible_cells),
            (self._silent_axes, self._silent_cells),
            self.usable,
            self.present,
        )
        self.filter.step(self.force)

    def lost_axis(self, start: int = 0) -> int:
        """The first axis from ``start`` on that left too many ticks in a row without an answer, or
        -1. Ticks the host let pass do not count: nothing was asked for."""
        return int(_first_beyond(self._silent_axes, self._stale_ticks, start))

    def lost_cell(self, start: int = 0) -> int:
        """The same for the cells."""
        return int(_first_beyond(self._silent_cells, self._stale_ticks, start))

    def collect_tare(self, image: ProcessImage) -> None:
        """Add this tick's readings of the unloaded cells to their mean."""
        if image.cells["age"].max() > self._fresh_ticks or self.implausible_cells.any():
            return
        self._sum += image.cells["force"]
        self._samples += 1

    @property
    def tare_time(self) -> float:
        """s of readings collected."""
        return self._samples * self._period

    def apply_tare(self, stated: Sequence[float] | None) -> int:
        """Zero the cells, by offsets (n + 1,) N that were ``stated`` or else by their mean reading;
        returns the number of readings there were."""
        samples = self._samples
        self.tare = self._sum / max(samples, 1) if stated is None else np.array(stated)
        self._sum = np.zeros_like(self._sum)
        self._samples = 0
        self.force[:] = 0.0
        self.filter.reset(self.force)
        return samples
