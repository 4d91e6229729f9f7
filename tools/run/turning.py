"""Virtual time with a look before each tick: for runs that others are forked from."""

from __future__ import annotations

from collections.abc import Callable

from tonus.runtime.timing.scheduler import VirtualPacing


class TurningPacing(VirtualPacing):
    """Calls ``turn``, which may fork the process, before each tick."""

    def __init__(self, turn: Callable[[], None]) -> None:
        self._turn = turn

    async def until(self, due_ns: int) -> None:
        """When virtual time says so."""
        self._turn()
        await super().until(due_ns)
