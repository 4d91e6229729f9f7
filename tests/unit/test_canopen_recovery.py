"""What a reset brings back, and what stays in doubt."""

from __future__ import annotations

import asyncio
import contextlib
from types import SimpleNamespace
from typing import Any

import pytest

from tonus.drivers.canopen.recovery import Recovery
from tonus.drivers.events import EventLog


class Held(Recovery):
    """A node that comes back, or does not, or one that takes until somebody cancels it."""

    def __init__(self, comes_back: bool | None) -> None:
        self.supervisor: Any = SimpleNamespace(doubt=True)
        supervision: Any = SimpleNamespace(watched=["node"])
        super().__init__(supervision, self.supervisor, SimpleNamespace(), EventLog())  # type: ignore[arg-type]
        self._comes_back = comes_back
        self.doubted: list[bool] = []

    async def _bring_back(self, watched: Any, *, doubt: bool) -> bool:
        self.doubted.append(doubt)
        if self._comes_back is None:
            await asyncio.Event().wait()
        return bool(self._comes_back)


@pytest.mark.parametrize(("comes_back", "left"), [(True, False), (False, True), (None, True)])
def test_a_doubt_is_over_only_when_every_node_is_back(comes_back: bool | None, left: bool) -> None:
    """Not when an emergency stop has cancelled it."""

    async def main() -> Held:
        recovery = Held(comes_back)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(recovery(), 0.05)
        return recovery

    recovery = asyncio.run(main())
    assert recovery.doubted == [True]
    assert recovery.supervisor.doubt is left
