"""The EPOS4's object dictionary as a table: Compact 50/8, firmware 0170.

Communication objects (0x1005, 0x1014 and up) belong to the bus and are added by it. Values: the
maker's EDS files; ranges of the 50/8 power stage.
"""

from __future__ import annotations

from sim.devices.objects import Entry, Kind, ObjectDictionary

VENDOR = 0x000000FB
PRODUCT = 0x65510000
REVISION = 0x01700000
DEVICE_TYPE = 0x00020192
HISTORY = 5
MODES = (1, 3, 6, 8, 9, 10)
CYCLIC_SYNCHRONOUS_TORQUE = 10
NEWEST_SERIAL = 0x50080000

_U8, _U16, _U32, _I8, _I16, _I32 = Kind.U8, Kind.U16, Kind.U32, Kind.I8, Kind.I16, Kind.I32
_Row = tuple[int, int, str, Kind, str, int, int, int, str]
_ALL = 0xFFFFFFFF
# index, subindex, name, type, access, default, low, high (0, 0: the type's), mapping
_TABLE: tuple[_Row, ...] = (
    (0x1000, 0, "device type", _U32, "ro", DEVICE_TYPE, 0, 0, ""),
    (0x1001, 0, "error register", _U8, "ro", 0, 0, 0, "t"),
    (0x1003, 0, "number of errors", _U8, "rw", 0, 0, 0, ""),
    *((0x1003, n, f"error {n}", _U32, "ro", 0, 0, 0, "") for n in range(1, HISTORY + 1)),
    (0x1010, 1, "save all parameters", _U32, "rw", 1, 0, 0, ""),
    (0x1011, 1, "restore all parameters", _U32, "rw", 1, 0, 0, ""),
    (0x1018, 1, "vendor", _U32, "ro", VENDOR, 0, 0, ""),
    (0x1018, 2, "product code", _U32, "ro", PRODUCT, 0, 0, ""),
    (0x1018, 3, "revision", _U32, "ro", REVISION, 0, 0, ""),
    (0x1018, 4, "serial number", _U32, "ro", 0, 0, 0, ""),
    (0x2000, 0, "node id", _U8, "rw", 1, 1, 127, ""),
    (0x2001, 0, "CAN bit rate", _U8, "rw", 0, 0, 9, ""),
    (0x200A, 0, "CAN bit rate display", _U8, "ro", 0, 0, 0, ""),
    (0x2200, 1, "supply voltage", _U16, "ro", 480, 0, 0, ""),
    (0x2201, 1, "undervoltage limit", _U32, "rw", 8000, 8000, 55500, ""),
    (0x2201, 2, "overvoltage limit", _U32, "rw", 58000, 2508, 58000, ""),
    (0x3000, 1, "sensors configuration", _U32, "rw", 0x00100001, 0, 0, ""),
    (0x3000, 2, "control structure", _U32, "rw", 0x00010111, 0, 0, ""),
    (0x3000, 3, "commutation sensors", _U32, "rw", 0x31, 0, 0, ""),
    (0x3000, 4, "axis configuration", _U32, "rw", 0, 0, 0, ""),
    (0x3000, 5, "main sensor resolution", _U32, "ro", 2000, 0, 0, ""),
    (0x3001, 1, "nominal current", _U32, "rw", 8000, 0, 8000, "rt"),
    (0x3001, 2, "output current limit", _U32, "rw", 30000, 0, 30000, "rt"),
    (0x3001, 3, "pole pairs", _U8, "rw", 1, 1, 255, ""),
    (0x3001, 4, "thermal time constant", _U16, "rw", 40, 1, 10000, ""),
    (0x3001, 5, "torque constant", _U32, "rw", 0, 0, 10000000, ""),
    (0x3002, 1, "resistance", _U32, "rw", 0, 0, 0, ""),
    (0x3002, 2, "inductance", _U16, "rw", 0, 0, 0, ""),
    (0x3003, 1, "gear numerator", _U32, "rw", 1, 1, _ALL, ""),
    (0x3003, 2, "gear denominator", _U32, "rw", 1, 1, _ALL, ""),
    (0x3003, 3, "gear input speed", _U32, "rw", 100000, 1, 100000, ""),
    (0x3010, 1, "encoder pulses", _U32, "rw", 500, 16, 2500000, ""),
    (0x3010, 2, "encoder type", _U16, "rw", 1, 0, 0, ""),
    (0x30A0, 1, "current P gain", _U32, "rw", 1171880, 0, 0, "rt"),
    (0x30A0, 2, "current I gain", _U32, "rw", 3906250, 0, 0, "rt"),
    (0x30A2, 1, "velocity P gain", _U32, "rw", 20000, 0, 0, "rt"),
    (0x30A2, 2, "velocity I gain", _U32, "rw", 500000, 0, 0, "rt"),
    (0x30B0, 0, "home position", _I32, "rw", 0, 0, 0, "rt"),
    (0x30D0, 0, "current demand", _I32, "ro", 0, 0, 0, "t"),
    (0x30D1, 1, "current averaged", _I32, "ro", 0, 0, 0, "t"),
    (0x30D1, 2, "current actual", _I32, "ro", 0, 0, 0, "t"),
    (0x30D2, 1, "torque averaged", _I16, "ro", 0, 0, 0, "t"),
    (0x30D3, 1, "velocity averaged", _I32, "ro", 0, 0, 0, "t"),
    (0x30E0, 1, "standstill window", _U32, "rw", 30, 0, 0, ""),
    (0x30E0, 2, "standstill window time", _U16, "rw", 2, 0, 0, ""),
    (0x30E0, 3, "standstill timeout", _U16, "rw", 1000, 0, 0, ""),
    (0x3141, 1, "digital inputs state", _U16, "ro", 0, 0, 0, "t"),
    (0x3201, 1, "temperature power stage", _I16, "ro", 300, 0, 0, ""),
    (0x3201, 4, "maximal temperature", _U16, "rw", 950, 0, 950, ""),
    (0x6007, 0, "abort connection option", _I16, "rw", 3, 2, 3, ""),
    (0x603F, 0, "error code", _U16, "ro", 0, 0, 0, "t"),
    (0x6040, 0, "controlword", _U16, "rw", 0, 0, 0, "rt"),
    (0x6041, 0, "statusword", _U16, "ro", 0, 0, 0, "t"),
    (0x605A, 0, "quick stop option", _I16, "rw", 6, 6, 6, ""),
    (0x605B, 0, "shutdown option", _I16, "rw", 0, 0, 1, ""),
    (0x605C, 0, "disable option", _I16, "rw", 1, 0, 1, ""),
    (0x605E, 0, "fault reaction option", _I16, "rw", 2, 0, 2, ""),
    (0x6060, 0, "modes of operation", _I8, "rw", 1, 0, 0, "rt"),
    (0x6061, 0, "modes of operation display", _I8, "ro", 1, 0, 0, "t"),
    (0x6062, 0, "position demand", _I32, "ro", 0, 0, 0, "t"),
    (0x6064, 0, "position actual", _I32, "ro", 0, 0, 0, "t"),
    (0x6065, 0, "following error window", _U32, "rw", 2000, 0, 0, "rt"),
    (0x6067, 0, "position window", _U32, "rw", _ALL, 0, 0, "rt"),
    (0x6068, 0, "position window time", _U16, "rw", 0, 0, 0, "rt"),
    (0x606B, 0, "velocity demand", _I32, "ro", 0, 0, 0, "t"),
    (0x606C, 0, "velocity actual", _I32, "ro", 0, 0, 0, "t"),
    (0x6071, 0, "target torque", _I16, "rw", 0, -3750, 3750, "rt"),
    (0x6076, 0, "motor rated torque", _U32, "ro", 0, 0, 0, ""),
    (0x6077, 0, "torque actual", _I16, "ro", 0, 0, 0, "t"),
    (0x607A, 0, "target position", _I32, "rw", 0, 0, 0, "rt"),
    (0x607D, 1, "min position limit", _I32, "rw", 0, 0, 0, "rt"),
    (0x607D, 2, "max position limit", _I32, "rw", 0, 0, 0, "rt"),
    (0x607F, 0, "max profile velocity", _U32, "rw", 50000, 1, 50000, "rt"),
    (0x6080, 0, "max motor speed", _U32, "rw", 50000, 1, 50000, "rt"),
    (0x6081, 0, "profile velocity", _U32, "rw", 1000, 1, 50000, "rt"),
    (0x6083, 0, "profile acceleration", _U32, "rw", 10000, 1, _ALL, "rt"),
    (0x6084, 0, "profile deceleration", _U32, "rw", 10000, 1, _ALL, "rt"),
    (0x6085, 0, "quick stop deceleration", _U32, "rw", 10000, 1, _ALL, "rt"),
    (0x6086, 0, "motion profile type", _I16, "rw", 0, 0, 0, "rt"),
    (0x6098, 0, "homing method", _I8, "rw", 7, 0, 0, "rt"),
    (0x60A8, 0, "SI unit position", _U32, "rw", 0x00B50000, 0x00B50000, 0x00B50000, ""),
    (0x60A9, 0, "SI unit velocity", _U32, "rw", 0x00B44700, 0x00B44700, 0x00B44700, ""),
    (0x60AA, 0, "SI unit acceleration", _U32, "rw", 0x00C00300, 0x00C00300, 0x00C00300, ""),
    (0x60B0, 0, "position offset", _I32, "rw", 0, 0, 0, "rt"),
    (0x60B1, 0, "velocity offset", _I32, "rw", 0, 0, 0, "rt"),
    (0x60B2, 0, "torque offset", _I16, "rw", 0, -3750, 3750, "rt"),
    (0x60C2, 1, "interpolation period", _U8, "rw", 0, 0, 100, "rt"),
    (0x60C2, 2, "interpolation index", _I8, "rw", -3, -3, -3, "rt"),
    (0x60C5, 0, "max acceleration", _U32, "rw", _ALL, 1, _ALL, "rt"),
    (0x60E4, 1, "position sensor 1", _I32, "ro", 0, 0, 0, "t"),
    (0x60FD, 0, "digital inputs", _U32, "ro", 0, 0, 0, "t"),
    (0x60FE, 1, "physical outputs", _U32, "rw", 0, 0, 0, "rt"),
    (0x60FF, 0, "target velocity", _I32, "rw", 0, -100000, 100000, "rt"),
    (0x6402, 0, "motor type", _U16, "rw", 10, 0, 0, ""),
    (0x6502, 0, "supported drive modes", _U32, "ro", 0x3A5, 0, 0, "t"),
)
_ALLOWED: dict[int, tuple[int, ...]] = {
    0x6060: MODES,
    0x6098: (37, 34, 33, 27, 23, 18, 17, 11, 7, 2, 1, -1, -2, -3, -4),
    0x6086: (0,),
    0x6402: (1, 10, 11),
}
POWER_OFF_ONLY = (
    *((0x3000, n) for n in range(1, 5)),
    (0x3001, 3),
    (0x3003, 1),
    (0x3003, 2),
    (0x3010, 1),
    (0x3010, 2),
    (0x60A9, 0),
    (0x6402, 0),
)
"""Objects that are refused while the power stage is on."""


def dictionary(node_id: int) -> ObjectDictionary:
    """A drive's own objects as they are at switch-on."""
    objects = ObjectDictionary()
    for index, sub, name, kind, access, default, low, high, mapping in _TABLE:
        allowed = _ALLOWED.get(index, ())
        entry = Entry(name, kind, access, default, low, high, mapping, allowed)
        objects.add(index, sub, entry)
    objects.add(0x1008, 0, Entry("device name", Kind.STRING, "const", "EPOS4"))
    serial = objects.find(0x1018, 4)
    serial.value = serial.default = NEWEST_SERIAL + node_id
    node = objects.find(0x2000, 0)
    node.value = node.default = node_id
    return objects
