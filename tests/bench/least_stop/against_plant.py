"""The early phase's optimal torques, played into the lab's plant with nothing fed back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.bench.least_stop.grid import UNLOADED, Grid
from tests.bench.least_stop.hold import Hold
from tests.bench.least_stop.model import BODY, LEFT
from tests.bench.least_stop.problem import Case, Solution
from tests.bench.least_stop.push import NO_PUSH
from tonus.config.schema.root import Config
from tonus.sim.plant import Plant

Array = NDArray[np.float64]
_TICK = 1_000_000
"""ns"""
_STILL = 0.005
"""m/s: a drum slower than this is taken to be at rest, where friction holds what it must"""


def currents(config: Config, net: Array, reeling: Array, tension: Array) -> Array:
    """A: what leaves ``net`` N at a cable that reels in at ``reeling`` m/s under ``tension`` N,
    after friction and gearbox."""
    robot, lab = config.robot, config.lab
    assert lab is not None
    drum, motor, gearbox = robot.drum, robot.motor, robot.gearbox
    sign = np.where(np.abs(reeling) < _STILL, 0.0, np.sign(reeling))
    rubbing = lab.plant.coulomb_friction + lab.plant.load_friction * tension
    needed = net + rubbing * sign + drum.viscous_friction / drum.radius**2 * reeling
    drives, driven = needed * sign > 0.0, needed * sign < 0.0
    share = np.where(drives, 1.0 / gearbox.efficiency, np.where(driven, gearbox.efficiency, 1.0))
    wanted = needed * share * drum.radius / (motor.torque_constant * gearbox.ratio)
    return np.asarray(np.clip(wanted, -motor.current_limit, motor.current_limit))


def speeds(
    config: Config,
    hold: Hold,
    torn: int,
    velocity: Array,
    case: Case,
    stop: Solution,
    pulls: Array,
    grid: Grid = UNLOADED,
) -> tuple[Array, Array, Array]:
    """Times s and the platform's speed m/s there, in the plant and in the optimum, from the break
    to the end of the early phase; ``pulls`` N (early intervals, 7) are the optimum's tensions."""
    assert config.lab is not None
    plant = Plant(config.robot, config.lab, seed=1, phantom=None, load=None)
    plant.place(hold.position, hold.quaternion, hold.tension)
    left = [i for i in range(LEFT + 1) if i != torn]
    reeling = case.state[BODY + LEFT :]
    plant.velocity[:] = velocity
    plant.drum_rate[left] = reeling / config.robot.drum.radius
    if np.any(velocity):
        plant.current_reference[left] = currents(config, case.force, reeling, case.force)
        plant.current[:] = plant.current_reference
    plant.cut_cable(torn)
    times, played = [0.0], [float(np.linalg.norm(velocity))]
    push, coming = case.push, case.push != NO_PUSH
    for k, step in enumerate(grid.early):
        if k > 0:
            rates = 0.5 * (stop.early[k] + stop.early[k + 1])[BODY + LEFT :]
            plant.current_reference[left] = currents(config, stop.forces[k], rates, pulls[k])
        for _ in range(round(step * 1e9 / _TICK)):
            if coming and plant.now_ns * 1e-9 >= push.begin:
                # One from before the break has risen by then.
                rise = push.rise if push.begin >= 0.0 else 0.0
                plant.defects.push(push.force, push.point, rise)
                coming = False
            plant.advance(plant.now_ns + _TICK)
            times.append(plant.now_ns * 1e-9)
            played.append(float(np.linalg.norm(plant.velocity)))
    nodes = np.concatenate([[0.0], np.cumsum(grid.early)])
    wanted = np.interp(times, nodes, np.linalg.norm(stop.early[:, 6:9], axis=1))
    return np.array(times), np.array(played), wanted
