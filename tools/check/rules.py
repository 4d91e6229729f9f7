"""What can be known about a configuration before anything is started.

The schema has already judged every value by itself; these rules judge values against each other,
against the buses' arithmetic and against the robot's mechanics.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from tonus.config import Config, Scenario
from tonus.config.busload import channel_load
from tonus.config.schema.bus import (
    Amplifier,
    CanopenBus,
    Channel,
    DirectBus,
    EthercatBus,
    ForceCell,
    parts,
)
from tonus.config.schema.drive import DriveProfile
from tonus.config.schema.robot_faults import OfRobot, PhantomHit
from tonus.drivers.canopen import identifiers
from tonus.drivers.canopen.process_data import drive_encoder
from tonus.drivers.cia301.pdo import Mapping, PdoError
from tonus.drivers.devices import drive, force_cell
from tonus.tools.check.controller import check_controller
from tonus.tools.check.data_sheets import check_data_sheets
from tonus.tools.check.ethercat import check_ethercat
from tonus.tools.check.finding import Finding
from tonus.tools.check.losses import check_losses
from tonus.tools.check.mechanics import mechanics, scenario_rules
from tonus.tools.check.plausibility import plausibility

__all__ = ["Finding", "check", "check_catalogue"]


@dataclass(frozen=True)
class _Node:
    name: str
    node_id: int
    base_identifiers: tuple[int, ...]


def check(config: Config, scenario: Scenario, *, timed: bool = False) -> list[Finding]:
    """Every rule's outcome, in a fixed order; nothing is started and nothing raises. ``timed``:
    with the measured time of a controller that is not ours, which is the host's too."""
    findings: list[Finding] = list(plausibility(config))
    if not all(finding.ok for finding in findings):
        return findings  # whatever would be computed from them would mislead
    if isinstance(config.fieldbus, DirectBus):
        findings += _mappings(config.fieldbus)
    for bus in parts(config.fieldbus):
        findings += _mappings(bus)
        if isinstance(bus, EthercatBus):
            findings += check_ethercat(config, bus)
            continue
        findings += _period(bus, config.control.rates.period_us)
        findings += _channel_names(bus)
        for channel in bus.channels:
            findings += _load(bus, channel, config.control.rates.period_us)
            findings += _identifiers(bus, channel)
    findings += check_data_sheets(config)
    findings += check_losses(config)
    findings += _faults(config, scenario)
    findings += mechanics(config, scenario)
    return findings + list(check_controller(config, timed=timed))


def check_catalogue(
    config: Config, played: Scenario, others: Iterable[Scenario]
) -> Iterator[Finding]:
    """What else an operator may choose: of each scenario what depends on it."""
    for scenario in others:
        if scenario.name == played.name:
            continue
        found = [*_faults(config, scenario)] if parts(config.fieldbus) else []
        found += scenario_rules(config, scenario)
        failed = [each for each in found if not each.ok]
        yield from failed
        if not failed:
            text = f"{scenario.name} may be chosen"
            yield Finding("catalogue", True, "operation.scenarios", text, "leave it out")


def _mappings(bus: CanopenBus | DirectBus | EthercatBus) -> Iterator[Finding]:
    for key, profile in bus.every_profile.items():
        yield from _drive_mappings(key, profile)
    yield _cell_mapping(bus.force_cell)


def _drive_mappings(key: str, profile: DriveProfile) -> Iterator[Finding]:
    needed = "statusword 0x60410010, position 0x60640020 and torque 0x60770010"
    commands = "controlword 0x60400010 and target torque 0x60710010"
    try:
        drive_encoder(Mapping.of(profile.rpdo))
        problem = ""
    except PdoError as error:
        problem = str(error)
    yield Finding(
        "PDO mapping",
        not problem,
        f"{key}.rpdo",
        problem or f"maps {commands}",
        f"map {commands}",
    )
    try:
        mapping = Mapping.of(profile.tpdo)
        for entry in (drive.STATUSWORD, drive.POSITION_ACTUAL, drive.TORQUE_ACTUAL):
            mapping.position(entry)
        problem = ""
    except PdoError as error:
        problem = str(error)
    yield Finding(
        "PDO mapping",
        not problem,
        f"{key}.tpdo",
        problem or f"maps {needed}",
        f"map {needed}",
    )


def _cell_mapping(cell: ForceCell | Amplifier) -> Finding:
    values = ", ".join(f"0x{entry:08X}" for entry in force_cell.PROCESS_VALUES)
    try:
        found = set(Mapping.of(cell.tpdo).entries) & set(force_cell.PROCESS_VALUES)
        problem = "" if found else "the PDO maps no process value of channel 1"
    except PdoError as error:
        problem = str(error)
    return Finding(
        "PDO mapping",
        not problem,
        "fieldbus.force_cell.tpdo",
        problem or "maps the process value",
        f"map one of {values}",
    )


def _period(bus: CanopenBus, period_us: int) -> Iterator[Finding]:
    heartbeat_us = bus.master.heartbeat_ms * 1000
    fits = heartbeat_us % period_us == 0
    yield Finding(
        "period",
        fits,
        "control.rates.period_us",
        f"the master's heartbeat of {bus.master.heartbeat_ms} ms is "
        f"{heartbeat_us / period_us:g} cycles of {period_us} us",
        "choose a period that divides fieldbus.master.heartbeat_ms",
    )


def _channel_names(bus: CanopenBus) -> Iterator[Finding]:
    twice = [name for name, count in Counter(c.name for c in bus.channels).items() if count > 1]
    text = f"{twice[0]} is given twice" if twice else f"{len(bus.channels)} channels"
    yield Finding(
        "channel names", not twice, "fieldbus.channels", text, "give every channel its own name"
    )


def _load(bus: CanopenBus, channel: Channel, period_us: int) -> Iterator[Finding]:
    load = channel_load(bus, channel, period_us)
    yield Finding(
        "bus load",
        load.share <= bus.load_limit,
        f"fieldbus.channels {channel.name}",
        f"channel {channel.name} carries {load.cyclic_us:.0f} us of frames in a cycle of "
        f"{period_us} us ({100 * load.cyclic_share:.1f} %, with heartbeats "
        f"{100 * load.share:.1f} %), the limit is {100 * bus.load_limit:g} %",
        "use more channels or a longer period",
    )


def _nodes(bus: CanopenBus, channel: Channel) -> Iterator[_Node]:
    every = (
        identifiers.EMCY,
        identifiers.SDO_RESPONSE,
        identifiers.SDO_REQUEST,
        identifiers.HEARTBEAT,
    )
    yield _Node("the master", bus.master.node_id, (identifiers.HEARTBEAT,))
    for each in channel.drives:
        profile = bus.profile(each.axis)
        pdos = _pdos(profile.rpdo, profile.tpdo)
        yield _Node(f"axis {each.axis}", each.node_id, (*every, *pdos))
    for cell in channel.force_cells:
        pdos = _pdos(bus.force_cell.rpdo, bus.force_cell.tpdo)
        yield _Node(f"cell {' '.join(map(str, cell.cells))}", cell.node_id, (*every, *pdos))


def _pdos(rpdo: tuple[int, ...], tpdo: tuple[int, ...]) -> tuple[int, ...]:
    used = ((rpdo, identifiers.RPDO1), (tpdo, identifiers.TPDO1))
    return tuple(identifier for mapping, identifier in used if mapping)


def _identifiers(bus: CanopenBus, channel: Channel) -> Iterator[Finding]:
    where = f"fieldbus.channels {channel.name}"
    nodes = list(_nodes(bus, channel))
    owners: dict[int, str] = {}
    clash = ""
    for node in nodes:
        if node.node_id in owners and not clash:
            clash = f"{owners[node.node_id]} and {node.name} both have node id {node.node_id}"
        owners.setdefault(node.node_id, node.name)
    yield Finding(
        "node ids",
        not clash,
        where,
        clash or f"{channel.name}: {len(nodes)} nodes, all different",
        "give every node of a channel, the master included, its own node id",
    )
    owners = {identifiers.NMT: "NMT", identifiers.SYNC: "SYNC"}
    clash = ""
    for node in nodes:
        for base in node.base_identifiers:
            cob_id = base + node.node_id
            if cob_id in owners and not clash:
                clash = f"{owners[cob_id]} and {node.name} both use COB-ID 0x{cob_id:03X}"
            owners.setdefault(cob_id, node.name)
    yield Finding(
        "COB-IDs",
        not clash,
        where,
        clash or f"{channel.name}: {len(owners)} identifiers, all apart",
        "change one of the two node ids",
    )


def _faults(config: Config, scenario: Scenario) -> Iterator[Finding]:
    """A fault injected where there is nothing would never be seen."""
    nodes: set[tuple[str, int]] = set()
    for bus in parts(config.fieldbus):
        if isinstance(bus, EthercatBus):
            nodes |= {(bus.interface, number + 1) for number in range(len(bus.slaves))}
            continue
        for channel in bus.channels:
            nodes |= {(channel.name, each.node_id) for each in channel.drives}
            nodes |= {(channel.name, cell.node_id) for cell in channel.force_cells}
    channels = {name for name, _ in nodes}
    for index, fault in enumerate(scenario.lab.faults):
        node = getattr(fault, "node", None)
        if isinstance(fault, OfRobot):
            yield _robot_fault(config, scenario, index, fault)
            continue
        if node is not None:
            there = (fault.channel, node) in nodes
            what = f"{fault.kind} of node {node} on {fault.channel}"
        else:
            there = fault.channel is None or fault.channel in channels
            what = f"{fault.kind} on {fault.channel or 'every channel'}"
        yield Finding(
            "faults",
            there,
            f"scenario {scenario.name}: lab.faults.{index}",
            what + ("" if there else ", which is not there"),
            "name a channel and a node of the fieldbus",
        )


def _robot_fault(config: Config, scenario: Scenario, index: int, fault: OfRobot) -> Finding:
    where = f"scenario {scenario.name}: lab.faults.{index}"
    for name, count in (("axis", config.robot.cables), ("cell", config.robot.cells)):
        number = getattr(fault, name, None)
        if number is not None:
            return Finding(
                "faults",
                number < count,
                where,
                f"{fault.kind} of {name} {number}" + ("" if number < count else ", not there"),
                f"choose one of 0 to {count - 1}",
            )
    phantom = scenario.lab.phantom or (config.lab and config.lab.phantom)
    there = phantom is not None or not isinstance(fault, PhantomHit)
    return Finding(
        "faults",
        there,
        where,
        fault.kind + ("" if there else ", but the scenario has no phantom"),
        "give it one in lab: phantom:",
    )
