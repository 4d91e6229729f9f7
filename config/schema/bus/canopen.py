"""Drives and amplifiers on channels of CANopen."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from tonus.config.schema.base import Count, Fraction, NodeId, Section
from tonus.config.schema.bus.base import BusNode, DriveBus, Number, Place, numbers, once
from tonus.config.schema.bus.cells import AMPLIFIER_CHANNELS, ForceCell
from tonus.config.schema.tolerance import LostFrames

_REAL32 = 0x6130


class DriveNode(Section):
    axis: Number
    node_id: NodeId
    profile: str | None = None
    """one of the bus' ``profiles``; null: its ``drive``"""


class CellNode(Section):
    """An amplifier with one cell (``cell: 0``) or several (``cells: [0, 1, 2, 3]``)."""

    cells: Annotated[tuple[Number, ...], Field(min_length=1, max_length=AMPLIFIER_CHANNELS)]
    """the cell on each channel, in the order of the channels"""
    node_id: NodeId

    @model_validator(mode="before")
    @classmethod
    def _one_is_several(cls, given: Any) -> Any:
        if not isinstance(given, dict) or "cell" not in given:
            return given
        if "cells" in given:
            raise ValueError("names both cell and cells; keep one of them")
        rest = {key: value for key, value in given.items() if key != "cell"}
        return rest | {"cells": (given["cell"],)}

    @property
    def cell(self) -> int:
        """The cell on the first channel."""
        return self.cells[0]


class Channel(Section):
    name: str
    drives: tuple[DriveNode, ...] = ()
    force_cells: tuple[CellNode, ...] = ()

    def nodes(self) -> Iterator[BusNode]:
        for drive in self.drives:
            yield BusNode(self.name, drive.node_id, axis=drive.axis)
        for node in self.force_cells:
            yield BusNode(self.name, node.node_id, cells=node.cells)


class Master(Section):
    """What our side of every channel does. Ticks are those of the control loop."""

    node_id: NodeId
    heartbeat_ms: Count
    heartbeat_periods: Count | None = None
    """a node is silent after so many of its own periods; null: as `tolerance` has it"""
    sdo_timeout_ms: Count
    sdo_attempts: Count = 3
    """an SDO transfer without an answer is begun so many times before it is an error"""
    boot_timeout_ms: Count
    boot_resets: Count
    """times a node is reset before it counts as missing"""
    poll_us: Count
    """how often the buses are looked at while no tick does it"""
    late_ticks: Annotated[int, Field(ge=1, lt=64)]
    """a PDO may answer a SYNC at most so long ago"""
    settle_ticks: Count
    """regular answers in a row after which one that is missing is lost, not late"""
    copy_us: Count = 250
    """a second PDO with the data of the first, at most so long after it, may be a copy of it"""
    drain_periods: Count
    """frames taken in one tick, in periods of a full bus: a flood must not hold the tick"""
    flood_frames: Count
    """frames of no configured node in one tick, so many ticks in a row, are a flood"""
    flood_ticks: Count
    health_ticks: Count
    """how often a controller is asked for its error state"""


class CanopenBus(DriveBus):
    heartbeats: ClassVar[bool] = True
    listing: ClassVar[str] = "channels"
    kind: Literal["canopen"]
    interface: str
    """python-can interface: tonus (the lab), socketcan, or a vendor's"""
    bitrate: Count
    load_limit: Fraction
    """highest worst-case share of a cycle that a channel's frames may take"""
    master: Master
    force_cell: ForceCell
    channels: Annotated[tuple[Channel, ...], Field(min_length=1)]

    @field_validator("channels")
    @classmethod
    def _every_device_once(cls, channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
        nodes = [node for channel in channels for node in channel.nodes()]
        once(cls.device, *numbers(nodes))
        return channels

    def chosen(self) -> dict[int, str]:
        drives = (drive for channel in self.channels for drive in channel.drives)
        return {drive.axis: drive.profile for drive in drives if drive.profile is not None}

    def lost_frames(self, lost: LostFrames) -> dict[str, int]:
        return {"SYNCs": lost.sync, "PDOs": lost.pdo}

    def nodes(self) -> Iterator[BusNode]:
        for channel in self.channels:
            yield from channel.nodes()

    def places(self) -> Iterator[Place]:
        for index, channel in enumerate(self.channels):
            for at, drive in enumerate(channel.drives):
                yield ("channels", index, "drives", at, "axis"), "axis", drive.axis
            for at, node in enumerate(channel.force_cells):
                for cell in node.cells:
                    yield ("channels", index, "force_cells", at), "cell", cell

    @property
    def can_channels(self) -> list[str]:
        return [channel.name for channel in self.channels]

    @property
    def faults(self) -> str:
        return "can"

    @model_validator(mode="after")
    def _one_scale_for_all_cells(self) -> CanopenBus:
        several = any(len(node.cells) > 1 for c in self.channels for node in c.force_cells)
        if several and any(entry >> 16 == _REAL32 for entry in self.force_cell.tpdo):
            raise ValueError(
                "an amplifier with several cells has no scale in common with 0x6130; map 0x9130"
            )
        return self
