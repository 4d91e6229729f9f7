"""What a device needs of time: the present, and to be called later."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

Callback = Callable[[int], None]


class Timers(Protocol):
    """Kept by the lab; all times are ns on its clock."""

    @property
    def now_ns(self) -> int: ...

    def call_at(self, at_ns: int, callback: Callback) -> None:
        """Call ``callback(at_ns)`` in the order of time. There is no taking back: a callback that
        is no longer wanted finds that out itself."""
