"""Worst-case load of a classic CAN channel, computed from the PDO mapping.

A data frame with an 11-bit identifier and n data bytes takes 44 + 8n bits (ISO 11898-1: SOF to end
of frame), at most floor((34 + 8n - 1) / 4) stuff bits in the stuffable field from SOF through CRC,
and 3 bits of interframe space.
"""

from __future__ import annotations

from dataclasses import dataclass

from tonus.config.schema.bus import CanopenBus, Channel
from tonus.config.schema.supervisor import Supervisor

FRAME_BITS = 44
STUFFABLE_BITS = 34
INTERFRAME_BITS = 3
BITS_PER_BYTE = 8
HEARTBEAT_BYTES = 1


@dataclass(frozen=True)
class ChannelLoad:
    """What one channel has to carry, every bit that can be stuffed being stuffed.

    ``cyclic_us`` is the SYNC and the PDOs of one cycle. ``heartbeat_us`` is the mean share of the
    heartbeats: they have the lowest priority, so when several meet in one cycle the rest waits for
    the next, and no PDO with them. SDO and EMCY use what is left over: they are confirmed one at a
    time, or rare. Both need room, which is why the load limit of a channel is below 1.
    """

    name: str
    frames: int
    """per cycle, without heartbeats"""
    cyclic_us: float
    heartbeat_us: float
    period_us: int

    @property
    def cyclic_share(self) -> float:
        return self.cyclic_us / self.period_us

    @property
    def share(self) -> float:
        return (self.cyclic_us + self.heartbeat_us) / self.period_us


def frame_bits(data_bytes: int) -> int:
    """Bits of a data frame with interframe space, without stuffing."""
    return FRAME_BITS + BITS_PER_BYTE * data_bytes + INTERFRAME_BITS


def worst_frame_bits(data_bytes: int) -> int:
    """Bits of the same frame with the most stuff bits any content can cause."""
    stuff = (STUFFABLE_BITS + BITS_PER_BYTE * data_bytes - 1) // 4
    return frame_bits(data_bytes) + stuff


def channel_load(
    bus: CanopenBus, channel: Channel, period_us: int, supervisor: Supervisor | None = None
) -> ChannelLoad:
    """The load of ``channel`` when SYNC is sent every ``period_us``, with the heartbeat of a
    supervisor if there is one."""
    sizes = [0]  # SYNC
    profiles = [bus.profile(drive.axis) for drive in channel.drives]
    for profile in profiles:
        sizes += _sizes(profile.rpdo, profile.tpdo)
    for node in channel.force_cells:
        sizes += _sizes(bus.force_cell.rpdo, bus.force_cell.mapping(len(node.cells)))
    per_ms = 1.0 / bus.master.heartbeat_ms
    per_ms += sum(1.0 / profile.heartbeat_ms for profile in profiles)
    per_ms += len(channel.force_cells) / bus.force_cell.heartbeat_ms
    if supervisor is not None and supervisor.policy != "off":
        per_ms += 1.0 / supervisor.period_ms
    bit_us = 1e6 / bus.bitrate
    heartbeats = per_ms * period_us * 1e-3
    return ChannelLoad(
        name=channel.name,
        frames=len(sizes),
        cyclic_us=sum(map(worst_frame_bits, sizes)) * bit_us,
        heartbeat_us=heartbeats * worst_frame_bits(HEARTBEAT_BYTES) * bit_us,
        period_us=period_us,
    )


def _sizes(*mappings: tuple[int, ...]) -> list[int]:
    return [_data_bytes(mapping) for mapping in mappings if mapping]


def _data_bytes(mapping: tuple[int, ...]) -> int:
    """Bytes of a PDO: the last byte may be filled in part."""
    return -(-sum(entry & 0xFF for entry in mapping) // BITS_PER_BYTE)
