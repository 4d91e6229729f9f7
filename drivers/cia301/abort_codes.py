"""SDO abort codes in words: CiA 301, and the three that EPOS4 adds."""

from __future__ import annotations

TOGGLE = 0x05030000
TIMEOUT = 0x05040000
COMMAND_SPECIFIER = 0x05040001
NO_SUCH_OBJECT = 0x06020000
LENGTH = 0x06070010

WORDS = {
    TOGGLE: "toggle bit not alternated",
    TIMEOUT: "SDO protocol timed out",
    COMMAND_SPECIFIER: "command specifier not valid or unknown",
    0x05040002: "invalid block size",
    0x05040003: "invalid sequence number",
    0x05040004: "CRC error",
    0x05040005: "out of memory",
    0x06010000: "unsupported access to an object",
    0x06010001: "attempt to read a write-only object",
    0x06010002: "attempt to write a read-only object",
    0x06010003: "subindex 0 must be 0 before another subindex is written",
    0x06010004: "complete access not supported",
    NO_SUCH_OBJECT: "object does not exist",
    0x06040041: "object cannot be mapped to the PDO",
    0x06040042: "mapped objects would exceed the PDO's length",
    0x06040043: "general parameter incompatibility",
    0x06040047: "general internal incompatibility in the device",
    0x06060000: "access failed due to a hardware error",
    LENGTH: "data type or length does not match",
    0x06070012: "data type does not match, length too high",
    0x06070013: "data type does not match, length too low",
    0x06090011: "subindex does not exist",
    0x06090030: "value out of range",
    0x06090031: "value too high",
    0x06090032: "value too low",
    0x06090036: "maximum value is less than minimum value",
    0x060A0023: "resource not available",
    0x08000000: "general error",
    0x08000020: "data cannot be transferred or stored",
    0x08000021: "data cannot be transferred or stored because of local control",
    0x08000022: "data cannot be transferred or stored in the present device state",
    0x08000023: "object dictionary not present or not generated",
    0x08000024: "no data available",
    0x0F00FFBE: "password not correct (maxon)",
    0x0F00FFBF: "illegal command (maxon)",
    0x0F00FFC0: "device is in the wrong NMT state (maxon)",
}


def words(code: int) -> str:
    """What a device means by refusing."""
    return WORDS.get(code, "code not known to CiA 301 or EPOS4")
