"""What can be known about a configuration before anything is started.

The schema has already judged every value by itself; these rules judge values against each other,
against the buses' arithmetic and against the robot's mechanics.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from tonus.config import Config, Scenario
from tonus.config.schema.robot_faults import BrakeWeak, OfRobot, PhantomHit
from tonus.tools.check.controller import check_controller
from tonus.tools.check.data_sheets import check_data_sheets
from tonus.tools.check.finding import Finding
from tonus.tools.check.losses import check_losses
from tonus.tools.check.mechanics import mechanics, scenario_rules
from tonus.tools.check.plausibility import plausibility
from tonus.tools.check.sto_relay import check_relay
from tonus.tools.check.supervisor import check_supervisor
from tonus.tools.fieldbus.registry import fieldbus_kind

__all__ = ["Finding", "check", "check_catalogue", "check_parts"]


def check(config: Config, scenario: Scenario, *, timed: bool = False) -> list[Finding]:
    """Every rule's outcome, in a fixed order; nothing is started and nothing raises. ``timed``:
    with the measured time of a controller that is not ours, which is the host's too."""
    findings: list[Finding] = list(plausibility(config))
    if not all(finding.ok for finding in findings):
        return findings  # whatever would be computed from them would mislead
    findings += check_parts(config, scenario)
    findings += mechanics(config, scenario)
    return findings + list(check_controller(config, timed=timed))


def check_parts(config: Config, scenario: Scenario) -> Iterator[Finding]:
    """Those of `check` that are not about the robot's mechanics and the controller: quick. The
    configuration has to be plausible."""
    for bus in config.fieldbus.parts:
        yield from fieldbus_kind(bus).check(config, bus)
    yield from check_supervisor(config)
    yield from check_relay(config)
    yield from check_data_sheets(config)
    yield from check_losses(config)
    yield from _faults(config, scenario)


def check_catalogue(
    config: Config, played: Scenario, others: Iterable[Scenario]
) -> Iterator[Finding]:
    """What else an operator may choose: of each scenario what depends on it."""
    for scenario in others:
        if scenario.name == played.name:
            continue
        found = [*_faults(config, scenario)] if any(True for _ in config.fieldbus.nodes()) else []
        found += scenario_rules(config, scenario)
        failed = [each for each in found if not each.ok]
        yield from failed
        if not failed:
            text = f"{scenario.name} may be chosen"
            yield Finding("catalogue", True, "operation.scenarios", text, "leave it out")


def _faults(config: Config, scenario: Scenario) -> Iterator[Finding]:
    """A fault injected where there is nothing would never be seen."""
    nodes = {(node.channel, node.number) for node in config.fieldbus.nodes()}
    if config.relay is not None:
        nodes.add((config.relay.channel, config.relay.node_id))
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
        if number is None:
            continue
        there = number < count
        text = f"{fault.kind} of {name} {number}" + ("" if there else ", not there")
        remedy = f"choose one of 0 to {count - 1}"
        if isinstance(fault, BrakeWeak) and there:
            there = config.robot.drive_trains[number].brake is not None
            text += "" if there else ", which has no holding brake"
            remedy = "give the robot one in robot: brake:"
        return Finding("faults", there, where, text, remedy)
    phantom = scenario.lab.phantom or (config.lab and config.lab.phantom)
    there = phantom is not None or not isinstance(fault, PhantomHit)
    return Finding(
        "faults",
        there,
        where,
        fault.kind + ("" if there else ", but the scenario has no phantom"),
        "give it one in lab: phantom:",
    )
