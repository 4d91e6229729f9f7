"""Between device integers and the process image: the conversions every fieldbus shares.

A bus puts what it received into the lists here and calls `fill`; it sends what `commands` returns.
Because all buses use the same code, the same integers give the same floats to the last bit.
"""

from __future__ import annotations

import math

from config.schema.bus import CELLS, ForceCell
from config.schema.control import Freshness
from config.schema.robot import CABLES, Robot
from drivers.cia402 import STATE_OF, Cia402Axis
from drivers.epos4 import Scale
from drivers.events import EventLog
from drivers.force_cell import divisor
from drivers.process_image import NEVER, AxisCommand, AxisState, ProcessImage

NOT_YET = -(1 << 32)
"""A sample's tick before there was one."""

_ENABLED = int(AxisState.OPERATION_ENABLED)
_LOST = int(AxisState.LOST)
_ENABLE = int(AxisCommand.ENABLE)


class Exchange:
    """Raw values of the last exchange, one place per axis or cell.

    ``axis_tick`` and ``cell_tick`` hold the tick whose SYNC took the sample. A sample of the tick
    before the present one is as fresh as can be and has age 0.
    """

    def __init__(
        self,
        robot: Robot,
        cell: ForceCell,
        freshness: Freshness,
        image: ProcessImage,
        events: EventLog,
        places: list[str],
    ) -> None:
        """``places`` names each axis in events."""
        self.statuswords = [0] * CABLES
        self.positions = [0] * CABLES
        self.torques = [0] * CABLES
        self.error_codes = [0] * CABLES
        self.untrusted = [False] * CABLES  # silent, restarted or not operational
        self.axis_tick = [NOT_YET] * CABLES
        self.cells: list[float] = [0] * CELLS
        self.cell_status = [0] * CELLS
        self.cell_tick = [NOT_YET] * CELLS

        self._events = events
        self._places = places
        self._freshness = freshness.measurement_ticks
        self._scale = Scale.of(robot)
        self._divisor = divisor(cell)
        self._axes = [Cia402Axis() for _ in range(CABLES)]
        self._states = [_LOST] * CABLES
        self._torque_limit = self._scale.mille_limit * self._scale.newton_metre_per_mille
        self._reported = False
        self._angle = image.axes["angle"]
        self._torque = image.axes["torque"]
        self._statusword = image.axes["statusword"]
        self._error_code = image.axes["error_code"]
        self._axis_age = image.axes["age"]
        self._state = image.axes["state"]
        self._force = image.cells["force"]
        self._cell_age = image.cells["age"]
        self._cell_status = image.cells["status"]
        self._command_torque = image.commands["torque"]
        self._command = image.commands["command"]

    def forget(self) -> None:
        """Begin anew: no sample has been taken yet and nobody is mistrusted."""
        self.axis_tick[:] = [NOT_YET] * CABLES
        self.cell_tick[:] = [NOT_YET] * CELLS
        self.untrusted[:] = [False] * CABLES
        self.error_codes[:] = [0] * CABLES
        self.cell_status[:] = [0] * CELLS

    def fill(self, tick: int) -> None:
        """Write the image's inputs as they stand at the start of ``tick``."""
        newest = tick - 1
        axis_age = [0 if t == newest else _age(newest - t) for t in self.axis_tick]
        cell_age = [0 if t == newest else _age(newest - t) for t in self.cell_tick]
        self._angle[:] = self.positions
        self._angle *= self._scale.radian_per_increment
        self._torque[:] = self.torques
        self._torque *= self._scale.newton_metre_per_mille
        self._statusword[:] = self.statuswords
        self._error_code[:] = self.error_codes
        self._states = [
            _LOST if age > self._freshness or untrusted else STATE_OF[word]
            for age, untrusted, word in zip(axis_age, self.untrusted, self.statuswords, strict=True)
        ]
        self._state[:] = self._states
        self._axis_age[:] = axis_age
        self._force[:] = self.cells
        self._force /= self._divisor
        self._cell_status[:] = self.cell_status
        self._cell_age[:] = cell_age

    def commands(self) -> tuple[list[int], list[int]]:
        """Controlword and target torque (per mille) of every axis.

        A torque goes out only to an axis that is enabled and is meant to be; every other axis gets
        0, so that nothing stale acts when it is enabled. A torque that is not finite becomes 0.
        """
        wanted: list[float] = self._command_torque.tolist()
        if self._reported or not math.isfinite(sum(wanted)):
            self._report([math.isfinite(torque) for torque in wanted])
        limit, per_newton_metre = self._torque_limit, self._scale.mille_per_newton_metre
        controlwords = []
        torques = []
        for axis, state, command, torque in zip(
            self._axes, self._states, self._command.tolist(), wanted, strict=True
        ):
            controlwords.append(axis.controlword(state, command))
            if state == _ENABLED and command == _ENABLE and math.isfinite(torque):
                # Clipped before it is scaled: no torque, however large, overflows on the way.
                clipped = min(max(torque, -limit), limit)
                torques.append(round(clipped * per_newton_metre))
            else:
                torques.append(0)
        return controlwords, torques

    def _report(self, finite: list[bool]) -> None:
        """Begin or end the episode of each axis whose torque is no number."""
        for axis, (good, place) in enumerate(zip(finite, self._places, strict=True)):
            if good:
                self._events.end("non_finite_torque", place)
            else:
                text = f"axis {axis} was commanded a torque that is no number; it gets 0"
                self._events.begin("non_finite_torque", place, text)
        self._reported = not all(finite)


def _age(ticks: int) -> int:
    """A sample from a tick yet to come is none of this run's."""
    return ticks if 0 <= ticks < NEVER else NEVER
