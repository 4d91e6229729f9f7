"""Compiled writers of the cycle record: `write_tick` and `write_timing` in each tick and, while the
platform is regulated, `write_results`, where assigning array by array costs three to five times as
much.

They write the same named fields that `tonus.runtime.signals` lists. An enumeration comes as a plain
integer, since its type would be another one.
"""

from __future__ import annotations

from typing import Any

from numba import njit
from numpy.typing import NDArray

Table = NDArray[Any]
"""A structured array."""


@njit(cache=True)
def write_measured(
    record: Table,
    axes: Table,
    cells: Table,
    tracker: Table,
    rate: Table,
    tare: Table,
    filtered: Table,
) -> None:
    """What the bus and the tracker brought: the image's tables, and the drum rates (n,), tare
    (n + 1,) and low-passed forces (n + 1,) made of them."""
    drives, forces, pose = record[0].drives, record[0].force_cells, record[0].tracker
    for i in range(axes.shape[0]):
        row = axes[i]
        drives.angle[i] = row.angle
        drives.torque[i] = row.torque
        drives.rate[i] = rate[i]
        drives.sampled_ns[i] = row.sampled_ns
        drives.doubt_ns[i] = row.doubt_ns
        drives.age[i] = row.age
        drives.statusword[i] = row.statusword
        drives.error_code[i] = row.error_code
        drives.state[i] = row.state
    for i in range(cells.shape[0]):
        cell = cells[i]
        forces.raw[i] = cell.force
        forces.tare[i] = tare[i]
        forces.filtered[i] = filtered[i]
        forces.age[i] = cell.age
        forces.status[i] = cell.status
    seen: Any = tracker[()]
    for k in range(3):
        pose.position[k] = seen.position[k]
    for k in range(4):
        pose.quaternion[k] = seen.quaternion[k]
    pose.delay = seen.delay
    pose.sequence = seen.sequence
    pose.fresh = seen.fresh


@njit(cache=True)
def write_tick(
    record: Table,
    axes: Table,
    cells: Table,
    tracker: Table,
    commands: Table,
    failed: Table,
    reference: Table,
    tension: Table,
    integral: Table,
    tick: int,
    elapsed: float,
    scenario_time: float,
    inputs: int,
    fault: int,
    where: int,
    stop_mode: int,
    state: int,
    operator: int,
    select: int,
    scenario: int,
    unguarded: int,
    parameter: int,
    value: float,
    deviation_gain: float,
    velocity_gain: float,
    force_gain: float,
    solver: int,
    accepted: bool,
    rate: Table,
    tare: Table,
    filtered: Table,
) -> None:
    """What every tick has: what came in (`write_measured`), where the state machine is, and what
    the drives are told, with the tensions (n,) that it comes from."""
    write_measured(record, axes, cells, tracker, rate, tare, filtered)
    now, tuning = record[0].state, record[0].tuning
    record[0].timing.tick = tick
    now.elapsed = elapsed
    now.scenario_time = scenario_time
    now.inputs = inputs
    now.fault = fault
    now.fault_where = where
    now.stop_mode = stop_mode
    now.state = state
    now.operator = operator
    now.select = select
    now.scenario = scenario
    now.unguarded = unguarded
    tuning.parameter = parameter
    tuning.value = value
    gains = (deviation_gain, velocity_gain, force_gain)
    for k in range(3):
        tuning.gains[k] = gains[k]
    drives, tensions = record[0].drives, record[0].tension
    for i in range(commands.shape[0]):
        now.failed[i] = failed[i]
        drives.torque_command[i] = commands[i].torque
        drives.command[i] = commands[i].command
        tensions.reference[i] = reference[i]
        tensions.measured[i] = tension[i]
        tensions.integral[i] = integral[i]
    tensions.solver = solver
    record[0].tracker.accepted = accepted


@njit("float64(float64[::1])", cache=True)
def mean(values: Table) -> float:
    """Of up to fifteen values, to the bit as numpy computes it: from eight on it adds in pairs."""
    count, total = values.shape[0], 0.0
    paired = 0
    if count >= 8:
        paired = 8
        total = ((values[0] + values[1]) + (values[2] + values[3])) + (
            (values[4] + values[5]) + (values[6] + values[7])
        )
    for i in range(paired, count):
        total += values[i]
    return float(total / count)


@njit(cache=True)
def write_motion(
    record: Table,
    estimate: tuple[Table, Table, Table, Table, Table],
    desired: tuple[Table, Table, Table],
    desired_quaternion: Table,
    cable_position: Table,
    position: Table,
    constants: Table,
) -> None:
    """``estimate``: position, quaternion, velocity, angular velocity, external wrench; ``desired``:
    position, velocity, acceleration; ``position`` (3,) is of the sampling instant, as the cables'
    is; ``constants`` (2n,): each length's offset, then the excess of each cable's compliance."""
    pose, wrench = record[0].pose, record[0].wrench
    cables = constants.shape[0] // 2
    for k in range(3):
        pose.position[k] = estimate[0][k]
        pose.velocity[k] = estimate[2][k]
        pose.angular_velocity[k] = estimate[3][k]
        pose.desired_position[k] = desired[0][k]
        pose.desired_velocity[k] = desired[1][k]
        pose.desired_acceleration[k] = desired[2][k]
        pose.cable_position[k] = cable_position[k]
        pose.bias[k] = cable_position[k] - position[k]
    for k in range(4):
        pose.quaternion[k] = estimate[1][k]
        pose.desired_quaternion[k] = desired_quaternion[k]
    for k in range(6):
        wrench.external[k] = estimate[4][k]
    for k in range(cables):
        pose.length_offset[k] = constants[k]
    pose.compliance = mean(1.0 + constants[cables:])


@njit(cache=True)
def write_tensions(
    record: Table, centre: Table, agonism: Table, commanded: Table, delivered: Table
) -> None:
    """What the distribution made: ``centre`` and ``agonism`` (n,), and the wrenches (6,)."""
    tension, wrench = record[0].tension, record[0].wrench
    for i in range(centre.shape[0]):
        tension.co_contraction[i] = centre[i]
        tension.agonism[i] = agonism[i]
    for k in range(6):
        wrench.commanded[k] = commanded[k]
        wrench.delivered[k] = delivered[k]


@njit(cache=True)
def write_found(
    record: Table,
    iterations: int,
    disagreement: tuple[float, int, int],
    residual: float,
    sigma: float,
    inconsistency: float,
    condition: float,
    consistency: int,
    deficit: float,
    contact: float,
) -> None:
    """What distribution, tracker and estimator say of themselves, number by number;
    ``disagreement``: m, poses refused, and disagreements learnt; ``deficit`` and ``contact``: N."""
    tension, tracker, pose = record[0].tension, record[0].tracker, record[0].pose
    wrench = record[0].wrench
    tension.iterations = iterations
    tracker.disagreement = disagreement[0]
    tracker.refused = disagreement[1]
    tracker.learnt = disagreement[2]
    pose.residual = residual
    pose.sigma = sigma
    pose.inconsistency = inconsistency
    pose.condition = condition
    pose.consistency = consistency
    wrench.deficit = deficit
    wrench.contact = contact


@njit(cache=True)
def write_law(
    record: Table,
    law: float,
    terms: tuple[float, float, float],
    cap: float,
    value: float,
    geometric: float,
    account: tuple[float, float, float, float, float],
    tank: float,
    rise_bound: float,
) -> None:
    """The stiffness law's value and ``terms`` (velocity, force, deviation), the envelope's ``cap``,
    the limiter's ``value`` (N/m), to which tensions add a ``geometric`` stiffness; and the
    ``account`` of the energy: storage, stiffening, dissipated, external, rate of the stiffness."""
    stiffness, energy = record[0].stiffness, record[0].energy
    stiffness.law = law
    stiffness.velocity_term = terms[0]
    stiffness.force_term = terms[1]
    stiffness.deviation_term = terms[2]
    stiffness.cap = cap
    stiffness.k_eq = value
    stiffness.measured = value + geometric
    storage, stiffening, dissipated, external, rate = account
    energy.storage = storage
    energy.storage_rate = stiffening - dissipated + external
    energy.stiffening = stiffening
    energy.dissipated = dissipated
    energy.external = external
    energy.tank = tank
    energy.k_rate = rate
    energy.rise_bound = rise_bound


@njit(cache=True)
def write_timing(
    record: Table,
    due_ns: int,
    missed_own: int,
    missed_host: int,
    page_faults: int,
    switches: int,
    began: int,
    collected: int,
    computed: int,
    published: int,
    wakeup_ns: int,
    bus_ns: int,
    processor_ns: int,
    after_ns: int,
    slack_ns: int,
) -> None:
    """When the tick ran: ticks missed, page faults and context switches so far, the borders between
    the tick's stages, and lengths of time."""
    timing = record[0].timing
    timing.due_ns = due_ns
    timing.missed_own = missed_own
    timing.missed_host = missed_host
    timing.page_faults = page_faults
    timing.switches = switches
    timing.wakeup_us = wakeup_ns * 1e-3
    timing.bus_us = bus_ns * 1e-3
    timing.collect_us = (collected - began) * 1e-3
    timing.compute_us = (computed - collected) * 1e-3
    timing.publish_us = (published - computed) * 1e-3
    timing.processor_us = processor_ns * 1e-3
    timing.slack_us = slack_ns * 1e-3
    timing.after_us = after_ns * 1e-3


@njit(cache=True)
def write_margins(
    record: Table,
    margins: tuple[float, float, float, float, float],
    progress: float,
    grade: int,
    bound: int,
) -> None:
    """The envelope's ``margins`` (tension high and low, contact, speed, workspace), and what it
    makes of them."""
    envelope = record[0].envelope
    envelope.tension_high = margins[0]
    envelope.tension_low = margins[1]
    envelope.contact = margins[2]
    envelope.speed = margins[3]
    envelope.workspace = margins[4]
    envelope.progress = progress
    envelope.grade = grade
    envelope.bound = bound


@njit(cache=True)
def write_results(
    record: Table,
    desired_position: Table,
    desired_velocity: Table,
    desired_acceleration: Table,
    desired_quaternion: Table,
    iterations: int,
    distance: float,
    refused: int,
    learnt: int,
    residual: float,
    sigma: float,
    inconsistency: float,
    condition: float,
    consistency: int,
    deficit: float,
    contact: float,
    law: float,
    velocity_term: float,
    force_term: float,
    deviation_term: float,
    cap: float,
    value: float,
    geometric: float,
    storage: float,
    stiffening: float,
    dissipated: float,
    power: float,
    rate: float,
    tank: float,
    rise_bound: float,
    tension_high: float,
    tension_low: float,
    contact_margin: float,
    speed: float,
    workspace: float,
    progress: float,
    grade: int,
    bound: int,
    position: Table,
    quaternion: Table,
    velocity: Table,
    angular_velocity: Table,
    external: Table,
    cable_position: Table,
    sampled_position: Table,
    constants: Table,
    centre: Table,
    agonism: Table,
    commanded: Table,
    delivered: Table,
) -> None:
    """What is there only while the platform is regulated; single arguments, since a tuple takes
    longer to hand over."""
    estimate = (position, quaternion, velocity, angular_velocity, external)
    desired = (desired_position, desired_velocity, desired_acceleration)
    write_motion(
        record, estimate, desired, desired_quaternion, cable_position, sampled_position, constants
    )
    write_tensions(record, centre, agonism, commanded, delivered)
    write_found(
        record,
        iterations,
        (distance, refused, learnt),
        residual,
        sigma,
        inconsistency,
        condition,
        consistency,
        deficit,
        contact,
    )
    terms = (velocity_term, force_term, deviation_term)
    account = (storage, stiffening, dissipated, power, rate)
    write_law(record, law, terms, cap, value, geometric, account, tank, rise_bound)
    margins = (tension_high, tension_low, contact_margin, speed, workspace)
    write_margins(record, margins, progress, grade, bound)
