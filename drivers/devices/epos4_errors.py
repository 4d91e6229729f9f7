"""The EPOS4's errors in words: what each means, what the drive does, and what clears it.

Firmware specification of the maker: code, reaction class (D: power off, A: as 0x6007, F: as 0x605E,
W: warning) and how a fault is left again.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Reaction(Enum):
    POWER_OFF = "power off at once"
    ABORT = "stops as set in 0x6007"
    FAULT = "stops as set in 0x605E"
    WARNING = "a warning, operation continues"


class Cure(Enum):
    FAULT_RESET = "a fault reset clears it"
    COMMUNICATION_RESET = "a fault reset clears it after NMT reset communication"
    IN_RANGE = "a fault reset clears it once the value is back in range"
    DEVICE_RESET = "only a reset of the device clears it"
    HISTORY = "cleared with the error history"


@dataclass(frozen=True)
class Error:
    words: str
    reaction: Reaction
    cure: Cure
    loses_position: bool = False

    def __str__(self) -> str:
        lost = ", the position is lost" if self.loses_position else ""
        return f"{self.words}; {self.reaction.value}, {self.cure.value}{lost}"


_LETTERS = {
    "D": Reaction.POWER_OFF,
    "A": Reaction.ABORT,
    "F": Reaction.FAULT,
    "W": Reaction.WARNING,
}
# code, class, words; a star where resetting the error loses the position
_TABLE = (
    (0x1000, "D", "generic error"),
    *((code, "D", "initialisation error") for code in range(0x1080, 0x1089)),
    (0x1090, "D", "firmware incompatibility"),
    (0x2310, "D", "overcurrent"),
    (0x2320, "D", "power stage protection"),
    (0x3210, "D", "overvoltage"),
    (0x3220, "D", "undervoltage"),
    (0x4210, "D", "thermal overload of the power stage"),
    (0x4380, "D", "thermal overload of the motor"),
    (0x5113, "D", "logic supply voltage too low"),
    *((code, "D", "hardware defect") for code in (0x5280, 0x5282)),
    (0x5281, "D", "hardware incompatibility"),
    *((code, "D", "hardware defect") for code in range(0x5480, 0x5484)),
    (0x6080, "D", "extension 1 does not respond"),
    (0x6081, "A", "watchdog of extension 1"),
    *((code, "D", "internal software error") for code in range(0x6180, 0x61F1)),
    (0x6320, "F", "software parameter error, profile too long"),
    (0x6380, "D", "persistent parameters corrupt"),
    (0x7320, "D", "position sensor error"),
    (0x7380, "D*", "position sensor breach"),
    (0x7381, "D*", "position sensor resolution"),
    (0x7382, "D*", "position sensor index"),
    (0x7388, "D*", "Hall sensor, invalid pattern"),
    (0x7389, "D*", "Hall sensor not found"),
    (0x738A, "D*", "Hall sensor angle mismatch"),
    (0x738C, "D", "SSI sensor sampling"),
    (0x738D, "D", "SSI sensor frame"),
    (0x7390, "D", "main sensor missing"),
    (0x7391, "D", "commutation sensor missing"),
    (0x7392, "D*", "main sensor direction"),
    (0x8110, "A", "CAN overrun, object lost"),
    (0x8111, "A", "CAN overrun"),
    (0x8120, "A", "CAN error-passive"),
    (0x8130, "A", "heartbeat of the master lost"),
    (0x8150, "A", "identifier of a transmit PDO collides"),
    (0x8180, "A", "EtherCAT communication error"),
    (0x8181, "D", "EtherCAT initialisation error"),
    (0x8182, "A", "EtherCAT receive queue overflow"),
    (0x8183, "A", "EtherCAT internal communication error"),
    (0x8184, "A", "EtherCAT cycle time error"),
    (0x81FD, "A", "CAN bus-off"),
    (0x81FE, "A", "CAN receive queue overflow"),
    (0x81FF, "A", "CAN transmit queue overflow"),
    (0x8210, "A", "PDO shorter than its mapping"),
    (0x8250, "A", "receive PDO timeout"),
    (0x8280, "A", "EtherCAT PDO communication error"),
    (0x8281, "A", "EtherCAT SDO communication error"),
    (0x8611, "F", "following error"),
    (0x8A80, "F", "negative limit switch"),
    (0x8A81, "F", "positive limit switch"),
    (0x8A82, "F", "software position limit"),
    (0x8A88, "D", "safe torque off"),
    (0x8A8A, "W", "safe torque off card ready"),
    (0x8A8B, "D", "safe torque off card inactive"),
    (0xFF01, "W", "system overloaded"),
    (0xFF02, "D*", "watchdog"),
    (0xFF0B, "D", "system peak overloaded"),
    (0xFF10, "F", "controller gain"),
    *((c, "D", "auto-tuning") for c in (*range(0xFF11, 0xFF18), 0xFF19, *range(0xFF20, 0xFF25))),
)
_IN_RANGE = (0x3210, 0x3220, 0x4210, 0x4380, 0x5113)
_COMMUNICATION = (0x8120, 0x8130)
_DEVICE = (range(0x1080, 0x1089), range(0x5280, 0x5283), range(0x5480, 0x5484))


def _cure(code: int) -> Cure:
    if code in _COMMUNICATION:
        return Cure.COMMUNICATION_RESET
    if code in _IN_RANGE:
        return Cure.IN_RANGE
    if any(code in codes for codes in _DEVICE):
        return Cure.DEVICE_RESET
    return Cure.HISTORY if code == 0xFF01 else Cure.FAULT_RESET


ERRORS = {
    code: Error(words, _LETTERS[letter[0]], _cure(code), letter.endswith("*"))
    for code, letter, words in _TABLE
}


def cure(code: int) -> Cure:
    """What clears an error; a code that is not listed is tried with a fault reset."""
    error = ERRORS.get(code)
    return Cure.FAULT_RESET if error is None else error.cure
