"""What a kind of slave is: names, identity, mailbox and process memory."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Kind:
    """``outputs`` and ``inputs`` are where the process data begin; 0 outputs: it has none."""

    name: str
    group: str
    vendor: int
    product: int
    revision: int
    receive_mailbox: int
    send_mailbox: int
    mailbox_bytes: int
    outputs: int
    inputs: int
    longest_pdo: int
    """bytes"""
    longest_mapping: int
    """entries"""
    complete_access: bool
    current_ma: int = 0
    """taken from the E-bus"""
    logical_read_write: bool = True


EPOS4 = Kind(
    name="EPOS4",
    group="Drives",
    vendor=0x000000FB,
    product=0x65510000,
    revision=0x01700000,
    receive_mailbox=0x1000,
    send_mailbox=0x1030,
    mailbox_bytes=48,
    outputs=0x1060,
    inputs=0x10F0,
    longest_pdo=40,
    longest_mapping=12,
    complete_access=False,
)
"""Places and limits of the maker's device description (that of the Micro 24/5: the 50/8's is not
public)."""

_DRIVE = replace(
    EPOS4,
    receive_mailbox=0x1000,
    send_mailbox=0x1080,
    mailbox_bytes=128,
    outputs=0x1100,
    inputs=0x1180,
    longest_pdo=64,
)
"""Of a drive made from its EDS, which says nothing about the slave controller."""


def drive(name: str, vendor: int, product: int, revision: int, longest_mapping: int) -> Kind:
    """A drive made from its EDS."""
    return replace(
        _DRIVE,
        name=name,
        vendor=vendor,
        product=product,
        revision=revision,
        longest_mapping=longest_mapping,
    )


_AMPLIFIER = Kind(
    name="force amplifier",
    group="Sensors",
    vendor=0x0000FFFF,
    product=0x00000400,
    revision=0x00000001,
    receive_mailbox=0x1000,
    send_mailbox=0x1080,
    mailbox_bytes=128,
    outputs=0,
    inputs=0x1100,
    longest_pdo=128,
    longest_mapping=32,
    complete_access=True,
)


def amplifier(channels: int) -> Kind:
    """A force amplifier of so many channels, which its product code tells. A device of ours."""
    name = f"force amplifier, {channels} channel{'s' if channels > 1 else ''}"
    return replace(_AMPLIFIER, name=name, product=_AMPLIFIER.product + channels)
