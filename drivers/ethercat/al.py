"""The application layer's states as ETG.1000.6 numbers them, and its status codes in words."""

from __future__ import annotations

from enum import IntEnum

ERROR = 0x10
"""In AL status: the slave left a state by itself or refused one. In AL control: acknowledged."""


class AlState(IntEnum):
    INIT = 1
    PREOP = 2
    BOOT = 3
    SAFEOP = 4
    OP = 8


_CODES = {
    0x0001: "unspecified error",
    0x0002: "no memory",
    0x0011: "invalid state change",
    0x0012: "unknown state requested",
    0x0013: "bootstrap not supported",
    0x0014: "no valid firmware",
    0x0015: "invalid mailbox configuration for bootstrap",
    0x0016: "invalid mailbox configuration",
    0x0017: "invalid sync manager configuration",
    0x0018: "no valid inputs available",
    0x0019: "no valid outputs",
    0x001A: "synchronisation error",
    0x001B: "sync manager watchdog expired: no outputs came",
    0x001C: "invalid sync manager types",
    0x001D: "invalid output configuration",
    0x001E: "invalid input configuration",
    0x001F: "invalid watchdog configuration",
    0x0020: "needs a cold start",
    0x0021: "needs INIT",
    0x0022: "needs PREOP",
    0x0023: "needs SAFEOP",
    0x0024: "invalid input mapping",
    0x0025: "invalid output mapping",
    0x0026: "inconsistent settings",
    0x002B: "no valid inputs and outputs",
    0x002C: "fatal synchronisation error: SYNC0 is missing",
    0x002D: "no synchronisation",
    0x002E: "cycle time too small",
    0x0030: "invalid distributed clock configuration",
    0x0031: "invalid latch configuration",
    0x0032: "distributed clocks out of sync (PLL error)",
    0x0033: "synchronisation input and output error",
    0x0034: "distributed clock timeout",
    0x0035: "invalid SYNC cycle time",
    0x0036: "SYNC0 cycle time does not fit the application",
    0x0042: "mailbox error, EoE",
    0x0043: "mailbox error, CoE",
    0x0044: "mailbox error, FoE",
    0x0050: "the EEPROM is not accessible",
    0x0051: "error in the EEPROM",
}


def name(state: int) -> str:
    """A state's name; a number that is none is shown."""
    try:
        return AlState(state).name
    except ValueError:
        return f"state {state}"


def words(code: int) -> str:
    """An AL status code in words."""
    return _CODES.get(code, "a code of the maker")
