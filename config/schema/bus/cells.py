"""Force cells behind an amplifier, as each standard has them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from tonus.config.schema.base import Section
from tonus.config.schema.drive import Device, Identity, MappingEntry

AMPLIFIER_CHANNELS = 4
"""Cells that one node carries at most: as many 16-bit values as a frame holds."""


class ForceCell(Device):
    """CiA 404 analogue input."""

    identity: Identity
    decimal_digits: Annotated[int, Field(ge=0, le=6)]
    """0x6132: the integer process value is the force times ten to this power"""

    def mapping(self, channels: int) -> tuple[int, ...]:
        """What a node of so many channels sends: an amplifier of several fits a frame with 16 bits
        each (0x7130)."""
        if channels == 1:
            return self.tpdo
        return tuple(0x71300010 | channel << 8 for channel in range(1, channels + 1))


class Amplifier(Section):
    """Strain gauge amplifier with CiA 404 objects; ``tpdo`` is what it maps of channel 1, and the
    same of each further channel behind it."""

    identity: Identity
    tpdo: tuple[MappingEntry, ...]
    decimal_digits: Annotated[int, Field(ge=0, le=6)]
    """0x6132: the integer process value is the force times ten to this power"""

    def mapping(self, channels: int) -> tuple[int, ...]:
        """What an amplifier of so many channels sends."""
        return tuple(
            entry & ~0xFF00 | channel << 8
            for channel in range(1, channels + 1)
            for entry in self.tpdo
        )
