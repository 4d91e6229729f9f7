"""A stop that begins in a campaign's episode: from truth just before the break."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.bench.least_stop.begin import matrix
from tests.bench.least_stop.loaded import Reached
from tests.bench.least_stop.model import LEFT, Constants, Model, rodrigues
from tests.bench.least_stop.problem import Case
from tests.bench.least_stop.push import NO_PUSH, Push
from tonus.config.schema.robot import Geometry
from tonus.config.schema.robot_faults import DrumFriction
from tonus.config.schema.robot_faults import Push as Load
from tonus.config.schema.root import Config
from tonus.sim.plant import Plant
from tonus.tools.campaign.allowance import TEAR
from tonus.tools.campaign.observed import Observed
from tonus.tools.campaign.strikes import NS, Strike
from tonus.tools.errors import ToolError

Array = NDArray[np.float64]
_TAUT = 1.0
"""N: a cable with less does not tell its unstretched length"""


def tear_of(run: Observed) -> Strike:
    """The run's only torn cable. Raises `ToolError` for what the model does not have."""
    tears = [strike for strike in run.strikes if strike.kind == TEAR]
    if len(tears) != 1:
        raise ToolError(f"{len(tears)} cables are torn; the model has one torn cable")
    if run.scenario.lab.load is not None or run.scenario.lab.displacement is not None:
        raise ToolError("the scenario plays the load port; the model has pushes of faults only")
    return tears[0]


def constants_of(config: Config, seed: int) -> Constants:
    """The robot's, with the platform's true mass and inertia in a lab of this ``seed``."""
    assert config.lab is not None
    true = Plant(config.robot, config.lab, seed=seed, phantom=None, load=None).parameters[0]
    x, y, z = (float(value) for value in true["inertia"])
    known = Constants.of(config.robot, config.lab)
    return replace(known, mass=float(true["mass"]), inertia=(x, y, z))


def case_in(run: Observed, model: Model, *, sound: bool = False) -> Case:
    """The break in a run; ``sound``: with every motor's full force. Raises `ToolError`."""
    tear = tear_of(run)
    (torn,) = tear.axes
    left = [i for i in range(LEFT + 1) if i != torn]
    robot, constants = run.config.robot, model.constants
    rows = run.truth[: np.searchsorted(run.truth_ns, tear.at_ns)]
    radius, last = robot.drum.radius, rows[-1]
    rates = radius * rows["drum_rate"][-2:, left]
    seconds = float(np.diff(run.truth_ns[len(rows) - 2 : len(rows)])[0]) / NS
    turning = matrix(last["quaternion"]).T @ last["angular_velocity"]
    body = (last["position"], rodrigues(last["quaternion"]), last["velocity"], turning)
    free = [_unstretched(rows, cable, constants, robot.geometry, radius) for cable in left]
    anchors, tips = np.array(robot.geometry.frame)[left], np.array(robot.geometry.platform)[left]
    push = _push(run)
    return Case(
        np.concatenate([*body, np.zeros(LEFT), rates[-1]]),
        np.concatenate([anchors.ravel(), tips.ravel(), free, push.point]),
        # What the motors leave of their torque is what accelerates the drums against the cables.
        last["tension"][left] + constants.drum_mass * np.diff(rates, axis=0)[0] / seconds,
        push,
        np.zeros(LEFT) if sound else _lost(run, tear, constants)[left],
    )


def reached(run: Observed) -> Reached:
    """From the break to the end of the run."""
    tear = tear_of(run)
    begin = int(np.searchsorted(run.truth_ns, tear.at_ns))
    speed = np.linalg.norm(run.truth["velocity"][begin:], axis=1)
    peak = int(speed.argmax())
    after = float(run.truth_ns[begin + peak] - tear.at_ns) / NS
    return Reached(float(speed[peak]), after, float(run.truth["tension"][begin:].max()))


def _lost(run: Observed, tear: Strike, constants: Constants) -> Array:
    """N (8,): what friction in a drum and a missing supply, from before the break, take of the
    motors' driving force. That the friction brakes as well is left out, as it is of sound drums."""
    lost = np.zeros(LEFT + 1)
    begin = _begin(run)
    for fault in run.scenario.lab.faults:
        if isinstance(fault, DrumFriction) and fault.at < begin and fault.duration is None:
            lost[fault.axis] += fault.force
    for strike in run.strikes:
        if strike.at_ns < tear.at_ns:
            lost[list(strike.unpowered)] = constants.driving_force
    return lost


def _begin(run: Observed) -> float:
    """s of the break on the script's clock."""
    return next(fault.at for fault in run.scenario.lab.faults if fault.kind == TEAR)


def _push(run: Observed) -> Push:
    loads = [fault for fault in run.scenario.lab.faults if isinstance(fault, Load)]
    if not loads:
        return NO_PUSH
    if len(loads) > 1:
        raise ToolError(f"{len(loads)} loads push; the model has one push")
    (load,) = loads
    return Push(load.force, load.point, load.at - _begin(run), load.rise, load.duration)


def _unstretched(
    rows: NDArray[np.void], cable: int, constants: Constants, geometry: Geometry, radius: float
) -> float:
    """m, at the last row: from the latest one in which the cable was taut, and what its drum has
    turned since then."""
    taut = np.flatnonzero(rows["tension"][:, cable] > _TAUT)
    if not taut.size:
        raise ToolError(f"cable {cable} was never taut before the break")
    row, last = rows[int(taut[-1])], rows[-1]
    turn = matrix(row["quaternion"])
    lever = turn @ np.array(geometry.platform[cable])
    way = np.array(geometry.frame[cable]) - row["position"] - lever
    length = float(np.linalg.norm(way))
    tip = row["velocity"] + np.cross(row["angular_velocity"], lever)
    rate = radius * row["drum_rate"][cable] - float(tip @ way) / length
    # The positive root of the model's damped law, then the inverse of its rounded one.
    damping, tension = constants.damping, float(row["tension"][cable])
    half = 0.5 * (tension - damping * (1.0 + rate))
    elastic = half + np.sqrt(half * half + tension * damping)
    free = length / (1.0 + (elastic - 1.0 / elastic) / constants.axial_stiffness)
    return float(free - radius * (last["drum_angle"][cable] - row["drum_angle"][cable]))
