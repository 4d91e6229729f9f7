"""The EPOS4's objects of the drive profile CiA 402 (0x6xxx), as a table.

Compact 50/8, firmware 0170. 0x6076 is read only here: the maker's text has it computed from
0x3001, where the EDS says rw.
"""

from __future__ import annotations

from tonus.sim.devices.objects import ALL, Kind, Row

_U8, _U16, _U32, _I8, _I16, _I32 = Kind.U8, Kind.U16, Kind.U32, Kind.I8, Kind.I16, Kind.I32
MODES = (1, 3, 6, 8, 9, 10)
HOMING_METHODS = (37, 34, 33, 27, 23, 18, 17, 11, 7, 2, 1, -1, -2, -3, -4)
VELOCITY_UNIT = 0x00B44700
"""0x60A9: rpm; its top byte is a power of ten, 0 to -6"""
ROWS: tuple[Row, ...] = (
    (0x6007, 0, "Abort connection option code", _I16, "rw", 3, 2, 3, ""),
    (0x603F, 0, "Error code", _U16, "ro", 0, 0, 0, "t"),
    (0x6040, 0, "Controlword", _U16, "rw", 0, 0, 0, "rt"),
    (0x6041, 0, "Statusword", _U16, "ro", 0, 0, 0, "t"),
    (0x605A, 0, "Quick stop option code", _I16, "rw", 6, 6, 6, ""),
    (0x605B, 0, "Shutdown option code", _I16, "rw", 0, 0, 1, ""),
    (0x605C, 0, "Disable operation option code", _I16, "rw", 1, 0, 1, ""),
    (0x605E, 0, "Fault reaction option code", _I16, "rw", 2, 0, 2, ""),
    (0x6060, 0, "Modes of operation", _I8, "rw", 1, 0, 0, "rt"),
    (0x6061, 0, "Modes of operation display", _I8, "ro", 1, 0, 0, "t"),
    (0x6062, 0, "Position demand value", _I32, "ro", 0, 0, 0, "t"),
    (0x6064, 0, "Position actual value", _I32, "ro", 0, 0, 0, "t"),
    (0x6065, 0, "Following error window", _U32, "rw", 2000, 0, 0, "rt"),
    (0x6066, 0, "Following error time out", _U16, "rw", 0, 0, 0, "rt"),
    (0x6067, 0, "Position window", _U32, "rw", ALL, 0, 0, "rt"),
    (0x6068, 0, "Position window time", _U16, "rw", 0, 0, 0, "rt"),
    (0x606B, 0, "Velocity demand value", _I32, "ro", 0, 0, 0, "t"),
    (0x606C, 0, "Velocity actual value", _I32, "ro", 0, 0, 0, "t"),
    (0x6071, 0, "Target torque", _I16, "rw", 0, -3750, 3750, "rt"),
    (0x6076, 0, "Motor rated torque", _U32, "ro", 0, 0, 0, ""),
    (0x6077, 0, "Torque actual value", _I16, "ro", 0, 0, 0, "t"),
    (0x607A, 0, "Target position", _I32, "rw", 0, 0, 0, "rt"),
    (0x607B, 1, "Min position range limit", _I32, "rw", 0, 0, 0, "rt"),
    (0x607B, 2, "Max position range limit", _I32, "rw", 0, 0, 0, "rt"),
    (0x607D, 1, "Min position limit", _I32, "rw", 0, 0, 0, "rt"),
    (0x607D, 2, "Max position limit", _I32, "rw", 0, 0, 0, "rt"),
    (0x607F, 0, "Max profile velocity", _U32, "rw", 50000, 1, 50000, "rt"),
    (0x6080, 0, "Max motor speed", _U32, "rw", 50000, 1, 50000, "rt"),
    (0x6081, 0, "Profile velocity", _U32, "rw", 1000, 1, 50000, "rt"),
    (0x6083, 0, "Profile acceleration", _U32, "rw", 10000, 1, ALL, "rt"),
    (0x6084, 0, "Profile deceleration", _U32, "rw", 10000, 1, ALL, "rt"),
    (0x6085, 0, "Quick stop deceleration", _U32, "rw", 10000, 1, ALL, "rt"),
    (0x6086, 0, "Motion profile type", _I16, "rw", 0, 0, 0, "rt"),
    (0x6098, 0, "Homing method", _I8, "rw", 7, 0, 0, "rt"),
    (0x6099, 1, "Speed for switch search", _U32, "rw", 100, 1, 50000, "rt"),
    (0x6099, 2, "Speed for zero search", _U32, "rw", 10, 1, 50000, "rt"),
    (0x609A, 0, "Homing acceleration", _U32, "rw", 1000, 1, ALL, "rt"),
    (0x60A8, 0, "SI unit position", _U32, "rw", 0x00B50000, 0x00B50000, 0x00B50000, ""),
    (0x60A9, 0, "SI unit velocity", _U32, "rw", 0x00B44700, 0, 0, ""),
    (0x60AA, 0, "SI unit acceleration", _U32, "rw", 0x00C00300, 0x00C00300, 0x00C00300, ""),
    (0x60B0, 0, "Position offset", _I32, "rw", 0, 0, 0, "rt"),
    (0x60B1, 0, "Velocity offset", _I32, "rw", 0, 0, 0, "rt"),
    (0x60B2, 0, "Torque offset", _I16, "rw", 0, -3750, 3750, "rt"),
    (0x60B8, 0, "Touch probe function", _U16, "rw", 0, 0, 0, "rt"),
    (0x60B9, 0, "Touch probe status", _U16, "ro", 0, 0, 0, "t"),
    (0x60BA, 0, "Touch probe 1 positive edge", _I32, "ro", 0, 0, 0, "t"),
    (0x60BB, 0, "Touch probe 1 negative edge", _I32, "ro", 0, 0, 0, "t"),
    (0x60C2, 1, "Interpolation time period value", _U8, "rw", 0, 0, 100, "rt"),
    (0x60C2, 2, "Interpolation time index", _I8, "rw", -3, -3, -3, "rt"),
    (0x60C5, 0, "Max acceleration", _U32, "rw", ALL, 1, ALL, "rt"),
    (0x60D0, 1, "Touch probe 1 source", _I16, "ro", 0, 0, 0, ""),
    (0x60D5, 0, "Touch probe 1 positive edge counter", _U16, "ro", 0, 0, 0, "t"),
    (0x60D6, 0, "Touch probe 1 negative edge counter", _U16, "ro", 0, 0, 0, "t"),
    (0x60E4, 1, "Position actual value sensor 1", _I32, "ro", 0, 0, 0, "t"),
    (0x60E4, 2, "Position actual value sensor 2", _I32, "ro", 0, 0, 0, "t"),
    (0x60E4, 3, "Position actual value sensor 3", _I32, "ro", 0, 0, 0, "t"),
    (0x60E5, 1, "Velocity actual value sensor 1", _I32, "ro", 0, 0, 0, "t"),
    (0x60E5, 2, "Velocity actual value sensor 2", _I32, "ro", 0, 0, 0, "t"),
    (0x60E5, 3, "Velocity actual value sensor 3", _I32, "ro", 0, 0, 0, "t"),
    (0x60E5, 9, "Velocity actual value averaged sensor 1", _I32, "ro", 0, 0, 0, "t"),
    (0x60E5, 10, "Velocity actual value averaged sensor 2", _I32, "ro", 0, 0, 0, "t"),
    (0x60E5, 11, "Velocity actual value averaged sensor 3", _I32, "ro", 0, 0, 0, "t"),
    (0x60F4, 0, "Following error actual value", _I32, "ro", 0, 0, 0, "t"),
    (0x60FD, 0, "Digital inputs", _U32, "ro", 0, 0, 0, "t"),
    (0x60FE, 1, "Physical outputs", _U32, "rw", 0, 0, 0, "rt"),
    (0x60FF, 0, "Target velocity", _I32, "rw", 0, -100000, 100000, "rt"),
    (0x6402, 0, "Motor type", _U16, "rw", 10, 0, 0, ""),
    (0x6502, 0, "Supported drive modes", _U32, "ro", 0x3A5, 0, 0, "t"),
    *(
        (0x60E3, n, f"Supported homing method {n}", _I8, "ro", method, 0, 0, "")
        for n, method in enumerate(HOMING_METHODS, start=1)
    ),
)
ALLOWED: dict[int, tuple[int, ...]] = {
    0x6060: MODES,
    0x6066: (0,),
    0x607B: (0,),
    0x6086: (0,),
    0x6098: HOMING_METHODS,
    0x60A9: tuple(VELOCITY_UNIT | (-power & 0xFF) << 24 for power in range(7)),
    0x6402: (1, 10, 11),
}
NAMES = {
    0x607B: "Position range limit",
    0x607D: "Software position limit",
    0x6099: "Homing speeds",
    0x60C2: "Interpolation time period",
    0x60D0: "Touch probe source",
    0x60E3: "Supported homing methods",
    0x60E4: "Additional position actual values",
    0x60E5: "Additional velocity actual values",
    0x60FE: "Digital outputs",
}
