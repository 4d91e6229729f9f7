"""From a configuration to its fieldbus, and to what paces a run on it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.bus import CanopenBus, DirectBus, EthercatBus, SeveralBuses, parts
from tonus.config.schema.root import Config
from tonus.drivers.canopen.master import CanopenFieldbus
from tonus.drivers.direct import DirectFieldbus
from tonus.drivers.ethercat.deterministic import DeterministicMaster
from tonus.drivers.ethercat.master import EthercatFieldbus
from tonus.drivers.ethercat.ring import injected_ring
from tonus.drivers.ethercat.soem import SoemMaster
from tonus.drivers.ethercat.wire import Wire
from tonus.drivers.fieldbus import Fieldbus, FrameTap
from tonus.drivers.process_image import ProcessImage
from tonus.drivers.several import SeveralFieldbuses
from tonus.runtime.timing import clock
from tonus.runtime.timing.scheduler import Pacing
from tonus.runtime.timing.steering import SteeredPacing
from tonus.sim.ethercat.ring import Ring
from tonus.sim.lab.engine import Lab
from tonus.tools.errors import ToolError


def channels(config: Config) -> list[str]:
    """The CAN channels of a configuration, in the order in which their frames are numbered."""
    return [
        channel.name
        for bus in parts(config.fieldbus)
        if isinstance(bus, CanopenBus)
        for channel in bus.channels
    ]


def build(
    config: Config, image: ProcessImage, lab: Lab | None = None, tap: FrameTap | None = None
) -> Fieldbus:
    """``lab`` is one in this process and this loop, whose buses are then used. Raises `ToolError`
    and `DriverError`."""
    bus = config.fieldbus
    if isinstance(bus, SeveralBuses):
        names = channels(config)

        def part(theirs: Config, rows: ProcessImage) -> Fieldbus:
            first = channels(theirs)
            return build(theirs, rows, lab, _numbered(tap, names.index(first[0]) if first else 0))

        return SeveralFieldbuses(config, image, part)
    if isinstance(bus, DirectBus):
        if lab is None:
            raise ToolError(
                "the direct fieldbus needs virtual time and a lab: add --virtual and a lab: section"
            )
        return DirectFieldbus(config, image, lab.direct, clock.loop_clock())
    if isinstance(bus, CanopenBus):
        return CanopenFieldbus(config, image, tap)
    return EthercatFieldbus(config, image, _wire(lab))


def _wire(lab: Lab | None) -> Callable[[EthercatBus, Callable[[], int]], Wire]:
    """SOEM on an interface; a lab of this process answers our own master."""
    if lab is None:
        return SoemMaster
    segments = lab.segments

    def deterministic(bus: EthercatBus, now_ns: Callable[[], int]) -> Wire:
        segment = segments[bus.interface]
        if bus.redundant_interface is None:
            return DeterministicMaster(bus, segment.exchange, now_ns)
        ring = Ring(segment)
        states = injected_ring(ring.through, now_ns)
        return DeterministicMaster(bus, ring.around, now_ns, states=states)

    return deterministic


def _numbered(tap: FrameTap | None, first: int) -> FrameTap | None:
    """The same tap for a bus whose channels are not the first."""
    return tap if tap is None or not first else _Numbered(tap, first)


class _Numbered:
    def __init__(self, tap: FrameTap, first: int) -> None:
        self._tap, self._first = tap, first

    def frame(
        self, stamp_ns: int, channel: int, identifier: int, data: bytes, *, sent: bool
    ) -> None:
        self._tap.frame(stamp_ns, self._first + channel, identifier, data, sent=sent)

    def received(self, frames: NDArray[np.void], channel: int, now_ns: int) -> None:
        self._tap.received(frames, self._first + channel, now_ns)


def steering(fieldbus: Fieldbus, pacing: Callable[[], Pacing]) -> Callable[[], Pacing]:
    """``pacing``, steered where the configuration lets a bus' clocks lead; the first one's."""
    found = [fieldbus]
    if isinstance(fieldbus, SeveralFieldbuses):
        found = list(fieldbus.parts)
    for each in found:
        if isinstance(each, EthercatFieldbus) and each.leads:
            clocks = each.clocks
            return lambda: SteeredPacing(pacing(), each, clocks)
    return pacing


def pacing_name(config: Config, *, virtual: bool) -> str:
    """What paces a run, for its log."""
    leads = any(
        isinstance(bus, EthercatBus) and bus.clocks.pacing == "distributed_clock"
        for bus in parts(config.fieldbus)
    )
    timer = "virtual time" if virtual else "timer"
    return f"distributed clock on {timer}" if leads else timer
