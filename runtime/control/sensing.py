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
Mask = NDArray[np.bool_]
Table = Any
"""A structured array, whose columns are attributes in compiled code."""
SILENT, FAULTED, NOT_ENABLED, DEFECT = 1, 2, 4, 8
"""The bits of an alarm: a device too long without an answer; a drive in a fault state, or with a
fresh statusword and not in Operation Enabled; a cell that reports a defect."""
FAULT_STATES = (int(AxisState.FAULT), int(AxisState.FAULT_REACTION_ACTIVE))
ENABLED_STATE = int(AxisState.OPERATION_ENABLED)
_MISSING = -1
# The rows of what is kept of the drums, numbers, counts and flags (n,), and of the cells (n + 1,).
ANGLE, RATE, INTERVAL, _WINDING, _RADIUS, _FASTEST = range(6)
_SAMPLED_TICK, _SAMPLED_NS, _LAST_AGE, _SILENT = range(4)
_IMPLAUSIBLE, _USABLE, _PRESENT, _SOUND = range(4)
_TARE, _FORCE = range(2)
_LAST_AGE_CELLS, _SILENT_CELLS = range(2)
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
    last: NDArray[np.int64],
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
    largest: float,
    fresh: int,
    stale: int,
    drums: Array,
    forces: Array,
    counts: NDArray[np.int64],
    cell_counts: NDArray[np.int64],
    flags: NDArray[np.bool_],
    implausible_cells: NDArray[np.bool_],
) -> int:
    """All of a tick; returns its alarm. First the image's tables, then limits (s, N, ticks, ticks),
    then what `Sensing` keeps, a row for each quantity: an array takes as long to hand over as a
    table of them."""
    age, cell_age, rate = axes.age, cells.age, drums[RATE]
    silent, silent_cells = counts[_SILENT], cell_counts[_SILENT_CELLS]
    implausible = flags[_IMPLAUSIBLE]
    _drum_rates(
        axes.angle,
        age,
        axes.sampled_ns,
        tick,
        (period, drums[_FASTEST]),
        drums[ANGLE],
        (counts[_SAMPLED_TICK], counts[_SAMPLED_NS]),
        rate,
        drums[INTERVAL],
        implausible,
    )
    _tared(cells.force, forces[_TARE], largest, forces[_FORCE], implausible_cells)
    _count_silence(age, counts[_LAST_AGE], fresh, implausible, silent)
    _count_silence(cell_age, cell_counts[_LAST_AGE_CELLS], fresh, implausible_cells, silent_cells)
    ages, silences = (age, cell_age), (silent, silent_cells)
    odd, limits = (implausible, implausible_cells), (fresh, stale)
    _trust(ages, silences, odd, limits, flags[_USABLE], flags[_PRESENT], flags[_SOUND])
    for i in range(rate.shape[0]):
        drums[_WINDING, i] = drums[_RADIUS, i] * rate[i]
    return _alarm(silences, age, axes.state, cells.status, limits)


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
        self.drums = drums = np.zeros((6, cables))
        """rows ANGLE, RATE, INTERVAL and others, as below"""
        forces = np.zeros((2, cells))
        counts, cell_counts = np.zeros((4, cables), np.int64), np.zeros((2, cells), np.int64)
        flags = np.zeros((4, cables), dtype=bool)
        self.implausible_cells = np.zeros(cells, dtype=bool)
        self._kept = (
            rates.period,
            control.filters.plausible_force,
            freshness.measurement_ticks,
            freshness.stale_stop_ticks,
            drums,
            forces,
            counts,
            cell_counts,
            flags,
            self.implausible_cells,
        )
        drums[INTERVAL], drums[_RADIUS] = self._period, robot.drum_radius
        drums[_FASTEST] = control.filters.plausible_speed * robot.motor_speed / robot.gear_ratio
        counts[_SAMPLED_TICK] = _MISSING
        self.tare: Array = forces[_TARE]
        self.force: Array = forces[_FORCE]
        """N, tared, unfiltered: the cables, then the contact port"""
        self.angle = drums[ANGLE]
        self.rate = drums[RATE]
        """rad/s, difference of consecutive samples: no filter, so half a tick of delay"""
        self.interval = drums[INTERVAL]
        """s between the two samples that a rate is made of"""
        self.winding = drums[_WINDING]
        """m/s, rate at which a cable is reeled in"""
        self.implausible_axes = flags[_IMPLAUSIBLE]
        self.usable: Mask = flags[_USABLE]
        """drive and cell of a cable are both fresh: it may have a torque"""
        self.present: Mask = flags[_PRESENT]
        """neither is lost: it keeps its place in the distribution through a short silence"""
        self.sound: Mask = flags[_SOUND]
        """both: it may have a torque now"""
        self._silent_axes, self._silent_cells = counts[_SILENT], cell_counts[_SILENT_CELLS]
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
