"""Drives and amplifiers on one segment of EtherCAT."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from tonus.config.schema.base import Count, Fraction, NonNegative, Section
from tonus.config.schema.bus.base import BusNode, DriveBus, Number, Place, numbers, once
from tonus.config.schema.bus.cells import Amplifier
from tonus.config.schema.drive import DriveProfile, Identity
from tonus.config.schema.tolerance import LostFrames


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


class EthercatBus(DriveBus):
    over_ethercat: ClassVar[bool] = True
    sends_last: ClassVar[bool] = True
    device: ClassVar[str] = "slave"
    listing: ClassVar[str] = "slaves"
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
        once(cls.device, *numbers(_nodes("", slaves)))
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
    def paces(self) -> bool:
        return self.clocks.pacing == "distributed_clock"

    def lost_frames(self, lost: LostFrames) -> dict[str, int]:
        return {"EtherCAT frames": lost.ethercat}

    def nodes(self) -> Iterator[BusNode]:
        yield from _nodes(self.interface, self.slaves)

    def places(self) -> Iterator[Place]:
        for index, slave in enumerate(self.slaves):
            if slave.axis is not None:
                yield ("slaves", index, "axis"), "axis", slave.axis
            for at, cell in enumerate(slave.cells):
                yield ("slaves", index, "cells", at), "cell", cell

    def identity(self, slave: Slave) -> Identity | None:
        """What a slave has to be."""
        kind = self.force_cell if slave.axis is None else self.profile(slave.axis)
        return slave.identity or kind.identity


def _nodes(interface: str, slaves: tuple[Slave, ...]) -> Iterator[BusNode]:
    for number, slave in enumerate(slaves, start=1):
        yield BusNode(interface, number, axis=slave.axis, cells=slave.cells)
