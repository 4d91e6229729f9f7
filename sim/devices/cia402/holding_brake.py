"""A holding brake on the motor, open while its coil has power.

The brake takes its own times; the drive waits for those of 0x3158 (EPOS4: 1 rise, 2 fall), and
follows set-points too soon, or takes the power too soon, where they are shorter.
"""

from __future__ import annotations

from collections.abc import Callable

from tonus.config.schema.axis import Brake
from tonus.sim.devices.objects import ObjectDictionary
from tonus.sim.devices.samples import Measured
from tonus.sim.devices.timers import Timers

OPEN, CLOSED = 0, 1
_MS_NS = 1_000_000


class HoldingBrake:
    """Does nothing, at once, where none is fitted."""

    def __init__(
        self,
        axis: int,
        objects: ObjectDictionary,
        plant: Measured,
        timers: Timers,
        brake: Brake | None,
    ) -> None:
        self._axis = axis
        self._objects = objects
        self._plant = plant
        self._timers = timers
        self._brake = brake
        self._order = 0  # number of the last order; a timer of an older one is stale
        self._turn = 0  # the same of the coil, which two equal orders switch once
        self._coil_closes = self.fitted
        self.closed = self.fitted
        objects.find(0x3158, 3).read = lambda: CLOSED if self.closed else OPEN
        if self.fitted:
            plant.locked[axis] = True

    @property
    def fitted(self) -> bool:
        return self._brake is not None

    def open(self, then: Callable[[], None]) -> None:
        """Let the motor go; ``then`` when the drive takes it for free."""
        if self._brake is not None:
            self._move(self._brake.opening_ms, 0x01, False, then)
        else:
            then()

    def close(self, then: Callable[[], None]) -> None:
        """Hold the motor; ``then`` when the drive takes it for held."""
        if self._brake is not None:
            self._move(self._brake.closing_ms, 0x02, True, then)
        else:
            then()

    def _move(self, own_ms: float, waited: int, closed: bool, then: Callable[[], None]) -> None:
        self._order += 1
        turned, self._coil_closes = self._coil_closes is not closed, closed
        if turned:
            self._turn += 1
        if self.closed is closed:
            then()
            return
        order, turn, now_ns = self._order, self._turn, self._timers.now_ns

        def moved(at_ns: int) -> None:
            if turn == self._turn:
                self._plant.advance(at_ns)
                self._plant.locked[self._axis] = self.closed = closed

        def waited_for(_: int) -> None:
            if order == self._order:
                then()

        if turned:
            self._timers.call_at(now_ns + round(own_ms * _MS_NS), moved)
        wait_ns = self._objects.number(0x3158, waited) * _MS_NS
        self._timers.call_at(now_ns + wait_ns, waited_for)
