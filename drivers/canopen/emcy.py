"""Emergency messages in words: the classes of CiA 301 and 402, and the errors of the EPOS4."""

from __future__ import annotations

import struct

from tonus.drivers.devices.epos4_errors import ERRORS

_FRAME = struct.Struct("<HB")

# What the upper bits of a code say. Longest match first.
_CLASSES = (
    (0xFF00, 0x8100, "communication error"),
    (0xFF00, 0x8200, "protocol error"),
    (0xFF00, 0x8300, "torque control error"),
    (0xFF00, 0x8400, "speed control error"),
    (0xFF00, 0x8500, "position control error"),
    (0xFF00, 0xFF00, "device specific error"),
    (0xF000, 0x1000, "generic error"),
    (0xF000, 0x2000, "current error"),
    (0xF000, 0x3000, "voltage error"),
    (0xF000, 0x4000, "temperature error"),
    (0xF000, 0x5000, "hardware error"),
    (0xF000, 0x6000, "software error"),
    (0xF000, 0x7000, "additional module error"),
    (0xF000, 0x8000, "monitoring error"),
    (0xF000, 0x9000, "external error"),
)


def words(code: int, *, drive: bool) -> str:
    """What an error code of a drive, or of any other device, means and leads to; 0 is the message
    that every error is gone."""
    if code == 0:
        return "no error left"
    if drive and code in ERRORS:
        return str(ERRORS[code])
    for mask, value, meaning in _CLASSES:
        if code & mask == value:
            return meaning
    return "unknown error"


def parse(data: bytes) -> tuple[int, int] | None:
    """(error code, error register 0x1001) of an EMCY frame; None if it is too short for both."""
    if len(data) < _FRAME.size:
        return None
    code, register = _FRAME.unpack_from(data)
    return code, register
