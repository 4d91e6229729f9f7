"""Virtual time that waits for nobody while there is something to compute, and for people while the
robot is disarmed: a served run would fill the disk with hours of standstill otherwise."""

from __future__ import annotations

from collections.abc import Callable

from tonus.runtime.timing import clock
from tonus.runtime.timing.scheduler import VirtualPacing

_NS = 1e-9


class IdlePacing(VirtualPacing):
    """Ticks as fast as the processor allows, but no faster than ``speed`` times real time while
    ``idle`` says so."""

    def __init__(self, idle: Callable[[], bool], speed: float) -> None:
        self._idle, self._speed = idle, speed
        self._since: tuple[float, int] | None = None
        """wall time (s) and due time (ns) of the first idle tick"""

    async def until(self, due_ns: int) -> None:
        await super().until(due_ns)
        if not self._idle():
            self._since = None
            return
        now = clock.wall_seconds()
        if self._since is None:
            self._since = now, due_ns
        began, first_ns = self._since
        early = began + (due_ns - first_ns) * _NS / self._speed - now
        if early > 0.0:
            clock.pause(early)
