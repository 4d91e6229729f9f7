"""PDOs: mapping words to struct formats, and the configuration procedure of CiA 301."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum

from tonus.drivers.canopen.identifiers import PDO_SPACING, RPDO1, TPDO1
from tonus.drivers.cia301.abort_codes import NO_SUCH_OBJECT
from tonus.drivers.cia301.setting import ObjectAccess
from tonus.drivers.errors import DriverError, SdoAbortError

INVALID = 1 << 31
NO_REMOTE_REQUEST = 1 << 30
EVERY_SYNC = 1
"""Transmission type: sampled, or applied, at each SYNC."""
ON_EVENT = 255
"""Transmission type: sent when it changes, or applied when it arrives."""

# Objects whose type is not an unsigned integer: the mapping word tells the length only.
_SIGNED = frozenset(
    {0x6060, 0x6061, 0x6062, 0x6064, 0x606B, 0x606C, 0x6071, 0x6077, 0x607A, 0x60B0, 0x60B1,
     0x60B2, 0x60F4, 0x60FF, 0x7130, 0x9130}
)  # fmt: skip
_REAL = frozenset({0x6130})
_UNSIGNED_FORMAT = {8: "B", 16: "H", 32: "I", 64: "Q"}


class Direction(Enum):
    """Seen from the device, as in CiA 301: an RPDO is received by the drive."""

    RPDO = (0x1400, 0x1600, RPDO1)
    TPDO = (0x1800, 0x1A00, TPDO1)


class Kind(IntEnum):
    """Of a number in a PDO."""

    UNSIGNED = 0
    SIGNED = 1
    REAL = 2


class PdoError(DriverError):
    """A PDO cannot be described, or reads back other than it was written."""


@dataclass(frozen=True)
class Mapping:
    """A PDO's entries in order, compiled: ``layout`` packs and unpacks one frame's data."""

    entries: tuple[int, ...]
    layout: struct.Struct

    @staticmethod
    def of(entries: Sequence[int]) -> Mapping:
        """Raises `PdoError` for an entry whose length is no whole number type."""
        return Mapping(tuple(entries), struct.Struct("<" + "".join(map(_format, entries))))

    def position(self, entry: int) -> int:
        """Where an object stands among the unpacked values. Raises `PdoError` if nowhere."""
        if entry not in self.entries:
            raise PdoError(f"the PDO does not map {_name(entry)}")
        return self.entries.index(entry)

    def bits(self, entry: int) -> tuple[Kind, int, int]:
        """An object's kind, first bit and length. Raises `PdoError` if it is not mapped."""
        place = self.position(entry)
        letter = _format(entry)
        kind = Kind.REAL if letter == "f" else Kind.SIGNED if letter.islower() else Kind.UNSIGNED
        before = struct.calcsize("<" + "".join(map(_format, self.entries[:place])))
        return kind, 8 * before, entry & 0xFF


def _format(entry: int) -> str:
    index, bits = entry >> 16, entry & 0xFF
    if index in _REAL and bits == 32:
        return "f"
    if bits not in _UNSIGNED_FORMAT:
        raise PdoError(f"{_name(entry)} has {bits} bits; 8, 16, 32 and 64 can be carried")
    letter = _UNSIGNED_FORMAT[bits]
    return letter.lower() if index in _SIGNED else letter


def _name(entry: int) -> str:
    return f"0x{entry >> 16:04X}:{entry >> 8 & 0xFF}"


def identifier(direction: Direction, number: int, node_id: int) -> int:
    """COB-ID of PDO ``number`` (from 1) in the predefined connection set."""
    return direction.value[2] + (number - 1) * PDO_SPACING + node_id


async def configure(
    access: ObjectAccess,
    direction: Direction,
    number: int,
    node_id: int,
    entries: Sequence[int],
    transmission: int = EVERY_SYNC,
) -> None:
    """Map ``entries``, give the PDO its transmission type, and read everything back.

    The order is CiA 301's: identifier invalid, count 0, entries, count, type, identifier valid.
    Raises `PdoError` when what is read differs, and `SdoError`.
    """
    communication = direction.value[0] + number - 1
    mapping = direction.value[1] + number - 1
    cob_id = identifier(direction, number, node_id)
    if direction is Direction.TPDO:
        cob_id |= NO_REMOTE_REQUEST
    await access.write(communication, 1, _word(cob_id | INVALID, 4))
    await access.write(mapping, 0, _word(0, 1))
    for subindex, entry in enumerate(entries, start=1):
        await access.write(mapping, subindex, _word(entry, 4))
    await access.write(mapping, 0, _word(len(entries), 1))
    await access.write(communication, 2, _word(transmission, 1))
    await access.write(communication, 1, _word(cob_id, 4))

    async def expect(index: int, subindex: int, wanted: int, ignored: int = 0) -> None:
        found = int.from_bytes(await access.read(index, subindex), "little")
        if found & ~ignored != wanted & ~ignored:
            raise PdoError(
                f"{direction.name}{number}: 0x{index:04X}:{subindex} reads 0x{found:X}, "
                f"not 0x{wanted:X} as written"
            )

    await expect(communication, 1, cob_id, ignored=NO_REMOTE_REQUEST)
    await expect(communication, 2, transmission)
    await expect(mapping, 0, len(entries))
    for subindex, entry in enumerate(entries, start=1):
        await expect(mapping, subindex, entry)


async def silence(access: ObjectAccess, direction: Direction, number: int) -> None:
    """Make a PDO that is not used invalid, if the device has it. Raises `SdoError`."""
    communication = direction.value[0] + number - 1
    try:
        cob_id = int.from_bytes(await access.read(communication, 1), "little")
    except SdoAbortError as error:
        if error.code == NO_SUCH_OBJECT:
            return
        raise
    if not cob_id & INVALID:
        await access.write(communication, 1, _word(cob_id | INVALID, 4))


def _word(value: int, size: int) -> bytes:
    return value.to_bytes(size, "little")
