"""The EPOS4's object dictionary: Compact 50/8, firmware 0170, after the maker's EDS files.

Communication objects (0x1005, 0x1014 and up) belong to the bus and are added by it.
"""

from __future__ import annotations

from tonus.sim.devices.cia402.terminals import UNUSED
from tonus.sim.devices.device import PdoDefault
from tonus.sim.devices.epos4 import axis_objects as axis
from tonus.sim.devices.epos4 import profile_objects as profile
from tonus.sim.devices.objects import Entry, Kind, ObjectDictionary, Row

VENDOR = 0x000000FB
PRODUCT = 0x65510000
REVISION = 0x01700000
DEVICE_TYPE = 0x00020192
HISTORY = 5
BIT_RATES = (0, 1, 2, 3, 4, 6, 7, 9)
"""Codes of 0x2001: 1000, 800, 500, 250, 125, 50 and 20 kbit/s; 9: detect"""
INPUT_FUNCTIONS = (0, 1, 2, *range(16, 29), UNUSED)
_FIRST_SERIAL = 0x50080000

_U8, _U16, _U32, _U64 = Kind.U8, Kind.U16, Kind.U32, Kind.U64
_GENERAL: tuple[Row, ...] = (
    (0x1000, 0, "Device type", _U32, "ro", DEVICE_TYPE, 0, 0, ""),
    (0x1001, 0, "Error register", _U8, "ro", 0, 0, 0, "t"),
    (0x1003, 0, "Number of errors", _U8, "rw", 0, 0, 0, ""),
    *((0x1003, n, f"Error history {n}", _U32, "ro", 0, 0, 0, "") for n in range(1, HISTORY + 1)),
    (0x1010, 1, "Save all parameters", _U32, "rw", 1, 0, 0, ""),
    (0x1011, 1, "Restore all default parameters", _U32, "rw", 1, 0, 0, ""),
    (0x1011, 4, "Restore factory default parameters", _U32, "rw", 1, 0, 0, ""),
    (0x1018, 1, "Vendor-ID", _U32, "ro", VENDOR, 0, 0, ""),
    (0x1018, 2, "Product code", _U32, "ro", PRODUCT, 0, 0, ""),
    (0x1018, 3, "Revision number", _U32, "ro", REVISION, 0, 0, ""),
    (0x1018, 4, "Serial number", _U32, "ro", _FIRST_SERIAL, 0, 0, ""),
    (0x2000, 0, "Node-ID", _U8, "rw", 1, 1, 127, ""),
    (0x2001, 0, "CAN bit rate", _U8, "rw", 0, 0, 0, ""),
    (0x2002, 0, "RS232 bit rate", _U8, "rw", 5, 0, 0, ""),
    (0x2005, 0, "RS232 frame timeout", _U16, "rw", 500, 50, 65535, ""),
    (0x2006, 0, "USB frame timeout", _U16, "rw", 500, 50, 65535, ""),
    (0x200A, 0, "CAN bit rate display", _U8, "ro", 0, 0, 0, ""),
    (0x2010, 0, "Active fieldbus", _U8, "ro", 1, 0, 0, ""),
    (0x2100, 1, "Serial number complete", _U64, "ro", 0, 0, 0, ""),
    (0x210C, 1, "Custom persistent memory 1", _U32, "rw", 0, 0, 0, ""),
    (0x210C, 2, "Custom persistent memory 2", _U32, "rw", 0, 0, 0, ""),
    (0x210C, 3, "Custom persistent memory 3", _U32, "rw", 0, 0, 0, ""),
    (0x210C, 4, "Custom persistent memory 4", _U32, "rw", 0, 0, 0, ""),
    (0x2200, 1, "Power supply voltage", _U16, "ro", 480, 0, 0, ""),
    (0x2201, 1, "Power supply undervoltage limit", _U32, "rw", 8000, 8000, 55500, ""),
    (0x2201, 2, "Power supply overvoltage limit", _U32, "rw", 58000, 2508, 58000, ""),
)
_NAMES = {
    0x1003: "Error history",
    0x1010: "Store parameters",
    0x1011: "Restore default parameters",
    0x1018: "Identity object",
    0x2100: "Additional identity",
    0x210C: "Custom persistent memory",
    0x2200: "Power supply",
    0x2201: "Power supply limits",
}
_ALLOWED = {0x2001: BIT_RATES, 0x3142: INPUT_FUNCTIONS}
POWER_OFF_ONLY = (
    *((0x3000, n) for n in range(1, 5)),
    (0x3001, 3),
    (0x3003, 1),
    (0x3003, 2),
    (0x3003, 4),
    *((index, n) for index in (0x3010, 0x3020) for n in (1, 2)),
    (0x301A, 1),
    (0x60A9, 0),
    (0x6402, 0),
)
"""Objects that are refused while the power stage is on."""
SENSORS = (0x3000, 0x3010, 0x301A, 0x3020)
"""Writing to these loses the position."""
_SENSORS = ((0, 1), (0, 1, 2, 3), (0, 0x10))
"""What may be connected: an encoder; an encoder, sin/cos or SSI; Hall sensors."""
_FLEETING = frozenset(
    (0x1003, 0x1010, 0x1011, 0x6040, 0x6071, 0x607A, 0x60B0, 0x60B1, 0x60B2, 0x60B8, 0x60FE, 0x60FF)
)
"""Commands and process data, which saving leaves out."""

_EVENT = 255
_VALID = 0x40000000
_DISABLED = 0xC0000000
RECEIVE_PDOS = (
    PdoDefault(0x200, _EVENT, (0x60400010,)),
    PdoDefault(0x300, _EVENT, (0x60400010, 0x60600008)),
    PdoDefault(0x400, _EVENT, (0x60400010, 0x607A0020)),
    PdoDefault(0x500, _EVENT, (0x60400010, 0x60FF0020)),
)
TRANSMIT_PDOS = (
    PdoDefault(_VALID | 0x180, _EVENT, (0x60410010,)),
    PdoDefault(_DISABLED | 0x280, _EVENT, (0x60410010, 0x60610008)),
    PdoDefault(_DISABLED | 0x380, _EVENT, (0x60410010, 0x60640020)),
    PdoDefault(_DISABLED | 0x480, _EVENT, (0x60410010, 0x606C0020)),
)


def dictionary(node_id: int) -> ObjectDictionary:
    """A drive's own objects as they are at switch-on."""
    objects = ObjectDictionary()
    objects.names |= _NAMES | axis.NAMES | profile.NAMES
    ranges = _ALLOWED | profile.ALLOWED
    for index, sub, name, kind, access, default, low, high, mapping in (
        *_GENERAL,
        *axis.ROWS,
        *profile.ROWS,
    ):
        allowed = ranges.get(index, ())
        entry = Entry(name, kind, access, default, low, high, mapping, allowed)
        entry.lasting = index not in _FLEETING
        objects.add(index, sub, entry)
    objects.add(0x1008, 0, Entry("Device name", Kind.STRING, "const", "EPOS4"))
    for key in ((0x1018, 4), (0x2100, 1)):
        objects.find(*key).set(_FIRST_SERIAL + node_id)
    node = objects.find(0x2000, 0)
    node.set(node_id)
    node.relative = True
    return objects


def has_sensors(word: int) -> bool:
    """Whether there are terminals for the sensors of 0x3000:1."""
    if word >> 24:
        return False
    return all(word >> 8 * n & 0xFF in known for n, known in enumerate(_SENSORS))
