"""The process data watchdog of a slave controller."""

from __future__ import annotations

from collections.abc import Callable

from tonus.sim.devices.timers import Timers
from tonus.sim.ethercat.slaves import registers as reg
from tonus.sim.ethercat.slaves.controller import Controller

_OUT = 2
_STATUS = reg.WATCHDOG_STATUS
_TICK_NS = 40
"""of its divider (0x400)"""
_LONGEST_NS = 1_000_000_000
"""No timer waits longer, so that old ones do not gather."""
_MOST = 0xFF


class Watchdog:
    """Watches the outputs while it is on; ``bite`` is called, with the time, when they have stayed
    away longer than the registers 0x400 and 0x420 allow."""

    def __init__(self, controller: Controller, timers: Timers, bite: Callable[[int], None]) -> None:
        self._controller = controller
        self._memory = controller.memory
        self._timers = timers
        self._bite = bite
        self._on = False
        self._heard_ns = 0
        self._watch = 0  # timers of an older watch are stale

    def start(self, now_ns: int) -> None:
        self._on = True
        self._heard_ns = now_ns
        self._expect(now_ns)

    def stop(self) -> None:
        self._on = False
        self._watch += 1

    def heard(self, now_ns: int) -> None:
        """Outputs have come."""
        self._heard_ns = now_ns
        self._memory[_STATUS] = 1

    def changed(self, now_ns: int) -> None:
        """Its time may be another."""
        if self._on:
            self._expect(now_ns)

    def count(self) -> None:
        """Show the master that it has expired."""
        memory = self._controller.memory
        memory[reg.WATCHDOG_STATUS] = 0
        memory[reg.WATCHDOG_COUNT] = min(memory[reg.WATCHDOG_COUNT] + 1, _MOST)

    def _patience_ns(self) -> int:
        """How long outputs may stay away; 0: for ever."""
        controller = self._controller
        if not controller.managers[_OUT].guards:
            return 0
        return controller.word(reg.WATCHDOG_TIME) * _TICK_NS * (controller.word(reg.DIVIDER) + 2)

    def _expect(self, now_ns: int) -> None:
        """Look again when the outputs would be overdue."""
        self._watch += 1
        patience_ns = self._patience_ns()
        if patience_ns:
            due_ns = min(max(self._heard_ns + patience_ns, now_ns + 1), now_ns + _LONGEST_NS)
            watch = self._watch
            self._timers.call_at(due_ns, lambda at_ns: self._look(watch, at_ns))

    def _look(self, watch: int, now_ns: int) -> None:
        if watch != self._watch:
            return
        patience_ns = self._patience_ns()
        if not patience_ns or now_ns < self._heard_ns + patience_ns:
            self._expect(now_ns)
        else:
            self._bite(now_ns)
