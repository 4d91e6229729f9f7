"""What a drive knows of an error: bits of the error register, reaction, and how it is reset.

Reactions: "D" power off at once; "A" as 0x6007 says; "F" as 0x605E says; "W" only warns.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

OVERVOLTAGE = 0x3210
UNDERVOLTAGE = 0x3220
OVERHEATED = 0x4210
CAN_PASSIVE = 0x8120
HEARTBEAT_LOST = 0x8130
PDO_LENGTH = 0x8210
PDO_TIMEOUT = 0x8250
FOLLOWING = 0x8611
"""Codes of CiA 301 and CiA 402."""


class Recovery(Enum):
    """What a fault reset needs first."""

    NONE = "nothing"
    IN_RANGE = "the value back in its range"
    COMMUNICATION = "NMT reset communication"
    DEVICE = "a reset of the device"
    HISTORY = "the history cleared"


@dataclass(frozen=True)
class Error:
    register: int
    reaction: str
    recovery: Recovery = Recovery.NONE
    loses_position: bool = False
    """resetting it clears the position"""


class ErrorTable(Protocol):
    """A drive's errors by their codes."""

    def __getitem__(self, code: int, /) -> Error:
        """Raises KeyError for a code that the drive does not have."""

    def __contains__(self, code: object, /) -> bool: ...


@dataclass(frozen=True)
class Codes:
    """What a drive calls those errors for which makers have codes of their own."""

    motor_overheated: int
    software_limit: int
    negative_limit: int
    positive_limit: int
    torque_off: int


_RANGED = frozenset({OVERVOLTAGE, UNDERVOLTAGE, OVERHEATED, 0x4310})
# CiA 301, 0x1001: the bit of an error by the first digit of its code.
_REGISTER = {0x2: 0x02, 0x3: 0x04, 0x4: 0x08, 0x7: 0x20, 0xF: 0x80}
_COMMUNICATION = range(0x8100, 0x8300)
_POWER = range(0x2000, 0x6000)


class StandardErrors:
    """Every code, by its class in CiA 301 and CiA 402: communication as 0x6007 has it, current,
    voltage, temperature and hardware at once, all else as 0x605E has it."""

    def __getitem__(self, code: int) -> Error:
        if code not in self:
            raise KeyError(code)
        register = 0x01 | _REGISTER.get(code >> 12, 0)
        if code in _COMMUNICATION:
            return Error(register | 0x10, "A")
        recovery = Recovery.IN_RANGE if code in _RANGED else Recovery.NONE
        return Error(register, "D" if code in _POWER else "F", recovery)

    def __contains__(self, code: object) -> bool:
        return isinstance(code, int) and 0 < code <= 0xFFFF


STANDARD_CODES = Codes(
    motor_overheated=0x4310,
    software_limit=0x8612,
    negative_limit=0x8612,
    positive_limit=0x8612,
    torque_off=0x5441,
)
"""CiA 402: excessive drive temperature, reference limit, contacts."""
