"""The CiA 404 force cell: what is configured, and what its numbers mean."""

from __future__ import annotations

from tonus.config.schema.bus import Amplifier, ForceCell
from tonus.drivers.cia301.setting import Kind, Setting

REAL32 = 0x61300120
INT16 = 0x71300110
INT32 = 0x91300120
PROCESS_VALUES = (INT32, INT16, REAL32)
"""The process value of channel 1 in its three forms, as mapping words."""
STATUS = 0x61500108

NEWTON = 0x00210000
"""CiA 303-2: no prefix, N."""


def of_channel(entry: int, channel: int) -> int:
    """The mapping word of the same object on another channel, from 1."""
    return entry & ~0xFF00 | channel << 8


def settings(cell: ForceCell | Amplifier, channels: int) -> tuple[Setting, ...]:
    """What a force cell must be and hold before it is started, each channel."""
    return tuple(
        setting
        for channel in range(1, channels + 1)
        for setting in (
            Setting(0x6131, channel, NEWTON, 4, "physical unit, newton", Kind.CHECK),
            Setting(0x6132, channel, cell.decimal_digits, 1, "decimal digits of the process value"),
        )
    )


def divisor(cell: ForceCell | Amplifier) -> float:
    """Process values per newton."""
    return 1.0 if REAL32 in cell.tpdo else float(10**cell.decimal_digits)
