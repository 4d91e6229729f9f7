"""What stands in the lab by its configuration: drives and force cells, each on its bus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from tonus.config.schema.bus import (
    CanopenBus,
    DirectBus,
    EthercatBus,
    SeveralBuses,
    devices,
    parts,
)
from tonus.config.schema.lab import Lab as LabConfig
from tonus.config.schema.robot import Robot
from tonus.config.schema.root import Config
from tonus.sim.can.canopen.node import Node
from tonus.sim.can.wire.faulty import FaultyChannel
from tonus.sim.devices.cia402.drive import Cia402Drive
from tonus.sim.devices.eds import sheet as sheets
from tonus.sim.devices.eds.drive import EdsDrive
from tonus.sim.devices.epos4.drive import Epos4
from tonus.sim.devices.force_cell import ForceCell
from tonus.sim.devices.samples import Samples
from tonus.sim.devices.timers import Callback
from tonus.sim.errors import LabError
from tonus.sim.ethercat.build import build_segment
from tonus.sim.ethercat.segment import Segment

_FIRST_CELL = 17
"""Node id of cell 0 where no bus names one."""
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
    """The devices of a lab, and the buses they are on."""

    drives: list[Cia402Drive]
    cells: list[ForceCell]
    awaited: list[Cia402Drive]
    """drives that have to be enabled before the script begins: those emulated here"""
    channels: dict[str, FaultyChannel] = field(default_factory=dict)
    nodes: dict[tuple[str, int], Node] = field(default_factory=dict)
    segments: dict[str, Segment] = field(default_factory=dict)
    bitrate: int = 0
    """of the CAN channels, 0 without any"""


def build(
    timeline: Timeline,
    config: Config,
    emulated: frozenset[tuple[str, int]] | None,
    rewired: Callable[[], None],
) -> Hardware:
    """``emulated``: nodes (channel, node id), None: all; ``rewired`` is called when a node is cut
    off from its wire or joins it again. Raises `LabError`."""
    assert config.lab is not None
    lab, bus = config.lab, config.fieldbus
    buses = bus.buses if isinstance(bus, SeveralBuses) else (bus,)
    node_ids, amplifiers = _numbers(config.robot, buses)
    drives = [_drive(timeline, config, axis, node_id) for axis, node_id in enumerate(node_ids)]
    cells: Cells = {}
    for places, node_id in amplifiers:
        noise = lab.noise.force_cell
        cells[places] = ForceCell(places, node_id, timeline.samples, noise, timeline)
    built = Hardware(drives, list(cells.values()), drives)
    if isinstance(bus, DirectBus):
        for drive in drives:
            drive.set_operational(True)
        return built
    for each in buses:
        if isinstance(each, CanopenBus):
            built.bitrate = each.bitrate
            _add_channels(built, timeline, lab, each, cells, emulated, rewired)
        elif isinstance(each, EthercatBus):
            if built.segments:
                raise LabError(f"lab: emulates one EtherCAT segment, not {each.interface} too")
            segment = build_segment(timeline, each, lab, drives, cells, timeline.seed)
            built.segments[each.interface] = segment
    on_a_bus = [node.device for node in built.nodes.values()]
    on_a_bus += [slave.device for one in built.segments.values() for slave in one.slaves]
    built.awaited = [device for device in on_a_bus if isinstance(device, Cia402Drive)]
    return built


def _drive(timeline: Timeline, config: Config, axis: int, node_id: int) -> Cia402Drive:
    """The drive of an axis, from its profile's EDS or by a model of ours. Raises `LabError`."""
    lab, bus = config.lab, config.fieldbus
    assert lab is not None
    profile = bus.profile(axis)
    samples, stage, brake = timeline.samples, lab.drive, lab.plant.holding_brake
    if profile.eds is not None:
        sheet = sheets.read(profile.eds.name, profile.eds.text, node_id)
        on_can = not any(axis in devices(each)[0] for each in parts(bus) if each.kind == "ethercat")
        motor = config.robot.drive_trains[axis].motor
        feed = profile.scaling.position == "0x6092"
        return EdsDrive(
            axis,
            sheet,
            motor,
            samples,
            timeline,
            stage,
            holding_brake=brake,
            on_can=on_can,
            feed=feed,
        )
    if profile.emulated_as is None:
        raise LabError(
            f"fieldbus: the lab cannot emulate the {profile.name} of axis {axis}: its profile has "
            "no eds; add eds: FILE, the drive's electronic data sheet"
        )
    return Epos4(axis, node_id, samples, timeline, stage, holding_brake=brake)


def _numbers(
    robot: Robot,
    buses: tuple[CanopenBus | EthercatBus | DirectBus, ...],
) -> tuple[list[int], list[tuple[tuple[int, ...], int]]]:
    """Node id or position of each axis's drive, and of each amplifier with its cells."""
    drives = list(range(1, robot.cables + 1))
    amplifiers: list[tuple[tuple[int, ...], int]] = []
    for each in buses:
        if isinstance(each, CanopenBus):
            for channel in each.channels:
                for drive in channel.drives:
                    drives[drive.axis] = drive.node_id
                amplifiers += [(node.cells, node.node_id) for node in channel.force_cells]
        elif isinstance(each, EthercatBus):
            for number, slave in enumerate(each.slaves, start=1):
                if slave.axis is not None:
                    drives[slave.axis] = number
                else:
                    amplifiers.append((slave.cells, number))
        else:
            amplifiers = [((cell,), _FIRST_CELL + cell) for cell in range(robot.cells)]
    return drives, amplifiers


def _add_channels(
    built: Hardware,
    timeline: Timeline,
    lab: LabConfig,
    bus: CanopenBus,
    cells: Cells,
    emulated: frozenset[tuple[str, int]] | None,
    rewired: Callable[[], None],
) -> None:
    for spec in bus.channels:
        channel = FaultyChannel(
            spec.name,
            bus.bitrate,
            lab.bus.queue_depth,
            round(lab.bus.drive_response_us * 1e3),
            recovers=lab.bus.bus_off_recovers,
            rewired=rewired,
        )
        built.channels[spec.name] = channel
        devices: list[tuple[int, Cia402Drive | ForceCell]] = [
            *((drive.node_id, built.drives[drive.axis]) for drive in spec.drives),
            *((cell.node_id, cells[cell.cells]) for cell in spec.force_cells),
        ]
        for node_id, device in devices:
            if emulated is None or (spec.name, node_id) in emulated:
                built.nodes[spec.name, node_id] = Node(device, node_id, channel, timeline)
