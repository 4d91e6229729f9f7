"""The robots a trial may have behind its bus: the model, the lab's, and those drawn at random."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

from pydantic import ValidationError

from tonus.config import load
from tonus.config.schema.protocol import Protocol, Robots
from tonus.config.schema.root import Config
from tonus.tools.errors import ToolError
from tonus.tools.paper.case import Kind, Run

MODEL, LAB, DRAWN = "model", "lab", "plant-"
DIRECT, CAN = "direct", "can"


def settle(protocol: Protocol, config: Config, run: Run) -> Config:
    """The configuration of a trial: controller, true robot, bus, and what its case changes.

    ``config`` is the campaign's, with a lab section and a direct fieldbus. Raises `ToolError` for a
    protocol whose values the schema refuses.
    """
    data = config.model_dump()
    data["control"]["controller"] = run.controller
    _apply(data["lab"], _robots(protocol, run))
    if run.case.kind is Kind.SLOPE and run.plant == MODEL:
        data["lab"]["plant"].update(protocol.frictionless)
    for key, value in run.case.overrides:
        _set(data, key, value)
    if run.bus == CAN:
        data["fieldbus"] = load(protocol.canopen)[0].fieldbus.model_dump()
    data["recording"]["raw_frames"] = False
    try:
        return Config.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ToolError(f"config/protocol.yaml: {run.plant}: {place}: {first['msg']}") from error


def settings_key(run: Run) -> Hashable:
    """Equal for runs of equal configuration."""
    kind = run.plant if run.plant in (MODEL, LAB) else DRAWN
    return (run.controller, kind, run.bus, run.case.kind is Kind.SLOPE, run.case.overrides)


def refuse(config: Config, name: str) -> None:
    """Raises `ToolError` for a configuration that a campaign cannot run on."""
    if config.lab is None:
        raise ToolError(f"{name}: has no lab section, and the protocol is run in the lab; add one")
    if config.fieldbus.kind != "direct":
        raise ToolError(
            f"{name}: fieldbus: the campaign runs on the direct fieldbus and takes the sample on "
            "CAN by itself; use config/direct.yaml or include buses/direct.yaml"
        )


def _robots(protocol: Protocol, run: Run) -> Robots:
    if run.plant == MODEL:
        return protocol.model
    if run.plant == LAB:
        return protocol.lab
    return protocol.drawn


def _apply(lab: dict[str, Any], robots: Robots) -> None:
    lab["plant"].update(robots.plant)
    lab["noise"]["force_cell"].update(robots.force_cell)
    lab["noise"]["tracker"].update(robots.tracker)


def _set(data: dict[str, Any], key: str, value: Any) -> None:
    *parents, last = key.split(".")
    for part in parents:
        data = data[part]
    data[last] = value
