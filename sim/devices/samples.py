"""What all devices measure at one instant, in device units, computed once for all who ask.

Encoder: floor of the motor angle in increments. Torque: motor current in per mille of the nominal
one. Force: the cell behind its low-pass, with the noise and offset of its seed, clipped to its
range, scaled and tared as its amplifier is told, in integers with decimal digits.
"""

from __future__ import annotations

from math import floor, pi
from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.lab import CellNoise
from tonus.config.schema.robot import Robot
from tonus.sim.devices.cia402.axis_table import AxisTable
from tonus.sim.plant.streams import Stream, generator

Floats = NDArray[np.float64]

_INTERVAL_NS = 1_000_000
"""A cell converts once a millisecond (its maker's figure), so its noise is new that often."""
_BLOCK = 1024
"""Noise is drawn for so many conversions at once."""
_PER_RADIAN, _PER_AMPERE, _ZERO = range(3)
_DIGITS, _GAIN, _TARE, _OFFSET = range(4)
"""Rows of the parameters of axes, and of those of cells."""
OVERFLOW, UNDERFLOW = 3, 5
"""Status of a cell (CiA 404) at the upper and at the lower end of its range; 0 between them."""
_INT16 = 0x7FFF
_INT32 = 1 << 31
_EPSILON = 1e-9


class Measured(Protocol):
    """What the devices look at."""

    @property
    def now_ns(self) -> int: ...
    @property
    def motor_angle(self) -> Floats: ...
    @property
    def motor_rate(self) -> Floats: ...
    @property
    def motor_current(self) -> Floats: ...
    @property
    def cell_force(self) -> Floats: ...
    @property
    def current_reference(self) -> Floats: ...
    @property
    def powered(self) -> NDArray[np.bool_]: ...
    @property
    def locked(self) -> NDArray[np.bool_]: ...
    def advance(self, to_ns: int) -> None: ...


@njit(
    "void(float64[::1], float64[::1], float64[::1], float64[:, ::1], float64[:, ::1], float64,"
    " float64[:, ::1], int64, int64[::1], float64[::1])",
    cache=True,
)
def _sample(
    angle: Floats,
    current: Floats,
    cell: Floats,
    axes: Floats,
    cells: Floats,
    reach: float,
    noise: Floats,
    row: int,
    values: NDArray[np.int64],
    force: Floats,
) -> None:
    """``axes`` and ``cells``: a row for each of the places above; ``reach``: N, end of a cell's
    range either way; ``values`` as `Samples` has them."""
    count, amplifiers = angle.shape[0], cell.shape[0]
    end = reach * (1.0 - _EPSILON)
    for i in range(count):
        turned = int(np.floor(angle[i] * axes[_PER_RADIAN, i])) - int(axes[_ZERO, i])
        values[i] = (turned + _INT32) % (2 * _INT32) - _INT32
        mille = np.rint(current[i] * axes[_PER_AMPERE, i])
        values[count + i] = int(min(max(mille, -_INT16 - 1), _INT16))
    for i in range(amplifiers):
        value = cell[i] + cells[_OFFSET, i] + noise[row, i]
        clipped = min(max(value, -reach), reach)
        force[i] = clipped * cells[_GAIN, i] + cells[_TARE, i]
        scaled = np.rint(force[i] * cells[_DIGITS, i])
        values[2 * count + i] = int(min(max(scaled, -_INT32), _INT32 - 1))
        found = (force[i] - cells[_TARE, i]) / cells[_GAIN, i]
        status = OVERFLOW if found >= end else UNDERFLOW if found <= -end else 0
        values[2 * count + amplifiers + i] = status


class Samples:
    """Measured values of all axes and cells.

    ``values``: positions (n), torques (n), integer process values and statuses of the cells (n + 1)
    of the last instant asked for with `at`, then the present statuswords and error codes (n), which
    the drives write; all but the first begin at `torque`, `cell`, `validity`, `status` and `error`.
    Cell noise depends on seed and time alone, so who asks and how often changes nothing.
    """

    def __init__(self, plant: Measured, robot: Robot, noise: CellNoise, seed: int) -> None:
        self.plant = plant
        cables, cells = robot.cables, robot.cells
        self.torque, self.cell, self.validity = cables, 2 * cables, 2 * cables + cells
        self.status = self.validity + cells
        self.error = self.status + cables
        """where the parts of `values` begin"""
        self.axes = AxisTable(plant.current_reference)
        self.force = np.zeros(cells)
        """N, of the same instant"""
        self._seed = seed
        self._sigma = noise.sigma
        self._begin_ns = plant.now_ns
        self.values = np.zeros(self.error + cables, np.int64)
        self._at_ns = plant.now_ns - 1
        self._noise = np.zeros((_BLOCK, cells))
        self._block = -1
        self._axes, self._cells = np.zeros((3, cables)), np.zeros((4, cells))
        self._range = noise.range
        motors = [train.motor for train in robot.drive_trains]
        self.per_revolution = [motor.increments_per_revolution for motor in motors]
        """increments of each motor's encoder"""
        self.per_radian = [count / (2.0 * pi) for count in self.per_revolution]
        self._axes[_PER_RADIAN] = self.per_radian
        self._cells[_DIGITS] = self._cells[_GAIN] = 1.0
        offsets = generator(seed, Stream.CELLS).standard_normal(cells)
        self._cells[_OFFSET] = noise.offset_sigma * offsets
        self._offsets = self._cells[_OFFSET].copy()

    def at(self, now_ns: int) -> NDArray[np.int64]:
        """Bring the plant to this time and sample: `values`."""
        if now_ns != self._at_ns:
            plant = self.plant
            plant.advance(now_ns)
            conversion = (now_ns - self._begin_ns) // _INTERVAL_NS
            if conversion // _BLOCK != self._block:
                self._draw(conversion // _BLOCK)
            _sample(
                plant.motor_angle,
                plant.motor_current,
                plant.cell_force,
                self._axes,
                self._cells,
                self._range,
                self._noise,
                conversion % _BLOCK,
                self.values,
                self.force,
            )
            self._at_ns = now_ns
        return self.values

    def _draw(self, block: int) -> None:
        sequence = np.random.SeedSequence(self._seed, spawn_key=(int(Stream.CELLS), 1 + block))
        random = np.random.Generator(np.random.PCG64(sequence))
        self._noise = self._sigma * random.standard_normal(self._noise.shape)
        self._block = block

    def _changed(self) -> None:
        self._at_ns = self._begin_ns - 1

    def set_nominal_current(self, axis: int, ampere: float) -> None:
        """Base of an axis' torque actual value; with 0 it reads 0."""
        self._axes[_PER_AMPERE, axis] = 1000.0 / ampere if ampere > 0.0 else 0.0
        self._changed()

    def set_resolution(self, axis: int, counts: float) -> None:
        """Counts of an axis' encoder a motor revolution, where its drive has its own."""
        self.per_revolution[axis] = round(counts)
        self.per_radian[axis] = self._axes[_PER_RADIAN, axis] = counts / (2.0 * pi)
        self._changed()

    def set_decimal_digits(self, cell: int, digits: int) -> None:
        self._cells[_DIGITS, cell] = 10.0**digits
        self._changed()

    def set_scaling(self, cell: int, gain: float, tare: float) -> None:
        """Process value for a force: ``gain`` times the force plus ``tare``."""
        self._cells[_GAIN, cell] = gain
        self._cells[_TARE, cell] = tare
        self._changed()

    def count(self, axis: int) -> int:
        """Increments of an axis' encoder since the plant's own zero, where an index pulse is; the
        plant stands at the present."""
        return floor(float(self.plant.motor_angle[axis]) * self.per_radian[axis])

    def position(self, axis: int) -> int:
        """Increments as an axis' drive counts them; the plant stands at the present."""
        return (self.count(axis) - int(self._axes[_ZERO, axis]) + _INT32) % (2 * _INT32) - _INT32

    def set_position(self, axis: int, position: int = 0) -> None:
        """Count increments from this position on: 0 is an encoder counter at switch-on."""
        self._axes[_ZERO, axis] = self.count(axis) - position
        self._changed()

    def break_cell(self, cell: int, *, broken: bool = True) -> None:
        """An open bridge drives the amplifier to the end of its range."""
        self._cells[_OFFSET, cell] = np.inf if broken else self._offsets[cell]
        self._changed()
