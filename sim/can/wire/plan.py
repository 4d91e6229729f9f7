"""What a channel asks of those that know how its devices answer a SYNC."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from tonus.sim.can.wire.regular import RegularWire


class SyncPlan(Protocol):
    """How the devices of a channel answer a SYNC while all is as usual."""

    identifier: int
    """of the SYNC"""
    answers: int
    """frames that it brings"""

    def begin(self, wire: RegularWire) -> None:
        """Tell the wire its identifiers, and hand over what waits for the SYNC."""

    def end(self, wire: RegularWire) -> None:
        """Take back what waits for the SYNC."""

    def react(self, wire: RegularWire, now_ns: int) -> None:
        """Deliver the SYNC that has ended now, and do what every device does at it."""

    def follow(self, wire: RegularWire, left: list[int], now_ns: int) -> None:
        """Have drives apply the set-points that were left to them."""


Planner = Callable[[], SyncPlan | None]
"""Makes a channel's plan, or says that there is none for it as it is."""
