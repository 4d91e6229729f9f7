"""How frames travel between a lab's process and a bus in another: packets of 24-byte frames.

One SOCK_SEQPACKET packet is a batch; a frame is little-endian: time (ns, u64), identifier with the
flags of `tonus.sim.can.wire.frame` (u32), DLC (u8), 1 where a client gets back what it sent itself
(u8), two zero bytes, eight data bytes. The lab sends error frames, too. A client's "error frame"
`WISHES` has in its first data byte 1 to get its own frames back, in its second how many
milliseconds the lab may gather frames before it sends it a packet.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from tonus.sim.can.wire.frame import BASE_ID, ERROR, EXTENDED, EXTENDED_ID, REMOTE
from tonus.sim.can.wire.inbox import FRAME, RawFrame

_FLAGS_AT = 8 + 3
"""the highest byte of the identifier"""
WISHES = ERROR
FRAMES_PER_PACKET = 128
PACKET_BYTES = FRAMES_PER_PACKET * FRAME.size


def socket_path(directory: Path, channel: str) -> Path:
    """A channel's socket in the directory of its lab."""
    return directory / f"{channel}.sock"


def decode(packet: bytes) -> Iterator[RawFrame]:
    """Every whole frame."""
    whole = len(packet) - len(packet) % FRAME.size
    for stamp_ns, identifier, dlc, own, data in FRAME.iter_unpack(packet[:whole]):
        length = 0 if identifier & REMOTE else min(dlc, 8)
        yield stamp_ns, identifier, dlc, bool(own), data[:length]


def flagged(packet: bytes) -> bool:
    """Whether a frame's identifier carries a flag; most do not."""
    return bool(packet[_FLAGS_AT :: FRAME.size].strip(b"\0"))


def sound(identifier: int, dlc: int) -> bool:
    """Whether a classic controller could send such a frame."""
    number = identifier & EXTENDED_ID
    if not identifier & EXTENDED and number > BASE_ID:
        return False
    return dlc <= 8 and not identifier & ERROR
