"""Set-points that come in process data with the period of 0x60C2: their lines and their absence."""

from __future__ import annotations

from collections.abc import Callable

from tonus.sim.devices.cia402.modes import Interpolation
from tonus.sim.devices.timers import Timers

_MISSING = 2
"""Periods without a PDO that are a time-out: one did not come."""
_MS_NS = 1_000_000


class SetPoints:
    """Does nothing while the period is 0."""

    def __init__(
        self,
        timers: Timers,
        lines: tuple[Interpolation, ...],
        awaited: Callable[[], bool],
        missing: Callable[[], None],
    ) -> None:
        """``missing`` is called when set-points were ``awaited`` and stayed away; the watch begins
        with the first one that comes."""
        self._timers = timers
        self._lines = lines
        self._awaited = awaited
        self._missing = missing
        self._period_ns = 0
        self._heard_ns = 0
        self._watching = False

    def set_period(self, ms: int) -> None:
        self._period_ns = ms * _MS_NS

    @property
    def timed(self) -> bool:
        """Whether set-points are awaited by time."""
        return self._period_ns > 0

    def received(self, now_ns: int) -> None:
        if not self._period_ns:
            return
        self._heard_ns = now_ns
        for line in self._lines:
            line.received()
        if not self._watching and self._awaited():
            self._watching = True
            self._timers.call_at(now_ns + _MISSING * self._period_ns, self._look)

    def _look(self, now_ns: int) -> None:
        due_ns = self._heard_ns + _MISSING * self._period_ns
        self._watching = bool(self._period_ns) and self._awaited() and now_ns < due_ns
        if self._watching:
            self._timers.call_at(due_ns, self._look)
        elif self._period_ns and self._awaited():
            self._missing()
