"""The EPOS4's errors: code, bits of the error register, what the drive does, and how it recovers.

Reactions: "D" power off at once; "A" as 0x6007 says; "F" as 0x605E says; "W" only warns.
"""

from __future__ import annotations

from tonus.sim.devices.cia402.errors import (
    CAN_PASSIVE,
    FOLLOWING,
    HEARTBEAT_LOST,
    OVERHEATED,
    OVERVOLTAGE,
    PDO_LENGTH,
    PDO_TIMEOUT,
    UNDERVOLTAGE,
    Codes,
    Error,
    Recovery,
)

MOTOR_OVERHEATED = 0x4380
CORRUPT_PARAMETERS = 0x6380
NEGATIVE_LIMIT = 0x8A80
POSITIVE_LIMIT = 0x8A81
SOFTWARE_LIMIT = 0x8A82
TORQUE_OFF = 0x8A88
OVERLOADED = 0xFF01
CODES = Codes(
    motor_overheated=MOTOR_OVERHEATED,
    software_limit=SOFTWARE_LIMIT,
    negative_limit=NEGATIVE_LIMIT,
    positive_limit=POSITIVE_LIMIT,
    torque_off=TORQUE_OFF,
)


def _group(register: int, reaction: str, *codes: int) -> dict[int, Error]:
    return {code: Error(register, reaction) for code in codes}


def _special(recovery: Recovery, register: int, reaction: str, *codes: int) -> dict[int, Error]:
    return {code: Error(register, reaction, recovery) for code in codes}


def _lost(register: int, *codes: int) -> dict[int, Error]:
    return {code: Error(register, "D", loses_position=True) for code in codes}


ERRORS: dict[int, Error] = {
    **_group(0x01, "D", 0x1000, 0x1090),
    **_special(Recovery.DEVICE, 0x01, "D", *range(0x1080, 0x1089)),
    **_group(0x02, "D", 0x2310, 0x2320),
    **_special(Recovery.IN_RANGE, 0x04, "D", OVERVOLTAGE, UNDERVOLTAGE, 0x5113),
    **_special(Recovery.IN_RANGE, 0x08, "D", OVERHEATED, MOTOR_OVERHEATED),
    **_special(Recovery.DEVICE, 0x01, "D", 0x5280, 0x5281, 0x5282),
    **_special(Recovery.DEVICE, 0x01, "D", 0x5480, 0x5481, 0x5482, 0x5483),
    **_group(0x01, "D", 0x6080, 0x6180, 0x61F0, CORRUPT_PARAMETERS),
    **_group(0x01, "A", 0x6081),
    **_group(0x01, "F", 0x6320),
    **_group(0x20, "D", 0x7320, 0x738C, 0x738D, 0x7390, 0x7391),
    **_lost(0x20, 0x7380, 0x7381, 0x7382, 0x7388, 0x7389, 0x738A, 0x7392),
    **_group(0x10, "A", 0x8110, 0x8111, 0x8150, 0x81FD, 0x81FE, 0x81FF, PDO_LENGTH, PDO_TIMEOUT),
    **_special(Recovery.COMMUNICATION, 0x10, "A", CAN_PASSIVE, HEARTBEAT_LOST),
    **_group(0x10, "A", 0x8180, 0x8182, 0x8183, 0x8184, 0x8280, 0x8281),
    **_group(0x10, "D", 0x8181),
    **_group(0x80, "F", FOLLOWING, NEGATIVE_LIMIT, POSITIVE_LIMIT, SOFTWARE_LIMIT),
    **_group(0x01, "D", TORQUE_OFF, 0x8A8B, 0xFF0B),
    **_group(0x01, "W", 0x8A8A),
    **_special(Recovery.HISTORY, 0x00, "W", OVERLOADED),
    **_lost(0x01, 0xFF02),
    **_group(0x20, "F", 0xFF10),
    **_group(0x20, "D", *range(0xFF11, 0xFF18), 0xFF19, *range(0xFF20, 0xFF25)),
}
"""0x8A8A stands in the maker's table with the others of its group, but has a warning's effect."""
