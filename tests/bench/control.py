"""What the parts of a control tick cost."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np
from filterpy.kalman import predict, update
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from tests.bench.measure import Figure, against
from tests.loop import QUICK, ClosedLoop, configured
from tonus.config import Config, load
from tonus.config.schema.control import Distribution
from tonus.runtime.control.distribution import TensionDistribution
from tonus.runtime.control.estimator import PoseEstimator
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.signals import CycleRecord
from tonus.runtime.states import State
from tonus.runtime.timing.clock import Stopwatch

Array = NDArray[np.float64]


def control() -> list[Figure]:
    """Geometry, distribution, and the whole step."""
    config, _ = load("config/can.yaml")
    kinematics = Kinematics(config.robot.geometry)
    position, quaternion = np.array([0.05, -0.03, 0.02]), np.array([1.0, 0.0, 0.0, 0.0])
    figures = [
        against(
            "lengths and structure matrix",
            lambda: kinematics.evaluate(position, quaternion),
            "the same in numpy",
            lambda: _geometry_in_numpy(kinematics, position),
            "why tonus.runtime.control.kinematics is compiled",
        )
    ]
    kinematics.evaluate(position, quaternion)
    figures += _distribution(config.control.distribution, kinematics.matrix)
    figures += _estimator(config)
    note = "of 1000 us; median of processor time, in the loop with the plant"
    loaded, active = loaded_step(), active_step()
    added = max(loaded - active, 0.0)
    return [
        *figures,
        Figure("ControlCycle.step in ACTIVE", active, "us", note=note),
        Figure("ControlCycle.step in HOLD, 240 N", loaded, "us", note="bounds in every tick"),
        Figure("what active bounds add to it", added, "us", "limit", 30.0),
    ]


def active_step(seconds: float = 3.0) -> float:
    """us of a step in a sine, where as a rule no bound is active and one tick in eight brings a
    tracker pose."""
    loop = ClosedLoop(*configured("sine_x", QUICK))
    loop.until(State.ACTIVE)
    return _step(loop, seconds)


def loaded_step(seconds: float = 3.0) -> float:
    """us of a step in HOLD under so large a push that the programme is solved in every tick."""
    loop = ClosedLoop(*configured("hold", QUICK))
    loop.until(State.HOLD)
    loop.plant.defects.push((240.0, 0.0, 0.0), rise=0.5)
    loop.run(1.0)
    loop.forget()
    step = _step(loop, seconds)
    assert loop.state is State.HOLD, loop.cycle.sequence.fault.name
    assert (loop.trace.cycle["tension"]["iterations"] > 0).all(), "bounds in every tick"
    return step


def _step(loop: ClosedLoop, seconds: float) -> float:
    step, clock, spans = loop.cycle.step, Stopwatch(running=True).processor_ns, []

    def timed(*arguments: Any) -> CycleRecord:
        began = clock()
        record = step(*arguments)
        spans.append((clock() - began) * 1e-3)
        return record

    with patch.object(loop.cycle, "step", timed):
        loop.run(seconds)
    return float(np.median(spans))


def _geometry_in_numpy(kinematics: Kinematics, position: Array) -> tuple[Array, Array]:
    arms = kinematics.platform
    ways = kinematics.frame - position - arms
    lengths = np.linalg.norm(ways, axis=1)
    units = ways / lengths[:, None]
    return lengths, np.concatenate([units.T, np.cross(arms, units).T])


def _estimator(config: Config) -> list[Figure]:
    """A tick of lengths, and a tracker pose, each against the same algebra in filterpy."""
    period = config.control.rates.period
    kinematics = Kinematics(config.robot.geometry)
    estimator = PoseEstimator(
        config.robot, config.control.estimator, config.tracker, kinematics, period
    )
    position, quaternion = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    tensions, usable = np.full(8, 45.0), np.ones(8, dtype=bool)
    estimator.start(position, quaternion, tensions, 60)
    lengths = kinematics.lengths.copy()
    covariance = estimator.covariance.copy()
    size = len(covariance)
    state = np.zeros((size, 1))
    seen, innovation = np.eye(8, size), np.zeros((8, 1))
    noise = 4e-10 * np.eye(8)

    def dense() -> None:
        _, predicted = predict(state, covariance, F=np.eye(size), Q=1e-12)
        update(state, predicted, innovation, noise, seen)

    step = partial(estimator.step, lengths, tensions, tensions, usable)
    for _ in range(100):
        step()
    return [
        against("estimator, eight lengths", step, "filterpy, dense", dense),
        against(
            "estimator, a tracker pose",
            partial(estimator.track, position, quaternion, 0.01),
            "filterpy, update alone",
            partial(update, state, covariance, innovation, noise, seen),
            "on one tick in eight",
        ),
    ]


def _distribution(settings: Distribution, matrix: Array) -> list[Figure]:
    """Without an active bound, and with some."""
    distribution = TensionDistribution(settings, 0.1, 8)
    low, high = np.full(8, 20.25), np.full(8, 200.0)
    scale = np.array([1.0] * 3 + [10.0] * 3)
    root = np.sqrt(settings.wrench_weight)
    system = np.vstack([np.eye(8), root * matrix * scale[:, None]])
    figures = []
    for name, force, level in (("no bound active", -60.0, 45.0), ("bounds active", -90.0, 25.0)):
        wrench, centre = np.array([force, 10.0, 23.0, 0.1, 0.2, 0.0]), np.full(8, level)
        target = np.concatenate([centre, root * wrench * scale])
        ours = partial(distribution, matrix, wrench, centre, low, high)
        theirs = partial(lsq_linear, system, target, (low, high), method="bvls")
        figure = against(f"tension distribution, {name}", ours, "scipy lsq_linear", theirs)
        note = f"{distribution.solver.name}, {distribution.iterations} iterations"
        figures.append(replace(figure, note=note))
    return figures
