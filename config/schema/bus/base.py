"""What every kind of fieldbus is to the rest: nodes, profiles of drives, frames it may lose."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from tonus.config.errors import PlacedError, no_such
from tonus.config.schema.base import Section
from tonus.config.schema.bus.cells import Amplifier, ForceCell
from tonus.config.schema.drive import DriveProfile
from tonus.config.schema.tolerance import LostFrames

KeyPath = tuple[str | int, ...]
Place = tuple[KeyPath, Literal["axis", "cell"], int]
"""A key of a bus' section, and the axis or the cell that it names."""
Number = Annotated[int, Field(ge=0)]
"""Of an axis or a cell. How many there are the robot says: `check_devices`."""


@dataclass(frozen=True)
class BusNode:
    """One device with an address: a drive (``axis``) or an amplifier (``cells``)."""

    channel: str
    number: int
    """node id, or position from 1"""
    axis: int | None = None
    cells: tuple[int, ...] = ()
    """the cell on each channel of the amplifier"""


class FieldbusSection(Section):
    """The ``fieldbus:`` section of one kind. A kind overrides what its devices need.

    A bus that lists no nodes carries every axis and every cell of the robot, without addresses.
    """

    kind: str
    virtual_only: ClassVar[bool] = False
    """there is no such hardware: it needs virtual time and a lab"""
    heartbeats: ClassVar[bool] = False
    """drives and master watch each other by CiA 301 heartbeats"""
    over_ethercat: ClassVar[bool] = False
    """drives have the communication objects of CoE, not of CiA 301"""
    sends_last: ClassVar[bool] = False
    """with other buses, published to after them: in virtual time its frame passes later in the
    tick"""
    device: ClassVar[str] = "node"
    listing: ClassVar[str] = "nodes"
    """in errors: what a device is called, and the key with all of them"""

    @property
    def parts(self) -> tuple[FieldbusSection, ...]:
        """The buses that it consists of."""
        return (self,)

    @property
    def faults(self) -> str:
        """The name of its family in a study's ``buses``."""
        return self.kind

    @property
    def paces(self) -> bool:
        """The clocks of its devices lead the loop."""
        return False

    def lost_frames(self, lost: LostFrames) -> dict[str, int]:
        """Frames without which a measurement is missing, and how many of each may be lost in a
        row; empty for a bus that loses none."""
        del lost
        return {}

    @property
    def can_channels(self) -> list[str]:
        """Names of the channels whose CAN frames its driver hands to a tap, to be recorded."""
        return []

    def nodes(self) -> Iterator[BusNode]:
        """In the order of the section."""
        yield from ()

    def places(self) -> Iterator[Place]:
        """Every axis and cell, and the key below this section that an error about it names."""
        for node in self.nodes():
            if node.axis is not None:
                yield (), "axis", node.axis
            for cell in node.cells:
                yield (), "cell", cell

    def profile(self, axis: int) -> DriveProfile:
        """Of the drive of an axis."""
        raise NotImplementedError

    @property
    def every_profile(self) -> dict[str, DriveProfile]:
        """By the place in the configuration."""
        raise NotImplementedError

    if TYPE_CHECKING:  # or pydantic would take a key of that name for a mistake

        @property
        def force_cell(self) -> ForceCell | Amplifier:
            """What its amplifiers are."""

    @property
    def devices(self) -> tuple[list[int], list[int]]:
        """The axes and the cells that have a node on it."""
        return numbers(self.nodes())

    @property
    def axis_places(self) -> dict[int, str]:
        """Channel and node of each axis' drive."""
        return {
            node.axis: f"{node.channel}/{node.number}"
            for node in self.nodes()
            if node.axis is not None
        }

    @property
    def cell_places(self) -> dict[int, str]:
        """Channel and node of each cell's amplifier."""
        return {cell: f"{n.channel}/{n.number}" for n in self.nodes() for cell in n.cells}


class DriveBus(FieldbusSection):
    """A bus with drives: a profile for all of them, and others by name for some."""

    drive: DriveProfile
    """of every axis that names no other"""
    profiles: dict[str, DriveProfile] = Field(default_factory=dict)

    def chosen(self) -> dict[int, str]:
        """Axis to the name of its profile, where it names one."""
        return {}

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
    def _named_profiles_are_there(self) -> DriveBus:
        for axis, name in self.chosen().items():
            if name not in self.profiles:
                known = ", ".join(self.profiles) or "none: add it to profiles"
                raise ValueError(f"axis {axis}: there is no drive profile {name!r}; known: {known}")
        return self


def check_devices(bus: FieldbusSection, axes: int, cells: int) -> None:
    """That each of so many axes and cells has its device, and that there are no others. Raises
    `PlacedError`."""
    if not any(True for part in bus.parts for _ in part.nodes()):
        return
    found: dict[str, set[int]] = {"axis": set(), "cell": set()}
    for path, kind, number in bus.places():
        count = axes if kind == "axis" else cells
        if number >= count:
            raise no_such(path, kind, number, count)
        found[kind].add(number)
    for what, count in (("axis", axes), ("cell", cells)):
        missing = sorted(set(range(count)) - found[what])
        if missing:
            text = f"no {bus.device} for {what} {missing[0]}; add one"
            raise PlacedError((bus.listing,), text)


def numbers(nodes: Iterable[BusNode]) -> tuple[list[int], list[int]]:
    """The axes and the cells of nodes, in their order."""
    every = list(nodes)
    axes = [node.axis for node in every if node.axis is not None]
    return axes, [cell for node in every for cell in node.cells]


def once(device: str, axes: list[int], cells: list[int]) -> None:
    """Raises `ValueError` for an axis or a cell that is there twice."""
    for what, found in (("axis", axes), ("cell", cells)):
        twice = sorted({number for number in found if found.count(number) > 1})
        if twice:
            raise ValueError(f"{what} {twice[0]} has more than one {device}; give it one")
