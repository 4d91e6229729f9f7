"""Emergency messages in words: CiA 301 and 402 classes, and the codes of the EPOS4."""

from __future__ import annotations

import struct

_FRAME = struct.Struct("<HB")

WORDS = {
    0x1000: "generic error",
    0x1090: "firmware incompatibility",
    0x2310: "overcurrent",
    0x2320: "power stage protection",
    0x3210: "overvoltage",
    0x3220: "undervoltage",
    0x4210: "thermal overload of the power stage",
    0x4380: "thermal overload of the motor",
    0x5113: "logic supply voltage too low",
    0x5280: "hardware defect",
    0x5281: "hardware incompatibility",
    0x6080: "sign of life error",
    0x6081: "extension watchdog",
    0x6320: "software parameter error",
    0x6380: "persistent parameter corrupt",
    0x7320: "position sensor error",
    0x7380: "position sensor breach",
    0x7381: "position sensor resolution",
    0x7382: "position sensor index",
    0x7388: "Hall sensor, invalid pattern",
    0x7389: "Hall sensor not found",
    0x738A: "Hall sensor angle mismatch",
    0x738C: "SSI sensor sampling",
    0x738D: "SSI sensor frame",
    0x7390: "main sensor missing",
    0x7391: "commutation sensor missing",
    0x7392: "main sensor direction",
    0x8110: "CAN overrun, object lost",
    0x8111: "CAN overrun",
    0x8120: "CAN error passive",
    0x8130: "heartbeat of the master lost",
    0x8150: "transmit PDO identifier collides",
    0x81FD: "CAN bus off",
    0x81FE: "CAN receive queue overflow",
    0x81FF: "CAN transmit queue overflow",
    0x8210: "PDO shorter than its mapping",
    0x8250: "receive PDO timeout",
    0x8611: "following error",
    0x8A80: "negative limit switch",
    0x8A81: "positive limit switch",
    0x8A82: "software position limit",
    0x8A88: "safe torque off",
    0x8A8A: "safe torque off card ready",
    0x8A8B: "safe torque off card inactive",
    0xFF01: "system overloaded",
    0xFF02: "watchdog",
    0xFF0B: "system peak overloaded",
    0xFF10: "controller gain",
}

# CiA 301: what the upper bits of a code that is not listed say. Longest match first.
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


def words(code: int) -> str:
    """What an error code means; 0 is the message that every error is gone."""
    if code == 0:
        return "no error left"
    if code in WORDS:
        return WORDS[code]
    for mask, value, meaning in _CLASSES:
        if code & mask == value:
            return meaning
    return "unknown error"


def parse(data: bytes | bytearray) -> tuple[int, int] | None:
    """(error code, error register 0x1001) of an EMCY frame; None if it is too short for both."""
    if len(data) < _FRAME.size:
        return None
    code, register = _FRAME.unpack_from(data)
    return code, register
