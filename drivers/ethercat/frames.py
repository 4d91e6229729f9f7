"""EtherCAT frames as a master writes and reads them (ETG.1000.4).

An Ethernet frame of type 0x88A4, a 2-byte header with the length and type 1, then datagrams: a
10-byte header, data, and a working counter that every slave which took part has raised.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

ETHERTYPE = 0x88A4
ETHERNET = bytes.fromhex("ffffffffffff 020101010101 88a4")
"""To all, from a locally administered address."""
MINIMUM_BYTES = 60
MAXIMUM_DATA = 1486
FIRST_DATAGRAM = 16
"""Where it starts in a frame."""
HEADER_BYTES = 10
COUNTER_BYTES = 2
INDEX_AT = FIRST_DATAGRAM + 1
_HEADER = struct.Struct("<BBIHH")
_LENGTH = 0x07FF
_MORE = 0x8000
_TYPE = 1 << 12


class Command(IntEnum):
    """Datagram commands that this master sends."""

    APRD = 1
    APWR = 2
    FPRD = 4
    FPWR = 5
    BRD = 7
    BWR = 8
    LRW = 12
    FRMW = 14


@dataclass(frozen=True)
class Datagram:
    """``address`` is ADP | ADO << 16, or a logical address."""

    command: Command
    address: int
    data: bytes


class Answer(NamedTuple):
    data: bytes
    counter: int


def position(place: int, register: int) -> int:
    """Auto-increment address of the slave at ``place``, from 0."""
    return -place & 0xFFFF | register << 16


def station(address: int, register: int) -> int:
    """Address of the slave with that configured station address."""
    return address | register << 16


def everyone(register: int) -> int:
    """Broadcast address."""
    return register << 16


def build(index: int, datagrams: Sequence[Datagram]) -> bytes:
    """One Ethernet frame, padded to the shortest there is. ``index`` (a byte) comes back in the
    answer. The caller keeps the data below `MAXIMUM_DATA`."""
    parts = []
    last = len(datagrams) - 1
    for number, each in enumerate(datagrams):
        length = len(each.data) | (_MORE if number < last else 0)
        parts.append(_HEADER.pack(each.command, index, each.address, length, 0))
        parts.append(each.data)
        parts.append(bytes(COUNTER_BYTES))
    body = b"".join(parts)
    frame = ETHERNET + struct.pack("<H", len(body) | _TYPE) + body
    return frame.ljust(MINIMUM_BYTES, b"\0")


def parse(frame: bytes, index: int, datagrams: Sequence[Datagram]) -> list[Answer] | None:
    """The answers to the datagrams of the frame with that index; None for any other frame."""
    answers = []
    place = FIRST_DATAGRAM
    for each in datagrams:
        size = len(each.data)
        end = place + HEADER_BYTES + size
        if end + COUNTER_BYTES > len(frame):
            return None
        command, found, _, length, _ = _HEADER.unpack_from(frame, place)
        if command != each.command or found != index or length & _LENGTH != size:
            return None
        counter = frame[end] | frame[end + 1] << 8
        answers.append(Answer(bytes(frame[place + HEADER_BYTES : end]), counter))
        place = end + COUNTER_BYTES
    return answers
