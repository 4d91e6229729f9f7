"""Whether the robot can do what is asked of it: wrenches, torques, speeds, margins."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tonus.config import Config, Scenario
from tonus.config.schema.lab import Load
from tonus.config.schema.robot import Robot, Workspace
from tonus.tools.check.feasibility import (
    TOLERANCE,
    Feasibility,
    Poses,
    against,
    cable_lengths,
    closures,
    feasibility,
    judged,
    poses,
    reserves,
    workspace_poses,
)
from tonus.tools.check.finding import Finding
from tonus.tools.check.reference import first_failure, followed
from tonus.tools.margins.tension_loop import robot_margins

Array = NDArray[np.float64]

SAMPLES = 401
"""of the reference, that a load is put on"""
_AFTER_ACTIVE_S = 0.5
"""s, so that devices that take their time to be enabled do not matter"""
_DELAY_PERIODS = 3.0
"""from a drum's mean rate to the middle of its torque"""
DIRECTIONS = np.vstack([np.eye(3), -np.eye(3)])
_FREEDOM = 6
"""degrees of a rigid body: with one cable more there is one self-stress"""


def mechanics(config: Config, scenario: Scenario) -> Iterator[Finding]:
    """The rules that need the robot's geometry and drives."""
    at = workspace_poses(config.robot.geometry, config.robot.workspace)
    yield from _workspace(config, at)
    yield _self_stress(config.robot, at)
    yield _referencing(config)
    yield from _places(config.robot)
    yield from scenario_rules(config, scenario)
    yield from _drives(config)
    yield from _drum_damping(config)
    yield from _tension_loop(config, at)


def _judged(
    config: Config, rule: str, where: str, at: Poses, outcome: Feasibility, wrenches: str
) -> Finding:
    bounds = config.control.tension
    text = f"{wrenches}: {100 * outcome.share:.1f} % of {len(at.positions)} poses, "
    place = at.describe(outcome.worst)
    if outcome.reserve >= 0.0:
        text += f"tensions stay {outcome.reserve:.1f} N inside their bounds, least at {place}"
    elif math.isinf(outcome.reserve):
        text += f"the cables leave the platform free to move at {place}"
    else:
        text += (
            f"tensions must leave {bounds.min:g} to {bounds.max:g} N by {-outcome.reserve:.1f} N "
            f"at {place} to exert {_wrench(outcome.wrench)}"
        )
    return Finding(
        rule,
        outcome.reserve >= 0.0,
        where,
        text,
        "widen control.tension, or ask for less force or a smaller space",
    )


def _workspace(config: Config, at: Poses) -> Iterator[Finding]:
    robot, limit = config.robot, config.control.envelope.contact_limit
    weight = robot.platform.mass * robot.gravity
    wrenches = against(weight, np.vstack([np.zeros(3), limit * DIRECTIONS]))
    each = reserves(at, wrenches, config.control.tension, robot.geometry.moment_length)
    for some, name in (
        (slice(1), "gravity"),
        (slice(1, None), f"gravity and {limit:g} N either way on an axis"),
    ):
        outcome = judged(each[:, some], wrenches[some])
        yield _judged(config, "workspace", "robot.workspace", at, outcome, name)


def _self_stress(robot: Robot, at: Poses) -> Finding:
    """What co-contraction acts on. Without it, a robot is what gravity makes it: no defect, but
    nobody should expect more."""
    ratio = closures(at, robot.geometry.moment_length)
    closed = ratio > TOLERANCE
    worst = int(ratio.argmin())
    text = f"least over largest tension {ratio[worst]:.2f} at least, at {at.describe(worst)}"
    if not closed.any():
        text = (
            "none: gravity is the pretension, co-contraction raises no tension, K_eq is the "
            "virtual spring's alone, and no cable can make up for a lost one"
        )
    elif not closed.all():
        text = (
            f"at {100 * closed.mean():.1f} % of {len(ratio)} poses; without it, as at "
            f"{at.describe(worst)}, gravity is the pretension"
        )
    if closed.any() and robot.cables == _FREEDOM + 1:
        text += "; none once a cable is lost, and a stop may let the platform topple (docs/stop.md)"
    return Finding("self-stress", True, "robot.geometry", text, "move the anchors further apart")


def _referencing(config: Config) -> Finding:
    """The platform must lie still in its cradle while all cables pull evenly, and before that, with
    a lower tension, while any of them are still slack."""
    robot, tension = config.robot, config.control.tension
    upward = poses(robot.geometry, np.array([robot.rest]), np.zeros((1, 3))).matrices[0, 2]
    lift = tension.referencing * float(upward.sum())
    some = tension.slack * float(upward[upward > 0.0].sum())
    weight = robot.platform.mass * robot.gravity
    return Finding(
        "referencing",
        lift < weight and some < weight,
        f"control.tension.{'referencing' if lift >= weight else 'slack'}",
        f"{tension.referencing:g} N in every cable lift with {lift:.1f} N, and {tension.slack:g} N "
        f"in the upper ones alone with {some:.1f} N, a platform of {weight:.1f} N in its cradle",
        "lower it",
    )


def _wrench(wrench: Array) -> str:
    # No zero is negative to a reader.
    parts = np.split(np.round(wrench, 1) + 0.0, 2)
    force, moment = (", ".join(f"{value:+.1f}" for value in part) for part in parts)
    return f"({force}) N, ({moment}) N m"


def _inside(positions: Array, box: Workspace) -> NDArray[np.bool_]:
    low, high = np.array([box.x, box.y, box.z]).T
    return np.asarray(np.all((positions >= low) & (positions <= high), axis=-1))


def _places(robot: Robot) -> Iterator[Finding]:
    for name, place in (("home", robot.home), ("rest", robot.rest)):
        ok = bool(_inside(np.array(place), robot.workspace))
        yield Finding(
            "places",
            ok,
            f"robot.{name}",
            f"{list(place)} m is {'inside' if ok else 'outside'} the workspace",
            "move it into robot.workspace",
        )


def scenario_rules(config: Config, scenario: Scenario) -> Iterator[Finding]:
    """The rules that judge a scenario on a robot."""
    robot = config.robot
    way = followed(scenario)
    failure = first_failure(config, way)
    yield Finding(
        "reference",
        not failure,
        f"scenario {scenario.name}: reference",
        f"{scenario.name} {failure or 'stays inside the workspace'}",
        "make the motion smaller or slower",
    )
    if scenario.lab.load is not None:
        path = np.hstack([np.array(robot.home) + way.motion[:, 0], way.turning[:, 0]])
        thinned = path[:: max(len(path) // SAMPLES, 1)]
        yield _load(config, scenario, scenario.lab.load, np.unique(thinned, axis=0))
    if config.lab is not None:
        yield from _begins(config, scenario)


def _begins(config: Config, scenario: Scenario) -> Iterator[Finding]:
    """The lab counts from the moment the drives are enabled, and a load that comes before ACTIVE
    tests nothing."""
    lab, times = scenario.lab, config.control.sequence
    if lab.load is not None:
        what, profile = "load", [(point.at, point.force) for point in lab.load.profile]
    elif lab.displacement is not None:
        what = "displacement"
        profile = [(point.at, point.distance) for point in lab.displacement.profile]
    else:
        return
    first = next((index for index, (_, value) in enumerate(profile) if value != 0.0), None)
    if first is None:
        return
    begins = profile[max(first - 1, 0)][0]
    armed = times.referencing_settle_s + times.referencing_average_s
    armed += times.pretension_s + times.lift_s + 1.0 / times.reference_slew
    yield Finding(
        "load",
        begins >= armed,
        f"scenario {scenario.name}: lab.{what}.profile",
        f"the {what} begins {begins:g} s after the drives are enabled, ACTIVE {armed:g} s after "
        "it at the earliest (control.sequence)",
        f"let it begin at {armed + _AFTER_ACTIVE_S:.1f} s or later, or shorten control.sequence",
    )


def _load(config: Config, scenario: Scenario, load: Load, path: Array) -> Finding:
    """Where the reference leads, ``path`` (n, 6), and as far to either side as the load displaces
    the platform."""
    robot, control = config.robot, config.control
    direction = np.array(load.direction) / np.linalg.norm(load.direction)
    forces = [point.force for point in load.profile]
    peak = max(forces, key=abs)
    stiffness = control.pid.stiffness if control.controller == "pid" else control.stiffness.base
    aside = abs(peak) / stiffness * direction
    positions = np.vstack([path[:, :3] + way for way in (np.zeros(3), aside, -aside)])
    at = poses(robot.geometry, positions, np.tile(path[:, 3:], (3, 1)))
    extremes = np.outer([max(forces), min(forces)], direction)
    wrenches = against(robot.platform.mass * robot.gravity, extremes)
    wrenches[:, 3:] = -np.cross(load.point, extremes)
    outcome = feasibility(at, wrenches, control.tension, robot.geometry.moment_length)
    return _judged(
        config,
        "load",
        f"scenario {scenario.name}: lab.load",
        at,
        outcome,
        f"gravity and {abs(peak):g} N, {1e3 * float(np.linalg.norm(aside)):.0f} mm about the "
        "reference",
    )


def _drives(config: Config) -> Iterator[Finding]:
    robot, control = config.robot, config.control
    currents = control.tension.max / robot.tension_per_amp
    weakest = int((currents / robot.current_limit).argmax())
    current, limit = float(currents[weakest]), float(robot.current_limit[weakest])
    yield Finding(
        "motor torque",
        current <= limit,
        "control.tension.max",
        f"{control.tension.max:g} N need {current:.2f} A of {limit:g} A{_whose(robot, weakest)}",
        "lower control.tension.max or raise robot.motor.current_limit",
    )
    speeds = robot.motor_speed / robot.gear_ratio * robot.drum_radius
    slowest = int(speeds.argmin())
    speed = float(speeds[slowest])
    yield Finding(
        "motor speed",
        speed >= control.envelope.speed_limit,
        "control.envelope.speed_limit",
        f"a cable runs at up to {speed:.3f} m/s{_whose(robot, slowest)}, the envelope admits "
        f"{control.envelope.speed_limit:g} m/s",
        "lower control.envelope.speed_limit or the gear ratio",
    )
    yield from _drive_speeds(config)
    held = [
        (axis, train.brake_torque / train.drum.radius)
        for axis, train in enumerate(robot.drive_trains)
        if train.brake_torque is not None
    ]
    if held:
        axis, force = min(held, key=lambda each: each[1])
        yield Finding(
            "brakes",
            force >= control.tension.max,
            "robot.brake.torque",
            f"a closed brake holds {force:.0f} N{_whose(robot, axis)} of {control.tension.max:g} N",
            "choose brakes that hold control.tension.max, with a margin",
        )


def _drive_speeds(config: Config) -> Iterator[Finding]:
    """A drive that holds a motor back sooner than the stop needs it weakens the stop."""
    stop, robot = config.control.stop, config.robot
    needed = max(stop.reel_in, stop.reel_out)
    for train, axes in robot.kinds_of_axes.items():
        most = train.motor.maximum_speed_rpm
        if most is not None:
            speed = most * 2.0 * np.pi / 60.0 / train.gearbox.ratio * train.drum.radius
            yield Finding(
                "motor speed",
                speed >= needed,
                "robot.motor.maximum_speed_rpm",
                f"the drive admits {speed:.3f} m/s of cable{robot.whose(axes)}, a stop reels at up "
                f"to {needed:g} m/s",
                "raise robot.motor.maximum_speed_rpm, or lower control.stop.reel_in and reel_out",
            )


def _drum_damping(config: Config) -> Iterator[Finding]:
    """A drum that a stop damps by its own rate, without a cable: the rate is the mean of a period,
    and its torque acts two periods later for one. With mass over delay or less the phase margin is
    32 deg at least."""
    robot, period = config.robot, config.control.rates.period
    lightest = int(robot.drum_mass.argmin())
    most = float(robot.drum_mass[lightest]) / (_DELAY_PERIODS * period)
    for name in ("passive_damping", "take_up_damping", "reel_damping"):
        damping = float(getattr(config.control.stop, name))
        yield Finding(
            "drum damping",
            damping < most,
            f"control.stop.{name}",
            f"{damping:g} N s/m on a drum's own rate; a delay of "
            f"{1e3 * _DELAY_PERIODS * period:g} ms admits less than {most:.0f} N s/m"
            f"{_whose(robot, lightest)}",
            f"lower control.stop.{name}, or shorten control.rates.period_us",
        )


def _tension_loop(config: Config, at: Poses) -> Iterator[Finding]:
    """Shortest, mean and longest cable; a cable's stiffness goes with one over its length. Of
    several kinds of axes the worst counts."""
    loop, robot = config.control.tension_loop, config.robot
    lengths = cable_lengths(at)
    kinds = robot_margins(config, loop, lengths)
    axes, found = min(kinds.items(), key=lambda kind: min(each.reserve(loop) for each in kind[1]))
    span = f"{lengths[0]:.2f} to {lengths[2]:.2f} m"
    floors = f"floors {loop.gain_margin_db:g} dB and {loop.phase_margin_deg:g} deg"
    text = "unstable: a pole of the closed loop lies outside the unit circle"
    if all(margin.stable for margin in found):
        gain = min(margin.least_gain_db for margin in found)
        text = f"margins {gain:.1f} dB and {min(margin.phase_deg for margin in found):.1f} deg"
    yield Finding(
        "tension loop",
        all(margin.meet(loop) for margin in found),
        "control.tension_loop",
        f"{text}{robot.whose(axes)} over cables of {span}, {floors}",
        "run tonus tune tension, or lower proportional",
    )


def _whose(robot: Robot, worst: int) -> str:
    """The axes that are as the ``worst`` one."""
    return robot.whose(robot.kinds_of_axes[robot.drive_trains[worst]])
