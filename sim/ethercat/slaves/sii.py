"""The image in a slave's EEPROM (slave information interface), ETG.1000.6 and ETG.2010."""

from __future__ import annotations

import struct

from tonus.sim.ethercat.slaves.identity import Kind

WORDS = 0x0400
"""Size of the image: 2 KiB; a master may read no more than 4 KiB."""
_FIRST_CATEGORY = 0x40
_STRINGS, _GENERAL, _FMMU, _MANAGERS, _END = 10, 30, 40, 41, 0xFFFF
_COE = 0x0004
_SDO, _INFO, _ASSIGN, _CONFIGURE, _COMPLETE = 0x01, 0x02, 0x04, 0x08, 0x20
_NO_LOGICAL_READ_WRITE = 0x02
_VERSION = 1
_BYTE = 0xFF
_POLYNOMIAL = 0x07
MAILBOX_OUT, MAILBOX_IN, OUTPUTS, INPUTS = 0x26, 0x22, 0x64, 0x20
"""Control bytes of the four sync managers."""


def checksum(data: bytes) -> int:
    """CRC-8 over the configuration area."""
    crc = _BYTE
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ _POLYNOMIAL) & _BYTE if crc & 0x80 else crc << 1 & _BYTE
    return crc


def _category(kind: int, data: bytes) -> bytes:
    data += bytes(len(data) % 2)
    return struct.pack("<HH", kind, len(data) // 2) + data


def managers(kind: Kind) -> list[tuple[int, int, int, int]]:
    """Start, length, control and type of the sync managers the slave has. Lengths of process data
    are those of its mapping, so 0 here."""
    return [
        (kind.receive_mailbox, kind.mailbox_bytes, MAILBOX_OUT, 1),
        (kind.send_mailbox, kind.mailbox_bytes, MAILBOX_IN, 2),
        (kind.outputs, 0, OUTPUTS, 3) if kind.outputs else (0, 0, 0, 0),
        (kind.inputs, 0, INPUTS, 4),
    ]


def image(kind: Kind, serial: int) -> bytearray:
    """What a slave of this kind carries from the factory."""
    head = struct.pack("<HHHHHHH", 0x0080, 0, 0, 0, 0, 0, 0)
    words = bytearray(head + bytes((checksum(head), 0)))
    words += struct.pack("<IIII", kind.vendor, kind.product, kind.revision, serial)
    words += bytes(8)  # bootstrap: none, and delays
    words = words.ljust(2 * 0x18, b"\0")
    size = kind.mailbox_bytes
    words += struct.pack("<HHHHH", kind.receive_mailbox, size, kind.send_mailbox, size, _COE)
    words = words.ljust(2 * 0x3E, b"\0")
    words += struct.pack("<HH", WORDS * 16 // 1024 - 1, _VERSION)
    assert len(words) == 2 * _FIRST_CATEGORY
    texts = (kind.name, kind.group)
    strings = bytes((len(texts),))
    for text in texts:
        strings += bytes((len(text),)) + text.encode("ascii")
    words += _category(_STRINGS, strings)
    details = _SDO | _INFO | _ASSIGN | _CONFIGURE | (_COMPLETE if kind.complete_access else 0)
    flags = 0 if kind.logical_read_write else _NO_LOGICAL_READ_WRITE
    general = bytearray(32)
    general[0:4] = bytes((2, 0, 1, 1))  # group, image, order code, name: numbers of strings
    general[5] = details
    general[11] = flags
    general[12:14] = struct.pack("<h", kind.current_ma)
    words += _category(_GENERAL, bytes(general))
    words += _category(_FMMU, b"\x01\x02\x03\x00" if kind.outputs else b"\x02\x03\x00\x00")
    blocks = b""
    for start, length, control, use in managers(kind):
        blocks += struct.pack("<HHBBBB", start, length, control, 0, int(use != 0), use)
    words += _category(_MANAGERS, blocks)
    words += struct.pack("<H", _END)
    return words.ljust(2 * WORDS, b"\xff")
