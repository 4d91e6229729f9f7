"""Where a fault can be: axes, cells, channels and nodes of a configuration."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from tonus.config.schema.bus import CanopenBus, EthercatBus, parts
from tonus.config.schema.campaign import Place
from tonus.config.schema.root import Config


def places(config: Config, place: Place | None) -> list[dict[str, Any]]:
    """The fields of a fault that say where it is, once for each place of the kind."""
    if place is None:
        return [{}]
    robot = config.robot
    if place == "axis":
        return [{"axis": axis} for axis in range(robot.cables)]
    if place in ("cell", "cable_cell"):
        count = robot.cables if place == "cable_cell" else robot.cells
        return [{"cell": cell} for cell in range(count)]
    if place == "channel":
        return [{"channel": name} for name in dict.fromkeys(name for name, _, _ in _nodes(config))]
    return [
        {"channel": name, "node": node}
        for name, node, drives in _nodes(config)
        if place == "node" or drives == (place == "drive")
    ]


def _nodes(config: Config) -> Iterator[tuple[str, int, bool]]:
    """Channel, node and whether it is a drive."""
    for bus in parts(config.fieldbus):
        if isinstance(bus, CanopenBus):
            for channel in bus.channels:
                yield from ((channel.name, drive.node_id, True) for drive in channel.drives)
                yield from ((channel.name, cell.node_id, False) for cell in channel.force_cells)
        elif isinstance(bus, EthercatBus):
            for number, slave in enumerate(bus.slaves, start=1):
                yield bus.interface, number, slave.axis is not None
