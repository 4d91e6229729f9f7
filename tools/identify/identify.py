"""Everything that a set of logs says about one robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tonus.runtime.states import State
from tonus.tools.errors import ToolError
from tonus.tools.identify.cables import identify_cables
from tonus.tools.identify.damping import has_null_space, identify_damping
from tonus.tools.identify.drums import Drum, identify_drums
from tonus.tools.identify.estimate import Estimate, Fit
from tonus.tools.identify.record import Record, read
from tonus.tools.identify.response import (
    Response,
    estimates,
    loop_response,
    moves,
    platform_response,
    weight,
    yields,
)
from tonus.tools.identify.truth import true_values, truth_of


@dataclass(frozen=True)
class Identification:
    """What was found, what it was found from, and what could not be."""

    logs: tuple[Path, ...]
    estimates: tuple[Estimate, ...]
    responses: tuple[Response, ...]
    drums: tuple[tuple[Drum, Fit], ...]
    notes: tuple[str, ...]


def identify(
    paths: Sequence[Path], *, truth: bool = False, anchor_sigma: float = 0.0
) -> Identification:
    """Identify one robot from its logs; ``truth`` puts what a lab's robot really is beside it.
    The configured anchors are right within ``anchor_sigma`` (m), each coordinate.

    Raises ToolError when a log cannot be used or nothing moves in any.
    """
    records = [read(path) for path in paths]
    for record in records:
        if not record.during(State.ACTIVE).any():
            raise ToolError(
                f"{record.path}: in ACTIVE no tick has fresh samples of all devices and all cables "
                "taut; give a log of a run without a fault"
            )
    for record in records[1:]:
        if record.config.robot != records[0].config.robot:
            raise ToolError(
                f"{record.path}: another robot than in {records[0].path}; identify them one by one"
            )
    moving, yielding = [r for r in records if moves(r)], [r for r in records if yields(r)]
    if not moving and not yielding:
        raise ToolError(
            f"{records[0].path}: the platform does not move in ACTIVE; "
            "record the scenarios identify_motion and identify_load"
        )
    found: list[Estimate] = []
    responses: list[Response] = []
    notes: list[str] = []
    mass = _platform(moving, anchor_sigma, found, responses, notes)
    cables = identify_cables(records, anchor_sigma)
    if not cables:
        notes.append("EA: the tensions hardly change; give a log that includes the bring-up")
    damping = identify_damping(records, cables)
    if not has_null_space(records[0]):
        notes.append("damping of the cables: only more than six cables show it")
    elif not damping:
        notes.append(
            "damping of the cables: their tensions against each other hardly change; "
            "record identify_load"
        )
    estimated, drums = identify_drums(records)
    if not drums:
        notes.append("drums: no drum turned long enough both ways; record identify_motion")
    found += cables + damping + estimated
    _loop(yielding, mass, found, responses, notes)
    if truth:
        known = true_values(records, moving, yielding)
        found = [replace(each, truth=truth_of(known, each.name, each.axes)) for each in found]
    return Identification(tuple(paths), tuple(found), tuple(responses), tuple(drums), tuple(notes))


def _platform(
    moving: list[Record],
    anchor_sigma: float,
    found: list[Estimate],
    responses: list[Response],
    notes: list[str],
) -> float | None:
    """Adds what the moving records say of the platform; returns its mass by inertia (kg)."""
    if not moving:
        notes.append("platform: the reference is constant in every log; record identify_motion")
        return None
    configured = moving[0].config.robot.platform.mass
    carried = weight(moving, anchor_sigma)
    found.append(
        Estimate("platform_mass", "platform mass, from weight", "kg", *carried, configured)
    )
    response = platform_response(moving)
    if response is None:
        notes.append("M, C and K cannot be separated: the log is too short, or has one frequency")
        return carried[0]
    responses.append(response)
    found += estimates(response, (configured, None, None))
    inertial, width = response.fit.value[0], response.fit.half_width[0]
    if abs(carried[0] - inertial) > math.hypot(carried[1], width):
        notes.append(
            "the two masses disagree: anchors, pulleys or tare are not as configured, or something "
            "holds the platform"
        )
    return float(response.fit.value[0])


def _loop(
    yielding: list[Record],
    mass: float | None,
    found: list[Estimate],
    responses: list[Response],
    notes: list[str],
) -> None:
    """Adds what a load feels."""
    if not yielding:
        notes.append("closed loop: no log with a standing reference and a load; add identify_load")
        return
    config = yielding[0].config
    moved = config.robot.platform.mass if mass is None else mass
    response = loop_response(yielding, moved)
    if response is None:
        notes.append("closed loop: the load's frequencies do not separate M, C and K")
        return
    responses.append(response)
    stiffness = float(
        sum(record.stiffness[record.state == State.ACTIVE].mean() for record in yielding)
        / len(yielding)
    )
    ratio = config.control.impedance.damping_ratio
    damping = 2.0 * ratio * math.sqrt(stiffness * config.robot.platform.mass)
    found += estimates(response, (None, damping, stiffness))
