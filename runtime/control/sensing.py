"""From the process image to what control reads: tared tensions, drum rates, and which cables still
have fresh measurements behind them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.control import Control
from tonus.config.schema.robot import Robot
from tonus.drivers.process_image import NEVER, AxisState, ProcessImage
from tonus.runtime.control.filters import ButterworthBank

Array = NDArray[np.float64]
Table = Any
"""A structured array, whose columns are attributes in compiled code."""
SILENT, FAULTED, NOT_ENABLED, DEFECT = 1, 2, 4, 8
"""The bits of an alarm: a device too long without an answer; a drive in a fault state, or with a
fresh statusword and not in Operation Enabled; a cell that reports a defect."""
FAULT_STATES = (int(AxisState.FAULT), int(AxisState.FAULT_REACTION_ACTIVE))
ENABLED_STATE = int(AxisState.OPERATION_ENABLED)
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
    sound: NDArray[np.bool_],
) -> None:
    fresh, stale = limits
    for i in range(usable.shape[0]):
        odd = implausible[0][i] or implausible[1][i]
        usable[i] = not odd and max(ages[0][i], ages[1][i]) <= fresh
        present[i] = max(silences[0][i], silences[1][i]) <= stale
        sound[i] = usable[i] and present[i]


@njit(cache=True)
def _alarm(
    silences: tuple[NDArray[np.int64], NDArray[np.int64]],
    age: NDArray[np.uint16],
    state: NDArray[np.uint8],
    status: NDArray[np.uint8],
    limits: tuple[int, int],
) -> int:
    """Which questions about devices may have an answer in this tick: a sum of the bits above."""
    fresh, stale = limits
    found = 0
    for i in range(state.shape[0]):
        if silences[0][i] > stale:
            found |= SILENT
        if state[i] == FAULT_STATES[0] or state[i] == FAULT_STATES[1]:
            found |= FAULTED
        if age[i] <= fresh and state[i] != ENABLED_STATE:
            found |= NOT_ENABLED
    for i in range(status.shape[0]):
        if silences[1][i] > stale:
            found |= SILENT
        if status[i]:
            found |= DEFECT
    return found


@njit(cache=True)
def _sense(
    axes: Table,
    cells: Table,
    tick: int,
    period: float,
    fastest: Array,
    largest: float,
    fresh: int,
    stale: int,
    last_angle: Array,
    ticks: NDArray[np.int64],
    times_ns: NDArray[np.int64],
    rate: Array,
    interval: Array,
    tare: Array,
    force: Array,
    last_age: NDArray[np.uint16],
    last_cell_age: NDArray[np.uint16],
    implausible: NDArray[np.bool_],
    implausible_cells: NDArray[np.bool_],
    silent: NDArray[np.int64],
    silent_cells: NDArray[np.int64],
    usable: NDArray[np.bool_],
    present: NDArray[np.bool_],
    sound: NDArray[np.bool_],
    radius: Array,
    winding: Array,
) -> int:
    """All of a tick; returns its alarm. First the image's tables, then limits (s, rad/s (n,), N,
    ticks, ticks), then what `Sensing` keeps. Single arrays, since a tuple of them takes longer to
    hand over."""
    angle, age, sampled_ns = axes.angle, axes.age, axes.sampled_ns
    cell_age = cells.age
    limit, drums = (period, fastest), (ticks, times_ns)
    _drum_rates(angle, age, sampled_ns, tick, limit, last_angle, drums, rate, interval, implausible)
    _tared(cells.force, tare, largest, force, implausible_cells)
    _count_silence(age, last_age, fresh, implausible, silent)
    _count_silence(cell_age, last_cell_age, fresh, implausible_cells, silent_cells)
    ages, silences = (age, cell_age), (silent, silent_cells)
    odd = (implausible, implausible_cells)
    _trust(ages, silences, odd, (fresh, stale), usable, present, sound)
    for i in range(rate.shape[0]):
        winding[i] = radius[i] * rate[i]
    return _alarm(silences, age, axes.state, cells.status, (fresh, stale))


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
        self.sound = np.zeros(cables, dtype=bool)
        """both: it may have a torque now"""
        self.winding = np.zeros(cables)
        """m/s, rate at which a cable is reeled in"""
        self.interval = np.full(cables, self._period)
        """s between the two samples that a rate is made of"""
        self._sampled = (np.full(cables, _MISSING, dtype=np.int64), np.zeros(cables, np.int64))
        self.implausible_axes = np.zeros(cables, dtype=bool)
        self.implausible_cells = np.zeros(cells, dtype=bool)
        self._silent_axes = np.zeros(cables, dtype=np.int64)
        self._silent_cells = np.zeros(cells, dtype=np.int64)
        self._last_ages = (np.zeros(cables, dtype=np.uint16), np.zeros(cells, dtype=np.uint16))
        self._kept = (
            rates.period,
            control.filters.plausible_speed * robot.motor_speed / robot.gear_ratio,
            control.filters.plausible_force,
            freshness.measurement_ticks,
            freshness.stale_stop_ticks,
            self.angle,
            *self._sampled,
            self.rate,
            self.interval,
            self.tare,
            self.force,
            *self._last_ages,
            self.implausible_axes,
            self.implausible_cells,
            self._silent_axes,
            self._silent_cells,
            self.usable,
            self.present,
            self.sound,
            robot.drum_radius,
            self.winding,
        )
        self.tension = self.force[:-1]
        """N, (n,), unfiltered"""
        self.filtered = self.filter.value[:-1]
        """N, (n,), low-passed"""
        self.alarm = 0
        """of this tick's devices"""
        self._sum = np.zeros(cells)
        self._samples = 0

    @property
    def contact(self) -> float:
        """N, filtered."""
        return float(self.filter.value[-1])

    def step(self, image: ProcessImage, tick: int) -> None:
        self.alarm = _sense(image.axes, image.cells, tick, *self._kept)
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
        self.tare[:] = self._sum / max(samples, 1) if stated is None else stated
        self._sum[:] = 0.0
        self._samples = 0
        self.force[:] = 0.0
        self.filter.reset(self.force)
        return samples
