"""Network management: commands to a node, and what its boot-up and heartbeat say of it."""

from __future__ import annotations

from enum import IntEnum


class Command(IntEnum):
    START = 0x01
    STOP = 0x02
    ENTER_PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class NmtState(IntEnum):
    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F

    @property
    def words(self) -> str:
        return self.name.lower().replace("_", "-")


_STATES = frozenset(int(state) for state in NmtState)


def command(code: Command, node_id: int) -> bytes:
    """Data of the NMT frame (identifier 0); node 0 is every node."""
    return bytes((code, node_id))


class NodeMonitor:
    """What the frames on 0x700 + node id have said so far."""

    __slots__ = ("boots", "heard", "state")

    def __init__(self) -> None:
        self.state: NmtState | None = None
        self.boots = 0
        self.heard = False
        """set by every frame; whoever watches for silence clears it"""

    def receive(self, data: bytes | bytearray) -> NmtState | None:
        """The state a frame tells, or None if it tells nothing. Bit 7 is node guarding's toggle."""
        if len(data) != 1 or data[0] & 0x7F not in _STATES:
            return None
        state = NmtState(data[0] & 0x7F)
        self.heard = True
        self.state = state
        if state is NmtState.BOOT_UP:
            self.boots += 1
        return state
