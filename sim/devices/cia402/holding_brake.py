"""A holding brake on the motor, open while its coil has power (0x3158)."""

from __future__ import annotations

from collections.abc import Callable

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
        *,
        fitted: bool,
    ) -> None:
        self._axis = axis
        self._objects = objects
        self._plant = plant
        self._timers = timers
        self.fitted = fitted
        self._order = 0  # number of the last order; a timer of an older one is stale
        self.closed = fitted
        objects.find(0x3158, 3).read = lambda: CLOSED if self.closed else OPEN
        if fitted:
            plant.locked[axis] = True

    def open(self, then: Callable[[], None]) -> None:
        """Let the motor go; ``then`` when it is free."""
        self._move(0x01, False, then)

    def close(self, then: Callable[[], None]) -> None:
        """Hold the motor; ``then`` when it is held."""
        self._move(0x02, True, then)

    def _move(self, time: int, closed: bool, then: Callable[[], None]) -> None:
        self._order += 1
        if not self.fitted or self.closed is closed:
            then()
            return
        order = self._order

        def done(at_ns: int) -> None:
            if order == self._order:
                self._plant.advance(at_ns)
                self._plant.locked[self._axis] = self.closed = closed
                then()

        wait_ns = self._objects.number(0x3158, time) * _MS_NS
        self._timers.call_at(self._timers.now_ns + wait_ns, done)
