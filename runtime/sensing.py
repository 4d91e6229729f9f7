"""From the process image to what control reads: tared tensions, drum rates, and which cables still
have fresh measurements behind them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from config.schema.bus import CELLS, CONTACT_CELL
from config.schema.control import Control
from config.schema.robot import CABLES
from drivers.process_image import NEVER, ProcessImage
from runtime.filters import ButterworthBank

Array = NDArray[np.float64]
_MISSING = -1


@njit(cache=True)
def _drum_rates(
    angle: Array,
    age: NDArray[np.uint16],
    tick: int,
    period: float,
    last: Array,
    sampled: NDArray[np.int64],
    rate: Array,
) -> None:
    """Difference of consecutive samples over the time between them; held while there is none."""
    for i in range(angle.shape[0]):
        now = _MISSING if age[i] == NEVER else tick - age[i]
        apart = now - sampled[i]
        if sampled[i] != _MISSING and apart > 0:
            rate[i] = (angle[i] - last[i]) / (apart * period)
        last[i] = angle[i]
        sampled[i] = now


@njit(cache=True)
def _younger_than(
    axis_age: NDArray[np.uint16],
    cell_age: NDArray[np.uint16],
    limits: tuple[int, int],
    usable: NDArray[np.bool_],
    present: NDArray[np.bool_],
) -> None:
    fresh, stale = limits
    for i in range(axis_age.shape[0]):
        age = max(axis_age[i], cell_age[i])
        usable[i] = age <= fresh
        present[i] = age <= stale


@njit(cache=True)
def _first_older(age: NDArray[np.uint16], limit: int) -> int:
    for i in range(age.shape[0]):
        if age[i] > limit:
            return i
    return -1


class Sensing:
    """One tick of measurements. Arrays keep the last good value while a device is silent."""

    def __init__(self, control: Control) -> None:
        rates, freshness = control.rates, control.freshness
        self._period = rates.period
        self._fresh_ticks = freshness.measurement_ticks
        self._stale_ticks = freshness.stale_stop_ticks
        self.filter = ButterworthBank(CELLS, control.filters.force_cutoff_hz, 1.0 / rates.period)
        self.tare = np.zeros(CELLS)
        self.force = np.zeros(CELLS)
        """N, tared, unfiltered: eight cables, then the contact port"""
        self.angle = np.zeros(CABLES)
        self.rate = np.zeros(CABLES)
        """rad/s, difference of consecutive samples: no filter, so half a tick of delay"""
        self.usable = np.zeros(CABLES, dtype=bool)
        """drive and cell of a cable are both fresh: it may have a torque"""
        self.present = np.zeros(CABLES, dtype=bool)
        """neither is lost: it keeps its place in the distribution through a short silence"""
        self._sampled = np.full(CABLES, _MISSING, dtype=np.int64)
        self._sum = np.zeros(CELLS)
        self._samples = 0

    @property
    def tension(self) -> Array:
        """N, (8,), unfiltered."""
        return self.force[:CABLES]

    @property
    def contact(self) -> float:
        """N, filtered."""
        return float(self.filter.value[CONTACT_CELL])

    def step(self, image: ProcessImage, tick: int) -> None:
        axes, cells = image.axes, image.cells
        _drum_rates(
            axes["angle"],
            axes["age"],
            tick,
            self._period,
            self.angle,
            self._sampled,
            self.rate,
        )
        np.subtract(cells["force"], self.tare, out=self.force)
        self.filter.step(self.force)
        _younger_than(
            axes["age"],
            cells["age"],
            (self._fresh_ticks, self._stale_ticks),
            self.usable,
            self.present,
        )

    def lost_axis(self, image: ProcessImage) -> int:
        """An axis that has been silent for too long, or -1."""
        return int(_first_older(image.axes["age"], self._stale_ticks))

    def lost_cell(self, image: ProcessImage) -> int:
        return int(_first_older(image.cells["age"], self._stale_ticks))

    def collect_tare(self, image: ProcessImage) -> None:
        """Add this tick's readings of the unloaded cells to their mean."""
        if image.cells["age"].max() > self._fresh_ticks:
            return
        self._sum += image.cells["force"]
        self._samples += 1

    @property
    def tare_time(self) -> float:
        """s of readings collected."""
        return self._samples * self._period

    def apply_tare(self) -> int:
        """Zero the cells; returns the number of samples used."""
        samples = self._samples
        self.tare = self._sum / max(samples, 1)
        self._sum = np.zeros(CELLS)
        self._samples = 0
        self.force[:] = 0.0
        self.filter.reset(self.force)
        return samples
