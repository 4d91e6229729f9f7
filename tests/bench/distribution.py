"""The tension distribution against other solvers, on the same problems: out of a load test, out of
a contact, and from poses all over the workspace with wrenches that can be met and that cannot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from timeit import default_timer

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tests.bench.measure import Figure
from tests.bench.peers import PEERS, Solve, improved_closed_form
from tonus.config import Config, load
from tonus.config.loader import load_tuning
from tonus.runtime.control.distribution import TensionDistribution
from tonus.runtime.control.distribution_kernels import opposition
from tonus.runtime.control.kinematics import Kinematics
from tonus.tools.tune.trial import play

Array = NDArray[np.float64]
RECORDED = {"load_test": 6.0, "contact": 10.0}
"""scenarios, and s of them"""
EACH = 300
"""problems from every source"""
ROUNDS = 3
"""timings of each problem; its best counts, so that an interruption is nobody's"""


@dataclass(frozen=True)
class Problem:
    """What the distribution is asked in one tick."""

    matrix: Array
    wrench: Array
    centre: Array
    low: Array
    high: Array
    gradient: Array


@dataclass
class Score:
    """How a solver did."""

    micros: Array
    gap: float
    """N: root of the objective above the least one, at the worst"""
    typical_gap: float
    beyond: float
    """N outside the bounds, at the worst"""

    def told(self) -> str:
        p99 = np.percentile(self.micros, 99)
        return (
            f"p99 {p99:.0f}, worst {self.micros.max():.0f} us; off the optimum by "
            f"{self.typical_gap:.1e}, worst {self.gap:.1e} N; beyond bounds {self.beyond:.1e} N"
        )


@njit(cache=True)  # type: ignore[misc]
def pose(
    matrix: Array,
    wrench: Array,
    centre: Array,
    gradient: Array,
    weights: tuple[float, float, float],
) -> tuple[Array, Array]:
    """P and q of the programme in `tonus.runtime.control.distribution`. ``weights``: of the wrench,
    of the row g, and what a moment is divided by."""
    weight, preference, length = weights
    scaled, target = matrix.copy(), wrench.copy()
    scaled[3:] /= length
    target[3:] /= length
    metric = np.eye(centre.shape[0]) + preference * np.outer(gradient, gradient)
    quadratic = metric + weight * (scaled.T @ scaled)
    return quadratic, -(metric @ centre + weight * (scaled.T @ target))


def distribution() -> list[Figure]:
    """A row for each solver."""
    config, _ = load("config/direct.yaml")
    problems = _problems(config)
    settings, length = config.control.distribution, config.robot.geometry.moment_length
    weights = (settings.wrench_weight, settings.stiffness_weight, length)
    posed = [pose(p.matrix, p.wrench, p.centre, p.gradient, weights) for p in problems]
    best = np.array([_least(*q, p) for q, p in zip(posed, problems, strict=True)])
    ours = TensionDistribution(settings, length, 8)
    by_clarabel = settings.model_copy(update={"solver": "clarabel"})
    reference = TensionDistribution(by_clarabel, length, 8)

    def by_ours(p: Problem, solve: TensionDistribution = ours) -> Array:
        return solve(p.matrix, p.wrench, p.centre, p.low, p.high, p.gradient)

    def by_reference(p: Problem) -> Array:
        return by_ours(p, reference)

    def by_closed_form(p: Problem) -> Array:
        return improved_closed_form(p.matrix, p.wrench, p.centre, p.low, p.high)

    mine = _score(by_ours, problems, posed, best)
    found = [by_ours(p) for p in problems]
    edge = [np.minimum(t - p.low, p.high - t).min() for t, p in zip(found, problems, strict=True)]
    active = sum(room < 1e-6 for room in edge)
    name = "tension distribution, recorded and random problems"
    note = f"{len(problems)} problems, bounds active in {active}; {mine.told()}"
    figures = [Figure(name, float(np.median(mine.micros)), "us", note=note)]
    for peer, (licence, build) in PEERS.items():
        try:
            solve = build()
        except ImportError:
            continue

        def by_peer(p: Problem, solve: Solve = solve) -> Array:
            return solve(*pose(p.matrix, p.wrench, p.centre, p.gradient, weights), p.low, p.high)

        theirs = _score(by_peer, problems, posed, best)
        figures.append(_against(name, mine, peer, theirs, licence))
    theirs = _score(by_reference, problems, posed, best)
    figures.append(_against(name, mine, "ours, Clarabel by choice", theirs, "Apache-2.0"))
    theirs = _score(by_closed_form, problems, posed, best)
    figures.append(_against(name, mine, "improved closed form", theirs, "Pott 2013, ours"))
    return figures


def _against(name: str, mine: Score, peer: str, theirs: Score, licence: str) -> Figure:
    medians = (float(np.median(score.micros)) for score in (mine, theirs))
    ours, other = medians
    return Figure(name, ours, "us", peer, other, f"{peer} ({licence}): {theirs.told()}")


def _score(
    solve: Callable[[Problem], Array],
    problems: list[Problem],
    posed: list[tuple[Array, Array]],
    best: Array,
) -> Score:
    for problem in problems[:20]:
        solve(problem)
    micros, gaps, beyond = np.full(len(problems), np.inf), np.zeros(len(problems)), 0.0
    for n, problem in enumerate(problems):
        for _ in range(ROUNDS):
            began = default_timer()
            found = solve(problem)
            micros[n] = min(micros[n], (default_timer() - began) * 1e6)
        beyond = max(beyond, float(np.maximum(problem.low - found, found - problem.high).max()))
        inside = np.clip(found, problem.low, problem.high)
        gaps[n] = max(_value(*posed[n], inside) - best[n], 0.0)
    # Half of |T - T*|^2 is the least that a distance from the optimum costs.
    off = np.sqrt(2.0 * gaps)
    return Score(micros, float(off.max()), float(np.median(off)), max(beyond, 0.0))


def _value(quadratic: Array, linear: Array, x: Array) -> float:
    return float(0.5 * x @ quadratic @ x + linear @ x)


def _least(quadratic: Array, linear: Array, problem: Problem) -> float:
    """By projected Newton steps on the active set, to rounding: independent of every solver."""
    x = np.clip(np.linalg.solve(quadratic, -linear), problem.low, problem.high)
    for _ in range(200):
        slope = quadratic @ x + linear
        low = (x <= problem.low) & (slope > 0.0)
        high = (x >= problem.high) & (slope < 0.0)
        free = ~(low | high)
        step = np.zeros(len(x))
        if free.any():
            part = np.ix_(free, free)
            step[free] = -np.linalg.solve(quadratic[part], slope[free])
        if np.abs(step).max() < 1e-11:
            break
        reach = 1.0
        for i in np.flatnonzero(step):
            side = problem.high[i] if step[i] > 0.0 else problem.low[i]
            reach = min(reach, (side - x[i]) / step[i])
        x = np.clip(x + max(reach, 0.0) * step, problem.low, problem.high)
    return _value(quadratic, linear, x)


def _problems(config: Config) -> list[Problem]:
    found = [p for name, seconds in RECORDED.items() for p in _recorded(config, name, seconds)]
    generator = np.random.default_rng(1)
    for largest in (25.0, 400.0):
        found += [_random(config, generator, largest) for _ in range(EACH)]
    return found


def _recorded(config: Config, scenario: str, duration: float) -> list[Problem]:
    """Ticks of a run, evenly, with the bounds that the rate limit leaves from the tick before."""
    overrides = dict(load_tuning().overrides)
    loaded, script = load("config/direct.yaml", scenario, overrides)
    script = script.model_copy(update={"duration": duration})
    rows = play(loaded, script, seed=1).cycle
    reach = config.control.distribution.tension_rate * config.control.rates.period
    bounds, kinematics = config.control.tension, Kinematics(config.robot.geometry)
    problems = []
    for n in np.linspace(1, len(rows) - 1, EACH).astype(int):
        row, before = rows[n], rows[n - 1]["tension"]["reference"]
        kinematics.evaluate(row["pose"]["position"], row["pose"]["quaternion"])
        low = np.clip(before - reach, bounds.min, bounds.max)
        high = np.clip(before + reach, bounds.min, bounds.max)
        centre, wrench = row["tension"]["co_contraction"], row["wrench"]["commanded"]
        problems.append(_problem(config, kinematics, wrench, centre, low, high))
    return problems


def _random(config: Config, generator: np.random.Generator, largest: float) -> Problem:
    """Anywhere in the box and as far turned as it may be, with a force up to ``largest`` N."""
    robot, bounds = config.robot, config.control.tension
    box = np.array([robot.workspace.x, robot.workspace.y, robot.workspace.z])
    turn = np.radians(robot.workspace.tilt_deg) * generator.uniform(-1.0, 1.0, 3) / 2.0
    quaternion = np.concatenate([[1.0], turn])
    kinematics = Kinematics(robot.geometry)
    kinematics.evaluate(
        generator.uniform(box[:, 0], box[:, 1]), quaternion / np.linalg.norm(quaternion)
    )
    force = generator.normal(size=3)
    force *= generator.uniform(0.0, largest) / np.linalg.norm(force)
    wrench = np.concatenate([force, generator.uniform(-2.0, 2.0, 3)])
    wrench[2] += robot.platform.mass * robot.gravity
    centre = np.full(8, generator.uniform(bounds.min, 2.0 * bounds.pre))
    low, high = np.full(8, bounds.min), np.full(8, bounds.max)
    return _problem(config, kinematics, wrench, centre, low, high)


def _problem(
    config: Config, kinematics: Kinematics, wrench: Array, centre: Array, low: Array, high: Array
) -> Problem:
    agonism, gradient = np.zeros(8), np.zeros(8)
    least = config.control.distribution.least_force
    opposition(kinematics.matrix, kinematics.lengths, wrench[:3], least, agonism, gradient)
    copies = (np.array(each) for each in (kinematics.matrix, wrench, centre, low, high))
    return Problem(*copies, gradient)
