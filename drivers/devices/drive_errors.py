"""A drive's errors by its profile: what each means, what the drive does, and what clears it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from tonus.config.schema.drive import DriveProfile


class Reaction(Enum):
    """Values are those of a profile."""

    POWER_OFF = "power_off"
    ABORT = "abort_connection"
    FAULT = "fault_reaction"
    WARNING = "warning"


class Reset(Enum):
    """Values are those of a profile."""

    FAULT_RESET = "fault_reset"
    COMMUNICATION_RESET = "communication_reset"
    IN_RANGE = "in_range"
    DEVICE_RESET = "device_reset"
    HISTORY = "history"


_REACTIONS = {
    Reaction.POWER_OFF: "power off at once",
    Reaction.ABORT: "stops as set in 0x6007",
    Reaction.FAULT: "stops as set in 0x605E",
    Reaction.WARNING: "a warning, operation continues",
}
RESETS = {
    Reset.FAULT_RESET: "a fault reset clears it",
    Reset.COMMUNICATION_RESET: "a fault reset clears it after NMT reset communication",
    Reset.IN_RANGE: "a fault reset clears it once the value is back in range",
    Reset.DEVICE_RESET: "only a reset of the device clears it",
    Reset.HISTORY: "cleared with the error history",
}


@dataclass(frozen=True)
class Error:
    text: str
    reaction: Reaction | None
    reset: Reset
    loses_position: bool = False

    def __str__(self) -> str:
        reaction = "" if self.reaction is None else f"{_REACTIONS[self.reaction]}, "
        lost = ", the position is lost" if self.loses_position else ""
        return f"{self.text}; {reaction}{RESETS[self.reset]}{lost}"


# What the upper bits of a code say (CiA 301, CiA 402). Longest match first.
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


class Errors:
    """What the error codes of one kind of device mean."""

    def __init__(self, profile: DriveProfile | None = None) -> None:
        """None: a device of which only the classes of CiA 301 are known."""
        self.listed: dict[int, Error] = {}
        for row in profile.errors if profile is not None else ():
            reaction = None if row.reaction is None else Reaction(row.reaction)
            error = Error(row.text, reaction, Reset(row.reset), row.loses_position)
            self.listed |= dict.fromkeys(range(row.code, (row.last or row.code) + 1), error)

    def text(self, code: int) -> str:
        """What a code means and leads to; 0 is the message that every error is gone."""
        if code == 0:
            return "no error left"
        if code in self.listed:
            return str(self.listed[code])
        for mask, value, meaning in _CLASSES:
            if code & mask == value:
                return meaning
        return "unknown error"

    def reset(self, code: int) -> Reset:
        """What clears an error; a code that is not listed is tried with a fault reset."""
        error = self.listed.get(code)
        return Reset.FAULT_RESET if error is None else error.reset
