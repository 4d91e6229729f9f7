"""What a lab does for each kind of fieldbus: devices onto their bus."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from tonus.config.schema.bus import (
    SHIPPED,
    CanopenBus,
    DirectBus,
    EthercatBus,
    FieldbusSection,
    foreign,
)
from tonus.config.schema.outside import OutsideError
from tonus.sim.can.canopen.node import Node
from tonus.sim.can.canopen.sync_plan import plan
from tonus.sim.can.wire.faulty import FaultyChannel
from tonus.sim.devices.cia402.drive import Cia402Drive
from tonus.sim.devices.force_cell import ForceCell
from tonus.sim.errors import LabError
from tonus.sim.ethercat.build import build_segment
from tonus.sim.lab.hardware import Hardware

Emulate = Callable[[Hardware, Any], object]
"""Connects the devices of one bus, given its section, and adds those whose drives have to be
enabled to `Hardware.awaited`. Returns what the driver exchanges data with in this process, which
`Lab.port` hands out; None for nothing. Raises `LabError`."""


def emulate(hardware: Hardware, bus: FieldbusSection) -> None:
    """Connect the devices of one bus. Raises `LabError`."""
    hardware.ports.append((bus, _emulation(bus.kind)(hardware, bus)))


def _emulation(kind: str) -> Emulate:
    if kind in SHIPPED:
        return _SHIPPED[kind]
    try:
        found: Emulate | None = getattr(foreign(kind), "emulate", None)
    except OutsideError as error:
        raise LabError(f"fieldbus.kind {kind}: {error}") from error
    if found is None:
        raise LabError(
            f"fieldbus.kind {kind}: has no emulation; remove the lab section, or give its "
            "registration an emulate"
        )
    return found


def _direct(hardware: Hardware, bus: DirectBus) -> None:
    del bus  # carries every device
    for drive in hardware.drives:
        drive.set_operational(True)
    hardware.awaited += hardware.drives


def _segment(hardware: Hardware, bus: EthercatBus) -> None:
    if hardware.segments:
        raise LabError(f"lab: emulates one EtherCAT segment, not {bus.interface} too")
    timeline = hardware.timeline
    segment = build_segment(
        timeline, bus, hardware.config, hardware.drives, hardware.amplifiers, timeline.seed
    )
    hardware.segments[bus.interface] = segment
    devices = (slave.device for slave in segment.slaves)
    hardware.awaited += [device for device in devices if isinstance(device, Cia402Drive)]


def _channels(hardware: Hardware, bus: CanopenBus) -> None:
    lab = hardware.config
    hardware.bitrate = bus.bitrate
    for spec in bus.channels:
        channel = FaultyChannel(
            spec.name,
            bus.bitrate,
            lab.bus.queue_depth,
            round(lab.bus.drive_response_us * 1e3),
            recovers=lab.bus.bus_off_recovers,
            rewired=hardware.rewired,
        )
        hardware.channels[spec.name] = channel
        made: list[Node] = []
        channel.planner = partial(plan, channel, made, hardware.timeline.samples)
        for node in spec.nodes():
            device: Cia402Drive | ForceCell
            if node.axis is None:
                device = hardware.amplifiers[node.cells]
            else:
                device = hardware.drives[node.axis]
            if hardware.emulated is None or (spec.name, node.number) in hardware.emulated:
                made.append(Node(device, node.number, channel, hardware.timeline))
                hardware.nodes[spec.name, node.number] = made[-1]
                if isinstance(device, Cia402Drive):
                    hardware.awaited.append(device)


_SHIPPED: dict[str, Emulate] = {
    "canopen": _channels,
    "direct": _direct,
    "ethercat": _segment,
}
