"""The EPOS4's errors: code, bit of the error register, and what the drive does, as its maker says.

Reactions: "D" power off at once; "A" as 0x6007 says; "F" as 0x605E says; "W" only warns.
"""

from __future__ import annotations

from dataclasses import dataclass

HEARTBEAT_LOST = 0x8130
CAN_PASSIVE = 0x8120
PDO_LENGTH = 0x8210
OVERLOADED = 0xFF01

NEEDS_COMMUNICATION_RESET = frozenset({CAN_PASSIVE, HEARTBEAT_LOST})
"""A fault reset is refused until NMT reset communication."""


@dataclass(frozen=True)
class Error:
    register: int
    reaction: str


def _group(register: int, reaction: str, *codes: int) -> dict[int, Error]:
    return {code: Error(register, reaction) for code in codes}


ERRORS: dict[int, Error] = {
    **_group(0x01, "D", 0x1000, *range(0x1080, 0x1084), 0x1090),
    **_group(0x02, "D", 0x2310, 0x2320),
    **_group(0x04, "D", 0x3210, 0x3220, 0x5113),
    **_group(0x08, "D", 0x4210, 0x4380),
    **_group(0x01, "D", 0x5280, 0x5281, 0x5282, 0x5480, 0x5481, 0x5482, 0x5483),
    **_group(0x01, "D", 0x6080, 0x6180, 0x61F0, 0x6380),
    **_group(0x01, "A", 0x6081),
    **_group(0x01, "F", 0x6320),
    **_group(0x20, "D", 0x7320, 0x7380, 0x7381, 0x7382, 0x7388, 0x7389, 0x738A),
    **_group(0x20, "D", 0x738C, 0x738D, 0x7390, 0x7391, 0x7392),
    **_group(0x10, "A", 0x8110, 0x8111, CAN_PASSIVE, HEARTBEAT_LOST, 0x8150),
    **_group(0x10, "A", 0x81FD, 0x81FE, 0x81FF, PDO_LENGTH, 0x8250),
    **_group(0x80, "F", 0x8611, 0x8A80, 0x8A81, 0x8A82),
    **_group(0x01, "D", 0x8A88, 0x8A8A, 0x8A8B, 0xFF02, 0xFF0B),
    **_group(0x00, "W", OVERLOADED),
    **_group(0x20, "F", 0xFF10),
}
