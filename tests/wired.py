"""Which channel each node of a CANopen configuration is on."""

from __future__ import annotations

from tonus.config import Config, load
from tonus.config.schema.bus import CanopenBus


def channels(config: Config) -> dict[int, str]:
    """By node id."""
    bus = config.fieldbus
    assert isinstance(bus, CanopenBus)
    return {
        node.node_id: channel.name
        for channel in bus.channels
        for node in (*channel.drives, *channel.force_cells)
    }


CHANNEL = channels(load("config/can.yaml")[0])
"""those of the robot that most tests have"""
