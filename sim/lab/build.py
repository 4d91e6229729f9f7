"""What stands in the lab by its configuration: drives and force cells, each on its bus."""

from __future__ import annotations

from collections.abc import Callable

from tonus.config.schema.bus import FieldbusSection
from tonus.config.schema.robot import Robot
from tonus.config.schema.root import Config
from tonus.sim.devices.cia402.drive import Cia402Drive
from tonus.sim.devices.eds import sheet as sheets
from tonus.sim.devices.eds.drive import EdsDrive
from tonus.sim.devices.epos4.drive import Epos4
from tonus.sim.devices.force_cell import ForceCell
from tonus.sim.errors import LabError
from tonus.sim.lab.emulation import emulate
from tonus.sim.lab.hardware import Cells, Hardware, Timeline
from tonus.sim.lab.sto_relay import emulate_relay

_FIRST_CELL = 17
"""Node id of cell 0 where no bus names one."""


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
    node_ids, amplifiers = _numbers(config.robot, bus)
    drives = [_drive(timeline, config, axis, node_id) for axis, node_id in enumerate(node_ids)]
    cells: Cells = {}
    for places, node_id in amplifiers:
        noise = lab.noise.force_cell
        cells[places] = ForceCell(places, node_id, timeline.samples, noise, timeline)
    built = Hardware(timeline, lab, drives, cells, emulated, rewired)
    for part in bus.parts:
        emulate(built, part)
    if config.relay is not None:
        emulate_relay(built, config.relay)
    return built


def _drive(timeline: Timeline, config: Config, axis: int, node_id: int) -> Cia402Drive:
    """The drive of an axis, from its profile's EDS or by a model of ours. Raises `LabError`."""
    lab, bus = config.lab, config.fieldbus
    assert lab is not None
    profile = bus.profile(axis)
    samples, stage = timeline.samples, lab.drive
    train = config.robot.drive_trains[axis]
    if profile.eds is not None:
        sheet = sheets.read(profile.eds.name, profile.eds.text, node_id)
        on_can = not any(axis in each.devices[0] for each in bus.parts if each.over_ethercat)
        feed = profile.scaling.position == "0x6092"
        return EdsDrive(
            axis,
            sheet,
            train.motor,
            samples,
            timeline,
            stage,
            train.brake,
            on_can=on_can,
            feed=feed,
        )
    if profile.emulated_as is None:
        raise LabError(
            f"fieldbus: the lab cannot emulate the {profile.name} of axis {axis}: its profile has "
            "no eds; add eds: FILE, the drive's electronic data sheet"
        )
    return Epos4(axis, node_id, samples, timeline, stage, train.brake)


def _numbers(
    robot: Robot, bus: FieldbusSection
) -> tuple[list[int], list[tuple[tuple[int, ...], int]]]:
    """Node id or position of each axis's drive, and of each amplifier with its cells."""
    drives = list(range(1, robot.cables + 1))
    amplifiers: list[tuple[tuple[int, ...], int]] = []
    for part in bus.parts:
        for node in part.nodes():
            if node.axis is not None:
                drives[node.axis] = node.number
            else:
                amplifiers.append((node.cells, node.number))
    if not amplifiers:
        amplifiers = [((cell,), _FIRST_CELL + cell) for cell in range(robot.cells)]
    return drives, amplifiers
