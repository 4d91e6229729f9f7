"""Margins of a load observer: with the estimator in the loop, held against the estimator itself and
against runs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from loop import QUICK
from numpy.typing import NDArray

from tonus.config import load
from tonus.config.schema.lab import Load, LoadPoint
from tonus.config.schema.root import Config
from tonus.runtime.control.controllers import make_controller
from tonus.runtime.control.estimator import PoseEstimator
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.states import Fault
from tonus.tools.margins.estimate import EXTERNAL, PLACE, SPEED, AxisEstimator
from tonus.tools.margins.observer import ObserverLoop, observer_margins
from tonus.tools.margins.task import margins
from tonus.tools.tune.trial import play

Array = NDArray[np.float64]
BEFORE = {"control.bio_observer.cutoff_hz": 8.903}
"""as tuned while the margins took the estimate as exact"""
AS_DESCRIBED = {"control.mismatch.mass": 0.0, "control.mismatch.axial_stiffness": 0.0}
DRAWN: dict[str, Any] = {
    "lab.plant.stiffness_spread": 0.15,
    "lab.plant.anchor_sigma": 0.002,
    "lab.plant.mass_spread": 0.2,
    "lab.plant.friction_spread": 1.0,
    "lab.robot_seed": 1004,
}
WITHOUT_FRICTION: dict[str, Any] = {
    "lab.plant.coulomb_friction": 0.0,
    "lab.plant.load_friction": 0.0,
    "lab.plant.gearbox_losses": False,
    "control.tension_loop.friction.coulomb": 0.0,
    "control.tension_loop.friction.load": 0.0,
}
UNCALIBRATED: dict[str, Any] = {
    "control.estimator.compliance_sigma": 0.0,
    "control.estimator.compliance_spread": 0.0,
    "control.estimator.compliance_drift": 0.0,
}
"""The estimator never learns that a cable is stiffer than described, as the margins have it."""
CONFIG, _ = load("config/direct.yaml")
FLOORS = CONFIG.control.tension_loop


def configured(**overrides: Any) -> Config:
    return load("config/direct.yaml", overrides=overrides)[0]


def test_the_shipped_gains_keep_the_floors_and_those_before_did_not() -> None:
    found = observer_margins(CONFIG, "bio_observer")
    assert found is not None
    assert found.meet(FLOORS)
    before = observer_margins(configured(**BEFORE), "bio_observer")
    assert before is not None
    assert not before.stable
    # With the estimate taken as exact nothing of it shows.
    assert margins(configured(**BEFORE), "bio_observer").meet(FLOORS)


def test_it_is_the_mismatch_that_takes_the_margin() -> None:
    least = observer_margins(CONFIG, "bio_observer")
    described = observer_margins(configured(**AS_DESCRIBED), "bio_observer")
    assert least is not None
    assert described is not None
    assert described.gain_db > least.gain_db + 2.0


def test_a_controller_without_an_observer_has_none() -> None:
    assert observer_margins(CONFIG, "bio") is None
    assert observer_margins(CONFIG, "pid") is None


def test_without_the_observer_there_is_nothing_to_return() -> None:
    """Cut at the load with a low-pass of next to nothing, the gain may rise by anything."""
    found = observer_margins(
        configured(**{"control.bio_observer.cutoff_hz": 0.001}), "bio_observer"
    )
    assert found is not None
    assert found.gain_db > 60.0


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize(("place", "pull"), [(1e-5, 0.0), (0.0, 0.1)])
def test_the_estimator_of_an_axis_is_the_estimator(axis: int, place: float, pull: float) -> None:
    """Its answers to a step of the lengths and to one of the pull."""
    ticks = 60
    robot, control = CONFIG.robot, CONFIG.control
    kinematics, home = Kinematics(robot.geometry), np.array(robot.home)
    level = np.array([1.0, 0.0, 0.0, 0.0])
    kinematics.evaluate(home, level)
    lengths, along = kinematics.lengths.copy(), kinematics.matrix[axis].copy()
    gather = float(along @ along)
    weight = np.zeros(6)
    weight[2] = robot.platform.mass * robot.gravity
    even = np.full(robot.cables, control.tension.pre)
    tensions = even + np.linalg.pinv(kinematics.matrix) @ (weight - kinematics.matrix @ even)
    usable = np.ones(robot.cables, dtype=bool)

    def answers(size: float) -> Array:
        period = control.rates.period
        full = PoseEstimator(robot, control.estimator, CONFIG.tracker, kinematics, period)
        full.start(home, level, tensions, 60)
        for tick in range(1000):
            full.step(lengths, tensions, usable)
            if tick > 20 and tick % 8 == 0:
                full.track(home, level, CONFIG.tracker.latency_ms * 1e-3)
        found = np.empty((ticks, 3))
        for row in found:
            pulled = tensions + along * size * pull / gather
            now = full.step(lengths - along * size * place, pulled, usable)
            row[:] = now.position[axis] - home[axis], now.velocity[axis], now.external[axis]
        return found

    estimator, state = AxisEstimator(CONFIG, gather), np.zeros(3)
    modelled = np.empty((ticks, 3))
    for row in modelled:
        state, row[:] = estimator.step(state, place, pull)
    found = answers(1.0) - answers(0.0)
    for part in (PLACE, SPEED, EXTERNAL):
        largest = np.abs(found[:, part]).max()
        np.testing.assert_allclose(modelled[:, part], found[:, part], atol=0.05 * largest)


def oscillation(overrides: dict[str, Any], size: float) -> float:
    """N, of the tension references from about a second after a load that steps to ``size`` N;
    infinite where a fault ends the run."""
    begun = {"control.controller": "bio_observer", **QUICK}
    config, scenario = load("config/direct.yaml", "hold", begun | overrides)
    knots = (LoadPoint(at=2.6, force=0.0), LoadPoint(at=2.601, force=size))
    pushed = Load(direction=(1.0, 0.0, 0.0), point=(0.0, 0.0, 0.0), profile=knots)
    script = scenario.lab.model_copy(update={"load": pushed})
    trial = play(config, scenario.model_copy(update={"duration": 1.4, "lab": script}), seed=1)
    if trial.fault is not Fault.NONE:
        return math.inf
    assert trial.truth["load"][-1, 0] == pytest.approx(size)
    return float(trial.cycle["tension"]["reference"][-300:].std(axis=0).max())


def test_a_light_robot_with_stiff_cables_does_not_oscillate_under_a_load() -> None:
    """Robot 1004 of the study of drawn robots: a sixth too light, cables of its own each, some
    drums with hardly any friction."""
    assert oscillation(DRAWN, 25.0) < 0.3


@pytest.mark.wide
@pytest.mark.parametrize(
    ("mass", "stiffness", "cutoff", "holds"),
    [(0.8, 1.06, 6.0, True), (0.8, 1.06, 10.0, False), (1.0, 1.0, 14.0, False)],
)
def test_the_loop_says_what_becomes_of_a_robot_without_friction(
    mass: float, stiffness: float, cutoff: float, *, holds: bool
) -> None:
    """The margins are those of a robot without any, and so is this plant, which shares no code with
    them; 10 N and the resting stiffness, as in the linear loop."""
    overrides = {"control.bio_observer.cutoff_hz": cutoff, "control.stiffness.force_gain": 0.0}
    overrides |= {"control.stiffness.velocity_gain": 0.0}
    config = configured(**overrides)
    law = make_controller("bio_observer", config.robot, config.control)
    said = [
        ObserverLoop(
            config,
            law.tension_loop,
            law.linear_laws()[0],
            axis,
            mass=mass,
            axial_stiffness=stiffness,
        ).stable
        for axis in range(3)
    ]
    assert all(said) is holds
    plant = {"lab.plant.mass_scale": mass, "lab.plant.stiffness_scale": stiffness}
    found = oscillation(overrides | WITHOUT_FRICTION | UNCALIBRATED | plant, 10.0)
    assert found < 0.7 if holds else found > 3.0


@pytest.mark.wide
@pytest.mark.parametrize(("stiffness", "holds"), [(4300.0, True), (5500.0, False)])
def test_a_spring_alone_has_less_margin_than_with_an_exact_estimate(
    stiffness: float, *, holds: bool
) -> None:
    """`pd` without friction, by the estimator's loop and by runs; the margins that take the
    estimate as exact leave 10 dB (docs/control.md, "The observer's own margins")."""
    overrides = {"control.pd.stiffness": stiffness, "control.stiffness.maximum": 5500.0}
    config = configured(**overrides)
    law = make_controller("pd", config.robot, config.control)
    loops = [
        ObserverLoop(config, law.tension_loop, law.stated_laws()[0], axis) for axis in range(3)
    ]
    assert all(loop.stable for loop in loops) is holds
    assert margins(config, "pd", cut="force").gain_db > 10.0
    found = oscillation(overrides | WITHOUT_FRICTION | {"control.controller": "pd"}, 10.0)
    assert found < 0.7 if holds else found > 3.0
