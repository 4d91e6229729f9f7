"""Between device integers and the process image: the conversions every fieldbus shares.

A bus puts what it received into the lists here and calls `fill`; it sends what `commands` returns.
Because all buses use the same code, the same integers give the same floats to the last bit.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.bus import Amplifier, ForceCell
from tonus.config.schema.drive import DriveProfile
from tonus.config.schema.robot import Robot
from tonus.config.schema.safety import Freshness
from tonus.drivers.cia301.setting import ObjectAccess
from tonus.drivers.devices.cia402 import STATE_OF, controlword
from tonus.drivers.devices.drive import Scale, read_scale
from tonus.drivers.devices.force_cell import divisor
from tonus.drivers.events import EventLog
from tonus.drivers.process_image import NEVER, AxisCommand, AxisState, ProcessImage

NOT_YET = -(1 << 32)
"""A sample's tick before there was one."""

AXIS = np.dtype(
    [
        ("tick", "i8"),
        ("position", "i8"),  # increments
        ("torque", "i8"),  # per mille
        ("statusword", "i8"),
        ("error_code", "i8"),
        ("untrusted", "i8"),  # not operational, or restarted; on CAN silent too
        ("sampled_ns", "i8"),  # when the SYNC or SYNC0 took the sample; 0: not known
        ("doubt_ns", "i8"),  # by how much that may be wrong
    ]
)
CELL = np.dtype(
    [
        ("tick", "i8"),
        ("value", "f8"),
        ("status", "i8"),  # as mapped; 0 where none is
        ("emergency", "i8"),  # raised by its node and not taken back
    ]
)
UNTRUSTED = 0xFF
"""Status of a cell whose node raised an emergency, whatever its mapped status says."""

Array = NDArray[np.float64]
_WORD = 8
_STATES = np.frombuffer(STATE_OF, np.uint8)
_ENABLED = int(AxisState.OPERATION_ENABLED)
_LOST = int(AxisState.LOST)
_ENABLE = int(AxisCommand.ENABLE)


@njit(cache=True)
def _convert(
    raw_axes: NDArray[np.void],
    raw_cells: NDArray[np.void],
    newest: int,
    fresh: int,
    scale: tuple[Array, Array, float],
    states: NDArray[np.uint8],
    axes: NDArray[np.void],
    cells: NDArray[np.void],
) -> None:
    """Raw values to the image's tables. A sample of tick ``newest`` has age 0, and one from a tick
    yet to come is none of this run's. ``scale``: rad an increment and N m a per mille of each
    axis, the cells' divisor."""
    for i in range(raw_axes.shape[0]):
        raw, axis = raw_axes[i], axes[i]
        age = newest - raw.tick
        if not 0 <= age < NEVER:
            age = NEVER
        axis.angle = raw.position * scale[0][i]
        axis.torque = raw.torque * scale[1][i]
        axis.statusword = raw.statusword
        axis.error_code = raw.error_code
        axis.sampled_ns = raw.sampled_ns
        axis.doubt_ns = raw.doubt_ns
        axis.age = age
        axis.state = _LOST if age > fresh or raw.untrusted else states[raw.statusword]
    for i in range(raw_cells.shape[0]):
        sample, cell = raw_cells[i], cells[i]
        age = newest - sample.tick
        if not 0 <= age < NEVER:
            age = NEVER
        cell.force = sample.value / scale[2]
        cell.status = UNTRUSTED if sample.emergency else sample.status
        cell.age = age


@njit(cache=True)
def _command(
    axes: NDArray[np.void],
    commands: NDArray[np.void],
    limits: tuple[Array, Array],
    words: NDArray[np.int64],
    torques: NDArray[np.int64],
) -> bool:
    """Controlwords, ``words`` holding those before, and torques (per mille); False: one that was
    wanted is not finite. ``limits``: N m, and per mille a N m, of each axis."""
    finite = True
    for i in range(axes.shape[0]):
        wanted, state, command = commands[i].torque, axes[i].state, commands[i].command
        words[i] = controlword(state, command, words[i])
        torques[i] = 0
        if not math.isfinite(wanted):
            finite = False
        elif state == _ENABLED and command == _ENABLE:
            # Clipped before it is scaled: no torque, however large, overflows on the way.
            clipped = min(max(wanted, -limits[0][i]), limits[0][i])
            torques[i] = int(np.rint(clipped * limits[1][i]))
    return finite


class Exchange:
    """Raw values of the last exchange, one place per axis or cell.

    ``axis_tick`` and ``cell_tick`` hold the tick whose SYNC took the sample. A sample of the tick
    before the present one is as fresh as can be and has age 0.
    """

    def __init__(
        self,
        robot: Robot,
        cell: ForceCell | Amplifier,
        freshness: Freshness,
        image: ProcessImage,
        events: EventLog,
        places: list[str],
    ) -> None:
        """``places`` names each axis in events."""
        split = robot.cables * AXIS.itemsize // _WORD
        self.integers = np.zeros(split + robot.cells * CELL.itemsize // _WORD, np.int64)
        """everything raw as one row of words, for who knows the `place` of what he writes"""
        self.reals = self.integers.view(np.float64)
        """the same words"""
        self._raw_axes = axes = self.integers[:split].view(AXIS)
        self._raw_cells = cells = self.integers[split:].view(CELL)
        self.axis_tick, self.untrusted = axes["tick"], axes["untrusted"]
        self.sampled_ns, self.doubt_ns = axes["sampled_ns"], axes["doubt_ns"]
        self.positions, self.torques = axes["position"], axes["torque"]
        self.statuswords, self.error_codes = axes["statusword"], axes["error_code"]
        self.cell_tick, self.cells = cells["tick"], cells["value"]
        self.cell_status, self.cell_emergency = cells["status"], cells["emergency"]
        self.axis_tick[:] = self.cell_tick[:] = NOT_YET
        self._events = events
        self._places = places
        self._freshness = freshness.measurement_ticks
        cables = robot.cables
        self._trains = list(zip(robot.drive_trains, robot.signs, strict=True))
        self._scales = (np.zeros(cables), np.zeros(cables), float(divisor(cell)))
        self._words, self._torques = np.zeros(cables, np.int64), np.zeros(cables, np.int64)
        self._limits = (np.zeros(cables), np.zeros(cables))
        """N m, and per mille a N m"""
        for axis, (train, sign) in enumerate(self._trains):
            self._set_scale(axis, Scale.of(train, sign))
        self._reported = False
        self._axis_table, self._cell_table = image.axes, image.cells
        self._commands = image.commands

    async def read_scale(self, axis: int, access: ObjectAccess, profile: DriveProfile) -> None:
        """Take over what an axis' drive counts in, now that it holds its settings. Raises
        `DriverError`."""
        self._set_scale(axis, await read_scale(access, profile, *self._trains[axis]))

    def _set_scale(self, axis: int, scale: Scale) -> None:
        self._scales[0][axis] = scale.radian_per_increment
        self._scales[1][axis] = scale.newton_metre_per_mille
        self._limits[0][axis] = scale.mille_limit * abs(scale.newton_metre_per_mille)
        self._limits[1][axis] = scale.mille_per_newton_metre

    def forget(self) -> None:
        """Begin anew: no sample has been taken yet and nobody is mistrusted."""
        self.axis_tick[:] = self.cell_tick[:] = NOT_YET
        self.untrusted[:] = self.sampled_ns[:] = self.doubt_ns[:] = 0
        self.error_codes[:] = 0
        self.cell_status[:] = 0
        self.cell_emergency[:] = 0
        # Also so that it is compiled before a tick needs it, as the commands of no axis are.
        self.fill(0)
        none = slice(0)
        words, torques = self._words[none], self._torques[none]
        _command(self._axis_table[none], self._commands[none], self._limits, words, torques)

    def place(self, column: NDArray[Any], row: int) -> int:
        """Where an entry of one of the columns stands among `integers`."""
        return (_address(column[row:]) - _address(self.integers)) // _WORD

    def fill(self, tick: int) -> None:
        """Write the image's inputs as they stand at the start of ``tick``."""
        _convert(
            self._raw_axes,
            self._raw_cells,
            tick - 1,
            self._freshness,
            self._scales,
            _STATES,
            self._axis_table,
            self._cell_table,
        )

    def commands(self) -> tuple[list[int], list[int]]:
        """`outputs`, as lists."""
        words, torques = self.outputs()
        return words.tolist(), torques.tolist()

    def outputs(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Controlword and target torque (per mille) of every axis, (n,) each, until the next call.

        A torque goes out only to an axis that is enabled and is meant to be; every other axis gets
        0, so that nothing stale acts when it is enabled. A torque that is not finite becomes 0.
        """
        finite = _command(
            self._axis_table, self._commands, self._limits, self._words, self._torques
        )
        if self._reported or not finite:
            self._report(np.isfinite(self._commands["torque"]).tolist())
        return self._words, self._torques

    def _report(self, finite: list[bool]) -> None:
        """Begin or end the episode of each axis whose torque is no number."""
        for axis, (good, place) in enumerate(zip(finite, self._places, strict=True)):
            if good:
                self._events.end("non_finite_torque", place)
            else:
                text = f"axis {axis} was commanded a torque that is no number; it gets 0"
                self._events.begin("non_finite_torque", place, text)
        self._reported = not all(finite)


def _address(array: NDArray[Any]) -> int:
    address: int = array.__array_interface__["data"][0]
    return address
