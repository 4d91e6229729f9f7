"""EtherCAT frames: the Ethernet header, the datagrams and their commands."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

ETHERTYPE = 0x88A4
HEAD_BYTES = 16
"""Ethernet header and EtherCAT header"""
DATAGRAM = struct.Struct("<BBHHHH")
"""command, index, address position, address offset, length and flags, interrupt"""
COUNTER_BYTES = 2
LENGTH_BITS = 0x07FF
MORE = 0x8000
LONGEST = 1514
"""Bytes of an Ethernet frame without its check sequence."""
_HEADER = struct.Struct("<H")
_TYPE_DATAGRAMS = 1
_BROADCAST = b"\xff" * 6
MASTER = b"\x01\x01\x01\x01\x01\x01"
PASSED = 0x02
"""Bit the first slave sets in the first byte of the source address."""


class Command(IntEnum):
    """Of a datagram."""

    NOP = 0
    APRD = 1
    APWR = 2
    APRW = 3
    FPRD = 4
    FPWR = 5
    FPRW = 6
    BRD = 7
    BWR = 8
    BRW = 9
    LRD = 10
    LWR = 11
    LRW = 12
    ARMW = 13
    FRMW = 14


@dataclass
class Datagram:
    """One of a frame. ``address``: position or station in the low, offset in the high 16 bits of
    a physical address; logical addresses have 32 bits."""

    command: int
    address: int
    data: bytes
    index: int = 0
    counter: int = 0


def physical(place: int, offset: int) -> int:
    """Address word of a position or station, and of a register."""
    return place & 0xFFFF | offset << 16


def is_ethercat(frame: bytes | bytearray) -> bool:
    """Whether a frame carries datagrams."""
    return (
        len(frame) > HEAD_BYTES
        and frame[12] == ETHERTYPE >> 8
        and frame[13] == ETHERTYPE & 0xFF
        and frame[15] >> 4 == _TYPE_DATAGRAMS
    )


def build(datagrams: Iterable[Datagram], source: bytes = MASTER) -> bytes:
    """A full Ethernet frame, without its check sequence."""
    listed = tuple(datagrams)
    body = bytearray()
    for number, one in enumerate(listed, start=1):
        more = MORE if number < len(listed) else 0
        place, offset = one.address & 0xFFFF, one.address >> 16
        body += DATAGRAM.pack(one.command, one.index, place, offset, len(one.data) | more, 0)
        body += one.data + _HEADER.pack(one.counter)
    ethertype = ETHERTYPE.to_bytes(2, "big")
    head = _HEADER.pack(len(body) | _TYPE_DATAGRAMS << 12)
    return bytes(_BROADCAST + source + ethertype + head + body)


def parse(frame: bytes) -> list[Datagram]:
    """The datagrams of a frame that `build` or a segment has made."""
    found = []
    at, more = HEAD_BYTES, True
    while more:
        command, index, place, offset, length, _ = DATAGRAM.unpack_from(frame, at)
        at += DATAGRAM.size
        size = length & LENGTH_BITS
        data = bytes(frame[at : at + size])
        (counter,) = _HEADER.unpack_from(frame, at + size)
        found.append(Datagram(command, place | offset << 16, data, index, counter))
        at += size + COUNTER_BYTES
        more = bool(length & MORE)
    return found
