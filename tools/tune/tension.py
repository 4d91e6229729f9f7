"""The design of the tension loop: the gains that remove friction and follow the reference fastest
among those that keep the margins' floors.

Everything comes from the linear model of `tonus.tools.margins`, with the robot's own drums, gears,
period and delays; nothing is simulated. The cost is the absolute error of the tension, added up,
after the torque of 1 N has appeared as friction at a drum and after the reference has risen by 1 N:
the integrated absolute error of a load step (Åström and Hägglund, Advanced PID Control, 2006,
section 4.2), of the worst kind of axis and the worst cable. The floors hold for the loop of every
axis by itself and for the configured controller round it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from tonus.config.schema.control import TensionLoop
from tonus.config.schema.root import Config
from tonus.config.schema.tuning import TensionDesign
from tonus.runtime.control.tension import of_axis
from tonus.tools.check.feasibility import cable_lengths, workspace_poses
from tonus.tools.margins import task
from tonus.tools.margins.task import least_margins, loops, responses_of
from tonus.tools.margins.tension_loop import FREQUENCIES, Margins, robot_margins, tension_errors

Array = NDArray[np.float64]
KEYS = ("proportional", "integral", "rate_damping", "lead")
_POINTS = 200
"""of a response while searching; the result is judged by all"""
_DIGITS = 4
"""of a gain: more would only look exact"""
_MEMBERS = 10
"""of the population, for each gain"""
_BELOW = 1.0e6
"""cost of gains below the floors, times one and their lack"""
_EDGE = 1e-3
"""of a range's logarithm: so near its end a gain is at it"""
Progress = Callable[[int, float | None], None]
"""Evaluations done, and the least cost so far."""


@dataclass(frozen=True)
class Judged:
    """One set of gains: its margins (the loop by itself; the controller round it, cut at the
    torque and at the force) and its cost in N s, infinite for an unstable loop."""

    gains: dict[str, float]
    alone: Margins
    torque: Margins
    force: Margins
    cost: float

    @property
    def margins(self) -> dict[str, Margins]:
        return {"tension loop": self.alone, "torque": self.torque, "force": self.force}

    def meets(self, floors: TensionLoop) -> bool:
        return all(margin.meet(floors) for margin in self.margins.values())


@dataclass(frozen=True)
class Design:
    before: Judged
    after: Judged
    evaluations: int
    at_the_edge: tuple[str, ...]
    """gains that the search would have liked beyond their ranges"""


class _Judge:
    def __init__(self, config: Config, settings: TensionDesign) -> None:
        self._config, self._seconds = config, settings.seconds
        self.floors = config.control.tension_loop
        robot = config.robot
        self._lengths = cable_lengths(workspace_poses(robot.geometry, robot.workspace))
        self._responses = responses_of(config, config.control.controller)

    def __call__(self, gains: dict[str, float]) -> Judged:
        loop = self.floors.model_copy(update=gains)
        alone, around = self.alone(loop), self.around(loop)
        return Judged(gains, alone, *around, self.cost(loop) if alone.stable else math.inf)

    def alone(self, loop: TensionLoop, points: int | None = None) -> Margins:
        """``points`` of the response; None: all that a check takes."""
        kinds = robot_margins(self._config, loop, self._lengths, points or FREQUENCIES)
        every = [margin for found in kinds.values() for margin in found]
        return min(every, key=lambda margin: margin.reserve(self.floors))

    def around(self, loop: TensionLoop, points: int | None = None) -> tuple[Margins, Margins]:
        control = self._config.control.model_copy(update={"tension_loop": loop})
        config = self._config.model_copy(update={"control": control})
        found = loops(config, control.controller, self._responses)
        every = points or task.FREQUENCIES
        return least_margins(found, "torque", every), least_margins(found, "force", every)

    def cost(self, loop: TensionLoop) -> float:
        """N s."""
        robot, response = self._config.robot, self._config.response
        period = self._config.control.rates.period
        errors = [
            tension_errors(
                train,
                of_axis(loop, train, robot),
                period,
                cable_length=length,
                current_loop_hz=response.current_loop_hz,
                cell_bandwidth_hz=response.force_cell_hz,
                ticks=math.ceil(self._seconds / period),
            )
            for train in robot.kinds_of_axes
            for length in (self._lengths[0], self._lengths[-1])
        ]
        return max(float(np.abs(error).sum() * period) for error in errors)


def design(config: Config, settings: TensionDesign, progress: Progress) -> Design:
    """Deterministic. Raises `NoLinearLawError` and `ControllerError` for a controller whose margins
    cannot be computed. Where nothing keeps the floors, ``after`` is what comes nearest."""
    judge = _Judge(config, settings)
    floors, inertia = judge.floors, config.robot.drum.inertia
    ranges = (settings.proportional, settings.integral, settings.damping_rate, settings.lead)
    scale = np.array([1.0, 1.0, inertia, 1.0])
    low, high = (
        np.log(np.array([getattr(each, end) for each in ranges]) * scale) for end in ("low", "high")
    )
    done, best = 0, None

    def cost(point: Array) -> float:
        nonlocal done, best
        done += 1
        loop = floors.model_copy(update=_rounded(point))
        found = _lack(judge.alone(loop, _POINTS), floors, settings.reserve)
        if found == 0.0:
            found = max(
                _lack(margin, floors, settings.reserve) for margin in judge.around(loop, _POINTS)
            )
        else:
            found += 2.0  # any loop that is fine by itself is nearer
        value = _BELOW * (1.0 + found) if found else judge.cost(loop)
        if value < _BELOW and (best is None or value < best):
            best = value
        progress(done, best)
        return value

    present = {key: float(getattr(floors, key)) for key in KEYS}
    start = np.clip(np.log(np.maximum(list(present.values()), np.exp(low))), low, high)
    size = len(KEYS) * _MEMBERS
    found = differential_evolution(
        cost,
        list(zip(low, high, strict=True)),
        x0=start,
        popsize=_MEMBERS,
        maxiter=max(settings.evaluations // size - 1, 0),
        seed=np.random.default_rng(settings.seed),
        polish=False,
        tol=1e-4,
    )
    edge = _EDGE * (high - low)
    at_edge = (found.x < low + edge) | (found.x > high - edge)
    # A lead of one is all that there is.
    limits = [key for key, at in zip(KEYS, at_edge, strict=True) if at and key != "lead"]
    return Design(judge(present), judge(_rounded(found.x)), done, tuple(limits))


def _lack(margin: Margins, floors: TensionLoop, reserve: float) -> float:
    """0 with the ``reserve``, to 1 at none at all; 2 for an unstable loop."""
    if not margin.stable:
        return 2.0
    return min(max(1.0 - margin.reserve(floors) / reserve, 0.0), 1.9)


def _rounded(point: Array) -> dict[str, float]:
    return {
        key: float(f"{value:.{_DIGITS}g}") for key, value in zip(KEYS, np.exp(point), strict=True)
    }
