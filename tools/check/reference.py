"""Whether the robot can follow a scenario's reference: the first point at which it cannot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonus.config import Config, Scenario
from tonus.config.schema.scenario import Reference
from tonus.config.schema.trajectory import Prepared
from tonus.config.trajectories.samples import unpacked
from tonus.runtime.control.compiled import angular_velocity
from tonus.runtime.control.reference import trajectory
from tonus.tools.check.feasibility import Poses, poses, reserves

Array = NDArray[np.float64]
_STEP_S = 0.01
_IN_A_PERIOD = 20
"""points in one period of the quickest sine, at least"""
_MOST = 20001
"""points; of a longer scenario they lie further apart"""
_BALANCED = 401
"""of these are looked at for tensions, the costly part, and all that accelerate most"""
_ROUNDING = 1e-9
"""m: a reference may touch a bound"""


@dataclass(frozen=True)
class Followed:
    """A reference at ``times`` (n,): offsets from home and rotation vectors with derivatives."""

    times: Array
    motion: Array
    """(n, 3, 3): offset, velocity, acceleration"""
    turning: Array
    """(n, 3, 3): rotation vector, its rate and acceleration"""


@dataclass(frozen=True)
class _Broken:
    """A limit that is not kept, first at a point ``row``, and by ``most`` at a point ``worst``."""

    row: int
    text: str
    worst: int
    most: str


def followed(scenario: Scenario) -> Followed:
    """The reference of a scenario over its duration."""
    follow = trajectory(scenario.reference)
    step = min(_STEP_S, 1.0 / (_IN_A_PERIOD * _quickest(scenario.reference)))
    count = min(max(int(scenario.duration / step), 400) + 1, _MOST)
    times = np.linspace(0.0, scenario.duration, count)
    if isinstance(scenario.reference, Prepared) and scenario.reference.prepared is not None:
        # What is between two rows is largest at one of them or, of a short jolt, between them.
        rows = unpacked(scenario.reference.prepared)[:, 0]
        times = np.unique([*times, *rows, *(0.5 * (rows[1:] + rows[:-1]))])
        times = times[times <= scenario.duration]
    motion = np.array([follow(float(t)) for t in times])
    turning = np.array([follow.rotation(float(t)) for t in times])
    return Followed(times, motion, turning)


def _quickest(reference: Reference) -> float:
    """Hz, of the sines in it; low where there is none."""
    found = [getattr(reference, "frequency", 0.0)]
    for name in ("components", "turns"):
        found += [each.frequency for each in getattr(reference, name, ())]
    return max(1.0, *found)


def first_failure(config: Config, way: Followed) -> str:
    """The earliest point that cannot be followed, with the limit and by how much it is missed, and
    the point at which it is missed by most; of several at one time the first in the order below.
    Empty: all can."""
    points = np.array(config.robot.home) + way.motion[:, 0]
    found: list[_Broken] = [*_space(config, points, way), *_speed(config, way)]
    # Outside its limits of space and speed it is refused anyway; what lies before is looked at.
    end = min((each.row for each in found), default=len(points))
    if end:
        at = poses(config.robot.geometry, points[:end], way.turning[:end, 0])
        found += [*_cables(config, at, way), *_tensions(config, at, way)]
    if not found:
        return ""
    first = min(found, key=lambda each: each.row)
    place = "({:+.3f}, {:+.3f}, {:+.3f}) m".format(*points[first.row])
    text = f"{first.text}, first at {way.times[first.row]:.3f} s at {place}"
    if first.worst != first.row:
        text += f"; most at {way.times[first.worst]:.3f} s, by {first.most}"
    return text


def _space(config: Config, points: Array, way: Followed) -> Iterator[_Broken]:
    box = config.robot.workspace
    low, high = np.array([box.x, box.y, box.z]).T
    beyond = np.maximum(low - points, points - high)
    excess = beyond.max(axis=1)
    row = _first(excess > _ROUNDING)
    if row is not None:
        axis = int(beyond[row].argmax())
        limit = high[axis] if points[row, axis] > high[axis] else low[axis]
        yield _Broken(
            row,
            f"leaves the workspace, which ends at {'xyz'[axis]} = {limit:+.3f} m, by "
            f"{1e3 * beyond[row, axis]:.1f} mm",
            int(excess.argmax()),
            f"{1e3 * excess.max():.1f} mm",
        )
    tilt = np.degrees(np.linalg.norm(way.turning[:, 0], axis=1))
    row = _first(tilt > box.tilt_deg + _ROUNDING)
    if row is not None:
        yield _Broken(
            row,
            f"tilts by {tilt[row]:.2f} deg, {tilt[row] - box.tilt_deg:.2f} deg more than "
            f"robot.workspace.tilt_deg of {box.tilt_deg:g}",
            int(tilt.argmax()),
            f"{tilt.max() - box.tilt_deg:.2f} deg",
        )


def _speed(config: Config, way: Followed) -> Iterator[_Broken]:
    """The envelope slows the reference down from the warning on."""
    envelope = config.control.envelope
    limit = envelope.speed_limit * envelope.speed_warning
    speed = np.linalg.norm(way.motion[:, 1], axis=1)
    row = _first(speed > limit)
    if row is not None:
        yield _Broken(
            row,
            f"moves at {speed[row]:.3f} m/s, {speed[row] - limit:.3f} m/s faster than the envelope "
            f"lets pass ({limit:.3f} m/s)",
            int(speed.argmax()),
            f"{speed.max() - limit:.3f} m/s",
        )


def _cables(config: Config, at: Poses, way: Followed) -> Iterator[_Broken]:
    """What a motor's speed and torque allow a cable."""
    robot, count = config.robot, len(at.positions)
    omega = np.array([angular_velocity(r, v) for r, v in way.turning[:count, :2]])
    rates = np.abs(_along(at, way.motion[:count, 1], omega))
    limits = robot.motor_speed / robot.gear_ratio * robot.drum_radius
    beyond = rates - limits
    excess = beyond.max(axis=1)
    row = _first(excess > 0.0)
    if row is not None:
        cable = int(beyond[row].argmax())
        yield _Broken(
            row,
            f"runs cable {cable} at {rates[row, cable]:.3f} m/s, "
            f"{beyond[row, cable]:.3f} m/s faster than its motor can",
            int(excess.argmax()),
            f"{excess.max():.3f} m/s",
        )
    gains = np.abs(_along(at, way.motion[:count, 2], way.turning[:count, 2]))
    spare = robot.current_limit * robot.tension_per_amp - config.control.tension.max
    most = np.maximum(spare, 0.0) / robot.drum_mass
    beyond = gains - most
    excess = beyond.max(axis=1)
    row = _first(excess > 0.0)
    if row is not None:
        cable = int(beyond[row].argmax())
        yield _Broken(
            row,
            f"accelerates cable {cable} by {gains[row, cable]:.1f} m/s2, "
            f"{beyond[row, cable]:.1f} m/s2 more than its motor can beside control.tension.max",
            int(excess.argmax()),
            f"{excess.max():.1f} m/s2",
        )


def _along(at: Poses, linear: Array, angular: Array) -> Array:
    """(n, cables) of a motion (n, 3) and (n, 3): along each cable."""
    return np.asarray(np.einsum("nkc,nk->nc", at.matrices, np.hstack([linear, angular])))


def _tensions(config: Config, at: Poses, way: Followed) -> Iterator[_Broken]:
    """Weight and inertia have to be balanced by tensions inside their bounds."""
    robot, bounds = config.robot, config.control.tension
    linear, angular = way.motion[:, 2], way.turning[:, 2]
    count = len(at.positions)
    effort = np.linalg.norm(linear[:count], axis=1)
    chosen = np.unique([*range(0, count, -(-count // _BALANCED)), *np.argsort(-effort)[:_BALANCED]])
    wrenches = np.zeros((len(chosen), 1, 6))
    wrenches[:, 0, :3] = robot.platform.mass * linear[chosen]
    wrenches[:, 0, 2] += robot.platform.mass * robot.gravity
    wrenches[:, 0, 3:] = np.array(robot.platform.inertia) * angular[chosen]
    some = Poses(
        at.positions[chosen],
        at.rotations[chosen],
        at.lengths[chosen],
        at.matrices[chosen],
        at.arms[chosen],
    )
    reserve = reserves(some, wrenches, bounds, robot.geometry.moment_length)[:, 0]
    row = _first(reserve < 0.0)
    if row is not None:
        force = "({:+.1f}, {:+.1f}, {:+.1f}) N".format(*wrenches[row, 0, :3])
        yield _Broken(
            int(chosen[row]),
            f"needs {force}, for which tensions must leave {bounds.min:g} to {bounds.max:g} N by "
            f"{-reserve[row]:.1f} N",
            int(chosen[reserve.argmin()]),
            f"{-reserve.min():.1f} N",
        )


def _first(wrong: NDArray[np.bool_] | np.bool_) -> int | None:
    rows = np.flatnonzero(wrong)
    return int(rows[0]) if rows.size else None
