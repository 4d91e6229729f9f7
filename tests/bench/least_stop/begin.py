"""Trajectories that the optimiser starts from: simple laws played on the model."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tests.bench.least_stop.grid import DELAY, UNLOADED, Grid
from tests.bench.least_stop.hold import Hold
from tests.bench.least_stop.model import BODY, LEFT, Model, rodrigues
from tests.bench.least_stop.problem import Case, Solution
from tests.bench.least_stop.push import NO_PUSH, Push
from tonus.config.schema.robot import Geometry

Array = NDArray[np.float64]
Law = Callable[[Array, Array], Array]
"""net forces N (7,) from state and tensions"""


def case_of(
    model: Model,
    geometry: Geometry,
    hold: Hold,
    torn: int,
    velocity: Array,
    push: Push = NO_PUSH,
) -> Case:
    """The instant at which cable ``torn`` breaks while the platform moves with ``velocity`` (m/s);
    the drums reel along, so that no tension changes by it."""
    left = [i for i in range(LEFT + 1) if i != torn]
    anchors, tips = np.array(geometry.frame)[left], np.array(geometry.platform)[left]
    turn = rodrigues(hold.quaternion)
    tension = hold.tension[left]
    ways = anchors - hold.position - tips @ matrix(hold.quaternion).T
    length = np.linalg.norm(ways, axis=1)
    # The inverse of the model's rounded law.
    strain = (tension - 0.25 / tension) / model.constants.axial_stiffness
    free = length / (1.0 + strain)
    reeling = free / length * np.einsum("ij,j->i", ways / length[:, None], velocity)
    state = np.concatenate([hold.position, turn, velocity, np.zeros(3 + LEFT), reeling])
    numbers = np.concatenate([anchors.ravel(), tips.ravel(), free, push.point])
    return Case(state, numbers, tension, push)


def matrix(q: Array) -> Array:
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def damping(tension: float, per_speed: float) -> Law:
    """Each drum by itself: so much tension, and so much per m/s of what it reels out."""
    return lambda x, pulls: np.maximum(0.0, tension - per_speed * x[19:26])


def standing(stiffness: float = 2.0e4, per_speed: float = 800.0) -> Law:
    """Every drum stays where it was."""
    return lambda x, pulls: pulls - stiffness * x[12:19] - per_speed * x[19:26]


def played(model: Model, case: Case, law: Law, grid: Grid = UNLOADED) -> Array:
    """A law on the model from the end of the delay on: states (nodes, 26)."""
    x, now = case.state.copy(), 0.0
    states = [x.copy()]
    limit = model.constants.driving_force
    for step, push in zip(grid.steps, case.push.means(grid.times), strict=True):
        parts = max(1, round(step / 1e-3))
        for _ in range(parts):
            pulls = np.asarray(model.tension(x, case.geometry)).ravel()
            u = case.force if now < DELAY - 1e-9 else np.clip(law(x, pulls), -limit, limit)
            x = x + _runge_kutta(model, x, u, push, case.geometry, step / parts)
            now += step / parts
        states.append(x.copy())
    return np.array(states)


def _runge_kutta(model: Model, x: Array, u: Array, push: Array, geometry: Array, h: float) -> Array:
    f = model.derivative
    k1 = f(x, u, push, geometry)
    k2 = f(x + 0.5 * h * k1, u, push, geometry)
    k3 = f(x + 0.5 * h * k2, u, push, geometry)
    k4 = f(x + h * k3, u, push, geometry)
    return np.asarray(h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)).ravel()


def still(case: Case, grid: Grid = UNLOADED) -> Array:
    """Nothing moves: a start that breaks the equations of motion."""
    states = np.tile(case.state, (len(grid.times), 1))
    states[1:, 6:12] = 0.0
    states[1:, BODY + LEFT :] = 0.0
    return states


def resampled(found: Solution, old: Grid, grid: Grid) -> Array:
    """A solution's states on the nodes of another grid (nodes, 26); where it has none of the drums
    they stand."""
    bodies = np.vstack([found.early[:, :BODY], found.late])
    early = old.times[: len(found.early)]
    columns = [np.interp(grid.times, old.times, column) for column in bodies.T]
    columns += [np.interp(grid.times, early, column) for column in found.early[:, BODY:].T]
    states = np.column_stack(columns)
    states[grid.times > early[-1], BODY + LEFT :] = 0.0
    return states
