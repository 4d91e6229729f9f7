"""Where a fault can be: axes, cells, channels and nodes of a configuration."""

from __future__ import annotations

from typing import Any

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
    nodes = list(config.fieldbus.nodes())
    if place == "channel":
        return [{"channel": name} for name in dict.fromkeys(node.channel for node in nodes)]
    return [
        {"channel": node.channel, "node": node.number}
        for node in nodes
        if place == "node" or (node.axis is not None) == (place == "drive")
    ]
