"""A CAN frame as the lab carries it, and its place in the arbitration."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tonus.sim.can.wire.port import Port

EXTENDED = 1 << 31
REMOTE = 1 << 30
ERROR = 1 << 29
"""Flags above the 29 bits of an identifier."""
BASE_ID = 0x7FF
EXTENDED_ID = 0x1FFFFFFF


BASE_SHIFT = 21
"""The key of a data frame of base identifier is that identifier, shifted."""


def arbitration_key(identifier: int) -> int:
    """Order on the bus: of two frames that start together the smaller key wins.

    The bits as they go over the wire: a base frame beats an extended one of the same base
    identifier, a data frame a remote one.
    """
    remote = identifier >> 30 & 1
    if identifier & EXTENDED:
        base = identifier >> 18 & BASE_ID
        return base << BASE_SHIFT | 3 << 19 | (identifier & 0x3FFFF) << 1 | remote
    return (identifier & BASE_ID) << BASE_SHIFT | remote << 20


class Frame:
    """What is on the wire; shared by all who receive it and never changed after its end."""

    __slots__ = ("data", "dlc", "identifier", "key", "queued_ns", "sender", "stamp_ns")
    echoed = True
    """whether the controller tells its host that it has sent it"""

    # Set on the way, and not before: a frame is made for every frame sent.
    queued_ns: int
    """when it entered its sender's queue"""
    sender: Port | None
    """set with its first bit"""
    stamp_ns: int
    """time of the last bit of end of frame"""

    def __init__(
        self, identifier: int, data: bytes, dlc: int | None = None, key: int | None = None
    ) -> None:
        """``identifier`` with the flags above; ``dlc`` unless it is the length."""
        self.identifier = identifier
        self.data = data
        self.dlc = len(data) if dlc is None else dlc
        self.key = arbitration_key(identifier) if key is None else key
