"""Keeping the loop's phase to a clock on the bus: the pacing policy ``distributed_clock``."""

from __future__ import annotations

from typing import Protocol

from tonus.config.schema.bus import DistributedClocks
from tonus.runtime.timing.scheduler import Pacing


class Reference(Protocol):
    """A bus whose devices have a common clock."""

    def phase_error_ns(self, due_ns: int) -> int | None:
        """How much later than the bus would have it a tick is due, -period/2 to period/2; None
        while that is not known."""


class SteeredPacing:
    """Another pacing, whose ticks follow a reference clock: proportional and integral, in ns.

    The integral is what one period of the loop and one of the reference differ by. It is limited
    with the step as a whole, so that a reference that leaps is followed slowly and not past it.
    """

    def __init__(self, pacing: Pacing, reference: Reference, clocks: DistributedClocks) -> None:
        self._pacing = pacing
        self._reference = reference
        self._proportional, self._integral = clocks.proportional, clocks.integral
        self._slew_ns = clocks.slew_ns
        self._sum_ns = 0.0

    async def until(self, due_ns: int) -> int | None:
        return await self._pacing.until(due_ns)

    def steer(self, due_ns: int) -> int:
        error = self._reference.phase_error_ns(due_ns)
        if error is None:
            return -round(self._sum_ns)
        slew = self._slew_ns
        wanted = self._sum_ns + self._integral * error
        self._sum_ns = min(max(wanted, -slew), slew)
        step = self._sum_ns + self._proportional * error
        return -round(min(max(step, -slew), slew))

    def close(self) -> None:
        self._pacing.close()
