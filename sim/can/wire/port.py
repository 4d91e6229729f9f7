"""One controller on a channel, and what it tells its device."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from enum import Enum
from typing import TYPE_CHECKING

from tonus.sim.can.wire.confinement import Counters
from tonus.sim.can.wire.frame import Frame
from tonus.sim.can.wire.inbox import Inbox

if TYPE_CHECKING:
    from tonus.sim.can.wire.channel import Channel


class Notice(Enum):
    """What a controller tells its device, in the order of time."""

    OVERFLOW = "overflow"
    """a frame was lost at the full queue; said again only when the queue was empty since"""
    PASSIVE = "passive"
    BUS_OFF = "bus_off"
    RECOVERED = "recovered"
    """from bus-off"""


Told = Callable[[Notice, int], None]
"""Takes a notice and its time."""


class Port:
    """One controller on a channel, with its transmit queue.

    ``received`` is where frames of others arrive, or None for a device, which subscribes instead.
    """

    def __init__(
        self, channel: Channel, number: int, depth: int, listens: bool, inbox: int | None = None
    ) -> None:
        self.channel = channel
        self.name = f"host {number}" if listens else f"controller {number}"
        self.number = number
        self.depth = depth
        self.errors = Counters()
        self.told: Told | None = None
        self.held = False
        """kept from the arbitration: bus-off, suspended, or the bus is stuck"""
        self.queue: deque[Frame] = deque()
        self.received = Inbox(inbox) if listens else None
        self.echo = False
        """whether the controller receives what it sent itself"""
        self.reports = False
        """whether ``received`` gets error frames as well"""
        self.overflows = 0
        """frames refused because the queue was full"""
        self.overflowing = False
        """since a refusal the queue has not been empty"""
        self.retransmissions = 0

    @property
    def missed(self) -> int:
        """Frames that somebody did not take in time."""
        return self.received.missed if self.received is not None else 0

    @property
    def waiting(self) -> int:
        """Frames in the queue."""
        return len(self.queue) + self.channel.waiting(self)

    @property
    def room(self) -> int:
        return self.depth - self.waiting
