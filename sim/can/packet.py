"""How frames travel between a lab's process and a bus in another: packets of 24-byte frames.

One SOCK_SEQPACKET packet is a batch; a frame is little-endian: time (ns, u64), identifier with the
flags of `tonus.sim.can.wire.frame` (u32), DLC (u8), 1 where a client gets back what it sent itself
(u8), channel (u16), eight data bytes. The lab sends error frames, too. A client's "error frame"
`WISHES` has in its first data byte 1 to get its own frames back, in its second how many
milliseconds the lab may gather frames before it sends it a packet.

A client of several channels may have all its frames in the packets of one connection, the carrier:
a system call each way instead of one a channel. On each of its connections `WISHES` then has how
many there are in the third byte, which of them this is in the fourth, and in the last four bytes a
number that they share. When the lab has heard of all it sends `AGREED` on the first, which is the
carrier from then on: a frame's channel is the number of the connection that it is of. Until then,
and without such wishes, it is 0. Where a channel's queue is full the lab sends `APART` on the
carrier: the client sends on each connection by itself again, so that one which is full holds up no
other, and goes on to receive by the carrier.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Self

from tonus.sim.can.wire.frame import BASE_ID, ERROR, EXTENDED, EXTENDED_ID, REMOTE
from tonus.sim.can.wire.inbox import FRAME, RawFrame

_FLAGS_AT = 8 + 3
"""the highest byte of the identifier"""
ADDRESSED = struct.Struct("<QIBBH8s")
"""`FRAME` with its channel"""
WISHES = ERROR
AGREED = FRAME.pack(0, WISHES, 0, 0, b"")
APART = FRAME.pack(0, WISHES, 1, 0, b"\1")
FRAMES_PER_PACKET = 128
PACKET_BYTES = FRAMES_PER_PACKET * FRAME.size


class Wishes(NamedTuple):
    """What a client asks for."""

    echo: bool = False
    gather_ms: int = 0
    connections: int = 0
    """that have one carrier, 0: this one alone"""
    number: int = 0
    """of this connection among them"""
    shared: bytes = bytes(4)
    """by them alone"""

    def packed(self) -> bytes:
        """As a frame."""
        data = bytes((self.echo, self.gather_ms, self.connections, self.number)) + self.shared
        return FRAME.pack(0, WISHES, len(data), 0, data)

    @classmethod
    def of(cls, data: bytes) -> Self:
        """Of a frame's data; bytes that are missing are 0."""
        data = data.ljust(8, b"\0")
        return cls(data[0] == 1, data[1], data[2], data[3], data[4:8])


def socket_path(directory: Path, channel: str) -> Path:
    """A channel's socket in the directory of its lab."""
    return directory / f"{channel}.sock"


def decode(packet: bytes | bytearray) -> Iterator[RawFrame]:
    """Every whole frame."""
    whole = len(packet) - len(packet) % FRAME.size
    for stamp_ns, identifier, dlc, own, data in FRAME.iter_unpack(packet[:whole]):
        length = 0 if identifier & REMOTE else min(dlc, 8)
        yield stamp_ns, identifier, dlc, bool(own), data[:length]


def flagged(packet: bytes | bytearray) -> bool:
    """Whether a frame's identifier carries a flag; most do not."""
    return bool(packet[_FLAGS_AT :: FRAME.size].strip(b"\0"))


def sound(identifier: int, dlc: int) -> bool:
    """Whether a classic controller could send such a frame."""
    number = identifier & EXTENDED_ID
    if not identifier & EXTENDED and number > BASE_ID:
        return False
    return dlc <= 8 and not identifier & ERROR
