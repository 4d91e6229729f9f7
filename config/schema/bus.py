"""How the devices hang on their buses, and what each device must be."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from tonus.config.errors import PlacedError, no_such
from tonus.config.schema.base import Count, Fraction, NodeId, NonNegative, Positive, Section
from tonus.config.schema.drive import Device, DriveProfile, Identity, MappingEntry

KeyPath = tuple[str | int, ...]
AMPLIFIER_CHANNELS = 4
"""Cells that one node carries at most: as many 16-bit values as a frame holds."""
_REAL32 = 0x6130
Number = Annotated[int, Field(ge=0)]
"""Of an axis or a cell. How many there are the robot says: `check_devices`."""


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


class Master(Section):
    """What our side of every channel does. Ticks are those of the control loop."""

    node_id: NodeId
    heartbeat_ms: Count
    heartbeat_periods: Count | None = None
    """a node is silent after so many of its own periods; null: as `tolerance` has it"""
    sdo_timeout_ms: Count
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


class _Drives(Section):
    """What every fieldbus has: a profile for its drives, and others by name for some of them."""

    drive: DriveProfile
    """of every axis that names no other"""
    profiles: dict[str, DriveProfile] = Field(default_factory=dict)

    def chosen(self) -> dict[int, str]:
        """Axis to the name of its profile, where it names one."""
        raise NotImplementedError

    def profile(self, axis: int) -> DriveProfile:
        """Of the drive of an axis."""
        name = self.chosen().get(axis)
        return self.drive if name is None else self.profiles[name]

    def profile_key(self, axis: int) -> str:
        """Where the profile of an axis stands in the configuration."""
        name = self.chosen().get(axis)
        return "fieldbus.drive" if name is None else f"fieldbus.profiles.{name}"

    @property
    def every_profile(self) -> dict[str, DriveProfile]:
        """By the place in the configuration."""
        others = {f"fieldbus.profiles.{name}": each for name, each in self.profiles.items()}
        return {"fieldbus.drive": self.drive, **others}

    @model_validator(mode="after")
    def _named_profiles_are_there(self) -> _Drives:
        for axis, name in self.chosen().items():
            if name not in self.profiles:
                known = ", ".join(self.profiles) or "none: add it to profiles"
                raise ValueError(f"axis {axis}: there is no drive profile {name!r}; known: {known}")
        return self


class CanopenBus(_Drives):
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
        _once("node", *_on_channels(channels))
        return channels

    def chosen(self) -> dict[int, str]:
        drives = (drive for channel in self.channels for drive in channel.drives)
        return {drive.axis: drive.profile for drive in drives if drive.profile is not None}

    @property
    def axis_places(self) -> dict[int, str]:
        """Channel and node of each axis' drive."""
        return {
            drive.axis: f"{channel.name}/{drive.node_id}"
            for channel in self.channels
            for drive in channel.drives
        }

    @property
    def cell_places(self) -> dict[int, str]:
        """Channel and node of each cell's amplifier."""
        return {
            cell: f"{channel.name}/{node.node_id}"
            for channel in self.channels
            for node in channel.force_cells
            for cell in node.cells
        }

    @model_validator(mode="after")
    def _one_scale_for_all_cells(self) -> CanopenBus:
        several = any(len(node.cells) > 1 for c in self.channels for node in c.force_cells)
        if several and any(entry >> 16 == _REAL32 for entry in self.force_cell.tpdo):
            raise ValueError(
                "an amplifier with several cells has no scale in common with 0x6130; map 0x9130"
            )
        return self


class DirectBus(_Drives):
    """The same quantities without frames: for campaigns, tuning and comparison."""

    kind: Literal["direct"]
    axes: dict[Number, str] = Field(default_factory=dict)
    """axis to one of the ``profiles``"""
    force_cell: ForceCell
    sample_offset_us: NonNegative
    """time from the start of the tick to the sampling of every device"""

    def chosen(self) -> dict[int, str]:
        return dict(self.axes)


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


class Slave(Section):
    """One slave of a segment: a drive (``axis: 3``) or an amplifier (``cells: [0, 1]``)."""

    axis: Number | None = None
    profile: str | None = None
    """of a drive: one of the bus' ``profiles``; null: its ``drive``"""
    cells: tuple[Number, ...] = ()
    """the cell on each channel, in the order of the channels"""
    identity: Identity | None = None
    """where it differs from its kind's"""

    @model_validator(mode="after")
    def _one_kind(self) -> Slave:
        if (self.axis is None) == (not self.cells):
            raise ValueError("a slave has either an axis or cells; give it one of the two")
        if self.axis is None and self.profile is not None:
            raise ValueError("a slave with cells has no drive profile; remove it")
        return self


class DistributedClocks(Section):
    """SYNC0 in every slave at the period of the tick, and how the loop keeps its phase to it."""

    pacing: Literal["distributed_clock", "timer"]
    """what the loop's phase follows: the reference clock, or its own timer alone"""
    shift_us: NonNegative
    """SYNC0 after the start of the tick; the frame has to pass after it and before the next"""
    frame_us: NonNegative
    """when the frame passes in virtual time, where computing takes none; after ``shift_us``"""
    settle_ns: Count
    """largest difference of a slave's clock from the reference before the segment starts"""
    settle_ms: Count
    """time allowed for that"""
    limit_ns: Count
    """a slave's clock further away than this is an event"""
    guard_us: NonNegative
    """a frame that passes closer to SYNC0 than this is an event"""
    proportional: Fraction
    """share of the phase error that one tick takes back"""
    integral: Fraction
    """share of it that becomes part of the period"""
    slew_ns: Count
    """the most that one tick is moved"""


class EthercatMaster(Section):
    """What our side of a segment does. Ticks are those of the control loop."""

    receive_timeout_us: Count
    """how long a tick waits for a frame that should have been there before it began"""
    watchdog_ms: Count | None = None
    """sync manager watchdog: outputs missing for so long stop the drive; null: as `tolerance` has
    it"""
    watch_ticks: Count
    """how often every slave's state is read, outside the tick"""
    state_policy: Literal["recover", "stop"]
    """a slave that left OP is brought back at once, or left for a reset of the operator; either
    way its axis or cells are lost meanwhile"""
    attempts: Count
    """times a slave is brought back before it is left alone until a reset"""
    state_timeout_ms: Count
    sdo_timeout_ms: Count


class EthercatBus(_Drives):
    kind: Literal["ethercat"]
    interface: str
    """network interface of the segment's first cable"""
    redundant_interface: str | None = None
    """of the cable back from its last slave, where there is one"""
    master: EthercatMaster
    clocks: DistributedClocks
    force_cell: Amplifier
    slaves: Annotated[tuple[Slave, ...], Field(min_length=1)]
    """in the order of the cable"""

    @field_validator("slaves")
    @classmethod
    def _every_slave_once(cls, slaves: tuple[Slave, ...]) -> tuple[Slave, ...]:
        _once("slave", *_rows(slaves))
        return slaves

    @property
    def interfaces(self) -> list[str]:
        """One, or both ends of a ring."""
        ends = [self.interface]
        if self.redundant_interface is not None:
            ends.append(self.redundant_interface)
        return ends

    def chosen(self) -> dict[int, str]:
        found = ((slave.axis, slave.profile) for slave in self.slaves)
        return {axis: name for axis, name in found if axis is not None and name is not None}

    def profile(self, axis: int) -> DriveProfile:
        """Of the drive of an axis, as it is on EtherCAT."""
        return super().profile(axis).on_ethercat

    @property
    def every_profile(self) -> dict[str, DriveProfile]:
        """By the place in the configuration, as they are on EtherCAT."""
        return {key: each.on_ethercat for key, each in super().every_profile.items()}

    @property
    def axis_places(self) -> dict[int, str]:
        """Interface and number, from 1, of each axis' drive."""
        return {
            slave.axis: f"{self.interface}/{number}"
            for number, slave in enumerate(self.slaves, start=1)
            if slave.axis is not None
        }

    @property
    def cell_places(self) -> dict[int, str]:
        """Interface and number, from 1, of each cell's amplifier."""
        return {
            cell: f"{self.interface}/{number}"
            for number, slave in enumerate(self.slaves, start=1)
            for cell in slave.cells
        }

    def identity(self, slave: Slave) -> Identity | None:
        """What a slave has to be."""
        kind = self.force_cell if slave.axis is None else self.profile(slave.axis)
        return slave.identity or kind.identity


class SeveralBuses(Section):
    """Devices on more than one fieldbus, all exchanged in the same tick."""

    kind: Literal["several"]
    buses: Annotated[
        tuple[Annotated[CanopenBus | EthercatBus, Field(discriminator="kind")], ...],
        Field(min_length=1),
    ]

    @field_validator("buses")
    @classmethod
    def _every_device_once(
        cls, buses: tuple[CanopenBus | EthercatBus, ...]
    ) -> tuple[CanopenBus | EthercatBus, ...]:
        axes: list[int] = []
        cells: list[int] = []
        for bus in buses:
            more_axes, more_cells = devices(bus)
            axes += more_axes
            cells += more_cells
        _once("device", axes, cells)
        return buses

    def profile(self, axis: int) -> DriveProfile:
        """Of the drive of an axis, on the bus it is on."""
        return next(bus for bus in self.buses if axis in devices(bus)[0]).profile(axis)

    @property
    def force_cell(self) -> ForceCell | Amplifier:
        """Of the first bus with cells."""
        return next(bus.force_cell for bus in self.buses if devices(bus)[1])


Bus = Annotated[CanopenBus | DirectBus | EthercatBus | SeveralBuses, Field(discriminator="kind")]


def parts(bus: Bus) -> tuple[CanopenBus | EthercatBus, ...]:
    """The buses with frames that a fieldbus consists of."""
    if isinstance(bus, SeveralBuses):
        return bus.buses
    return () if isinstance(bus, DirectBus) else (bus,)


def devices(bus: CanopenBus | EthercatBus) -> tuple[list[int], list[int]]:
    """The axes and the cells that hang on a bus."""
    return _rows(bus.slaves) if isinstance(bus, EthercatBus) else _on_channels(bus.channels)


def check_devices(bus: Bus, axes: int, cells: int) -> None:
    """That each of so many axes and cells has its device, and that there are no others. Raises
    `PlacedError`."""
    if isinstance(bus, DirectBus):
        return
    found: dict[str, set[int]] = {"axis": set(), "cell": set()}
    for path, kind, number in _numbers(bus):
        count = axes if kind == "axis" else cells
        if number >= count:
            raise no_such(path, kind, number, count)
        found[kind].add(number)
    device, where = {
        "canopen": ("node", "channels"),
        "ethercat": ("slave", "slaves"),
        "several": ("device", "buses"),
    }[bus.kind]
    for what, count in (("axis", axes), ("cell", cells)):
        missing = sorted(set(range(count)) - found[what])
        if missing:
            raise PlacedError((where,), f"no {device} for {what} {missing[0]}; add one")


def _numbers(bus: Bus) -> Iterator[tuple[KeyPath, Literal["axis", "cell"], int]]:
    """Every number of an axis or a cell on a bus, and where in its section it stands."""
    if isinstance(bus, SeveralBuses):
        for index, part in enumerate(bus.buses):
            for path, kind, number in _numbers(part):
                yield ("buses", index, *path), kind, number
    elif isinstance(bus, EthercatBus):
        for index, slave in enumerate(bus.slaves):
            if slave.axis is not None:
                yield ("slaves", index, "axis"), "axis", slave.axis
            for place, cell in enumerate(slave.cells):
                yield ("slaves", index, "cells", place), "cell", cell
    elif isinstance(bus, CanopenBus):
        for index, channel in enumerate(bus.channels):
            for place, drive in enumerate(channel.drives):
                yield ("channels", index, "drives", place, "axis"), "axis", drive.axis
            for place, node in enumerate(channel.force_cells):
                for cell in node.cells:
                    yield ("channels", index, "force_cells", place), "cell", cell


def _rows(slaves: tuple[Slave, ...]) -> tuple[list[int], list[int]]:
    axes = [slave.axis for slave in slaves if slave.axis is not None]
    return axes, [cell for slave in slaves for cell in slave.cells]


def _on_channels(channels: tuple[Channel, ...]) -> tuple[list[int], list[int]]:
    axes = [drive.axis for channel in channels for drive in channel.drives]
    nodes = [node for channel in channels for node in channel.force_cells]
    return axes, [cell for node in nodes for cell in node.cells]


def _once(kind: str, axes: list[int], cells: list[int]) -> None:
    """Raises `ValueError` for an axis or a cell that is there twice."""
    for what, found in (("axis", axes), ("cell", cells)):
        twice = sorted({number for number in found if found.count(number) > 1})
        if twice:
            raise ValueError(f"{what} {twice[0]} has more than one {kind}; give it one")


class Tracker(Section):
    """The optical tracker: one UDP datagram a pose (docs/tracker.md)."""

    address: str
    port: Annotated[int, Field(ge=1, le=65535)]
    rate_hz: Positive
    latency_ms: NonNegative
    """nominal age of a pose when it arrives; the timestamp decides, this only sizes buffers"""
    position_sigma: Positive
    """m"""
    rotation_sigma: Positive
    """rad"""
    maximum_age_ms: Positive
    """without a pose for this long the estimator runs on the cables alone, as a named state"""
