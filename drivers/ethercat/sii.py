"""The slave information interface: a slave's EEPROM, read through its registers (ETG.2010)."""

from __future__ import annotations

import asyncio
import struct
from dataclasses import dataclass, field

from tonus.drivers.errors import BringUpError
from tonus.drivers.ethercat.coe import Registers

_CONTROL, _DATA = 0x0502, 0x0508
_READ_COMMAND = 0x0100
_BUSY, _ERRORS = 0x8000, 0x7800
_VENDOR, _PRODUCT, _REVISION, _WRITE_BOX, _READ_BOX, _CATEGORIES = (
    0x08,
    0x0A,
    0x0C,
    0x18,
    0x1A,
    0x40,
)
_STRINGS, _SYNC_MANAGERS, _END = 10, 41, 0xFFFF
_LONGEST_WORDS = 0x1000
_POLL_S = 1e-3
_POLLS = 100


@dataclass(frozen=True)
class SyncManager:
    """Where its memory starts, and its control byte."""

    start: int
    control: int


_USUAL = (
    SyncManager(0x1000, 0x26),
    SyncManager(0x1080, 0x22),
    SyncManager(0x1100, 0x64),
    SyncManager(0x1180, 0x20),
)
"""Where the EEPROM says nothing."""


@dataclass(frozen=True)
class Image:
    """What of the EEPROM a master needs."""

    vendor: int
    product: int
    revision: int
    write_at: tuple[int, int]
    """start and length of the mailbox that the master writes; 0 long: none"""
    read_at: tuple[int, int]
    name: str = ""
    sync_managers: tuple[SyncManager, ...] = field(default=_USUAL)


async def read(registers: Registers, where: str) -> Image:
    """Raises `BringUpError`."""
    reader = _Reader(registers, where)
    vendor = await reader.double(_VENDOR)
    product = await reader.double(_PRODUCT)
    revision = await reader.double(_REVISION)
    write_box = await reader.double(_WRITE_BOX)
    read_box = await reader.double(_READ_BOX)
    name = ""
    managers: tuple[SyncManager, ...] = _USUAL
    place = _CATEGORIES
    while place < _LONGEST_WORDS:
        head = await reader.double(place)
        kind, words = head & 0xFFFF, head >> 16
        if kind == _END:
            break
        if kind in (_STRINGS, _SYNC_MANAGERS):
            data = await reader.bytes(place + 2, words)
            if kind == _STRINGS and data and data[0]:
                name = data[2 : 2 + data[1]].decode("latin-1")
            elif kind == _SYNC_MANAGERS:
                given = [
                    SyncManager(*struct.unpack_from("<H2xB", data, start))
                    for start in range(0, len(data) - 7, 8)
                ]
                managers = (*given, *_USUAL[len(given) :])
        place += 2 + words
    return Image(vendor, product, revision, _box(write_box), _box(read_box), name, managers)


def _box(word: int) -> tuple[int, int]:
    return word & 0xFFFF, word >> 16


class _Reader:
    def __init__(self, registers: Registers, where: str) -> None:
        self._registers = registers
        self._where = where

    async def double(self, place: int) -> int:
        """Two words. Raises `BringUpError`."""
        await self._registers.write(_CONTROL, struct.pack("<HI", _READ_COMMAND, place))
        for _ in range(_POLLS):
            answer = await self._registers.read(_CONTROL, 2)
            if answer is None or not answer.counter:
                raise BringUpError(f"{self._where}: its EEPROM interface does not answer")
            status = int.from_bytes(answer.data, "little")
            if status & _ERRORS:
                raise BringUpError(f"{self._where}: its EEPROM reports errors 0x{status:04X}")
            if not status & _BUSY:
                break
            await asyncio.sleep(_POLL_S)
        else:
            raise BringUpError(f"{self._where}: its EEPROM stays busy")
        data = await self._registers.read(_DATA, 4)
        if data is None or not data.counter:
            raise BringUpError(f"{self._where}: its EEPROM gives no data")
        return int.from_bytes(data.data, "little")

    async def bytes(self, place: int, words: int) -> bytes:
        parts = [
            (await self.double(place + step)).to_bytes(4, "little") for step in range(0, words, 2)
        ]
        return b"".join(parts)[: 2 * words]
