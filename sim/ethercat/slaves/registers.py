"""Register addresses of a slave controller, and which of their bits a master may write."""

from __future__ import annotations

TYPE = 0x000
STATION = 0x010
ALIAS = 0x012
CONTROL_DL = 0x100
STATUS_DL = 0x110
CONTROL_AL = 0x120
STATUS_AL = 0x130
CODE_AL = 0x134
RECEIVE_ERRORS = 0x300
ERRORS_END = 0x314
DIVIDER = 0x400
WATCHDOG_TIME = 0x420
WATCHDOG_STATUS = 0x440
WATCHDOG_COUNT = 0x442
EEPROM_OWNER = 0x500
EEPROM_CONTROL = 0x502
EEPROM_ADDRESS = 0x504
EEPROM_DATA = 0x508
EEPROM_END = 0x510
FMMU = 0x600
FMMU_BYTES = 16
FMMUS = 8
MANAGER = 0x800
MANAGER_BYTES = 8
MANAGERS = 8
RECEIVE_TIME = 0x900
SYSTEM_TIME = 0x910
LATCHED_TIME = 0x918
OFFSET = 0x920
DELAY = 0x928
DIFFERENCE = 0x92C
SPEED_START = 0x930
SYNC_CONTROL = 0x980
SYNC_ACTIVATION = 0x981
SYNC_START = 0x990
SYNC_CYCLE = 0x9A0
SYNC_END = 0x9A8
MEMORY = 0x1000
MEMORY_END = 0x3000
"""8 KiB of process memory"""

_WRITABLE: tuple[tuple[int, bytes], ...] = (
    (STATION, b"\xff\xff"),
    (0x100, b"\xff\xff\x07\x01"),
    (CONTROL_AL, b"\x3f\x00"),
    (0x140, b"\xff\xff"),
    (0x200, b"\xff\xff"),
    (DIVIDER, b"\xff\xff"),
    (0x410, b"\xff\xff"),
    (WATCHDOG_TIME, b"\xff\xff"),
    (EEPROM_OWNER, b"\x03"),
    (EEPROM_ADDRESS, b"\xff\xff\xff\xff" + b"\xff" * 8),
    (FMMU, (b"\xff" * 13 + b"\0\0\0") * FMMUS),
    (MANAGER, b"\xff\xff\xff\xff\xff\x00\xff\x00" * MANAGERS),
    (OFFSET, b"\xff" * 12),
    (SPEED_START, b"\xff\xff\x00\x00\xff\xff"),
    (SYNC_CONTROL, b"\xff\xff"),
    (SYNC_START, b"\xff" * 8 + bytes(8) + b"\xff" * 8),
)


def write_masks() -> bytes:
    """For every register byte the bits that a write changes; the rest is the slave's."""
    masks = bytearray(MEMORY)
    for start, bits in _WRITABLE:
        masks[start : start + len(bits)] = bits
    return bytes(masks)


def constants() -> bytes:
    """The registers that say what the controller is: 8 FMMUs and sync managers, 8 KiB, two ports,
    distributed clocks of 64 bits."""
    return bytes((0x11, 0x00, 0x02, 0x00, FMMUS, MANAGERS, 0x08, 0x0F, 0x0C, 0x01))
