"""Compiled writers of the cycle record's larger parts: a call each, where assigning array by array
costs three to five times as much.

They write the same named fields that `tonus.runtime.signals` lists. What a tick writes besides, it
writes through the views of `CycleRecord`.
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
    bias: Table,
    length_offset: Table,
    compliances: Table,
) -> None:
    """``estimate``: position, quaternion, velocity, angular velocity, external wrench; ``desired``:
    position, velocity, acceleration."""
    pose, wrench = record[0].pose, record[0].wrench
    for k in range(3):
        pose.position[k] = estimate[0][k]
        pose.velocity[k] = estimate[2][k]
        pose.angular_velocity[k] = estimate[3][k]
        pose.desired_position[k] = desired[0][k]
        pose.desired_velocity[k] = desired[1][k]
        pose.desired_acceleration[k] = desired[2][k]
        pose.cable_position[k] = cable_position[k]
        pose.bias[k] = bias[k]
    for k in range(4):
        pose.quaternion[k] = estimate[1][k]
        pose.desired_quaternion[k] = desired_quaternion[k]
    for k in range(6):
        wrench.external[k] = estimate[4][k]
    for k in range(length_offset.shape[0]):
        pose.length_offset[k] = length_offset[k]
    pose.compliance = mean(compliances)


@njit(cache=True)
def write_found(
    record: Table,
    iterations: int,
    disagreement: float,
    refused: int,
    learnt: int,
    residual: float,
    sigma: float,
    inconsistency: float,
    condition: float,
    consistency: int,
) -> None:
    """What distribution, tracker and estimator say of themselves, number by number; an enumeration
    as a plain integer, since its type would be another one."""
    tension, tracker, pose = record[0].tension, record[0].tracker, record[0].pose
    tension.iterations = iterations
    tracker.disagreement = disagreement
    tracker.refused = refused
    tracker.learnt = learnt
    pose.residual = residual
    pose.sigma = sigma
    pose.inconsistency = inconsistency
    pose.condition = condition
    pose.consistency = consistency


@njit(cache=True)
def write_law(
    record: Table,
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
    external: float,
    tank: float,
    rate: float,
    rise_bound: float,
) -> None:
    """The stiffness law's value and terms, the envelope's ``cap``, the limiter's ``value`` (N/m),
    to which tensions add a ``geometric`` stiffness; and the account of the energy."""
    stiffness, energy = record[0].stiffness, record[0].energy
    stiffness.law = law
    stiffness.velocity_term = velocity_term
    stiffness.force_term = force_term
    stiffness.deviation_term = deviation_term
    stiffness.cap = cap
    stiffness.k_eq = value
    stiffness.measured = value + geometric
    energy.storage = storage
    energy.storage_rate = stiffening - dissipated + external
    energy.stiffening = stiffening
    energy.dissipated = dissipated
    energy.external = external
    energy.tank = tank
    energy.k_rate = rate
    energy.rise_bound = rise_bound


@njit(cache=True)
def write_margins(
    record: Table,
    tension_high: float,
    tension_low: float,
    contact: float,
    speed: float,
    workspace: float,
    progress: float,
    grade: int,
    bound: int,
) -> None:
    """The envelope's, and what it makes of them."""
    margins = record[0].envelope
    margins.tension_high = tension_high
    margins.tension_low = tension_low
    margins.contact = contact
    margins.speed = speed
    margins.workspace = workspace
    margins.progress = progress
    margins.grade = grade
    margins.bound = bound
