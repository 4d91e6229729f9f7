"""The devices of a lab before and after each fieldbus has taken its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from tonus.config.schema.bus import FieldbusSection
from tonus.config.schema.lab import Lab as LabConfig
from tonus.sim.can.canopen.node import Node
from tonus.sim.can.wire.faulty import FaultyChannel
from tonus.sim.devices.cia402.drive import Cia402Drive
from tonus.sim.devices.force_cell import ForceCell
from tonus.sim.devices.samples import Samples
from tonus.sim.devices.timers import Callback
from tonus.sim.ethercat.segment import Segment

Cells = dict[tuple[int, ...], ForceCell]
"""amplifiers, by the cells on their channels"""


class Timeline(Protocol):
    """The lab's time, as devices and segments use it."""

    now_ns: int
    samples: Samples
    seed: int

    def advance(self, to_ns: int) -> None: ...

    def call_at(self, at_ns: int, callback: Callback) -> None: ...


@dataclass
class Hardware:
    """The devices of a lab, and the buses they are on. An emulation adds what it makes of them."""

    timeline: Timeline
    config: LabConfig
    drives: list[Cia402Drive]
    """by axis"""
    amplifiers: Cells
    emulated: frozenset[tuple[str, int]] | None
    """nodes (channel, node id); None: all"""
    rewired: Callable[[], None]
    """called when a node is cut off from its wire or joins it again"""
    awaited: list[Cia402Drive] = field(default_factory=list)
    """drives that have to be enabled before the script begins: those emulated here"""
    channels: dict[str, FaultyChannel] = field(default_factory=dict)
    nodes: dict[tuple[str, int], Node] = field(default_factory=dict)
    segments: dict[str, Segment] = field(default_factory=dict)
    bitrate: int = 0
    """of the CAN channels, 0 without any"""
    ports: list[tuple[FieldbusSection, object]] = field(default_factory=list)
    """each bus, and what its driver exchanges data with in this process, None for nothing"""

    @property
    def cells(self) -> list[ForceCell]:
        """In the order of the buses."""
        return list(self.amplifiers.values())

    @property
    def samples(self) -> Samples:
        """What drives and cells measure."""
        return self.timeline.samples

    def advance(self, to_ns: int) -> None:
        """Let everything happen that is due until then."""
        self.timeline.advance(to_ns)
