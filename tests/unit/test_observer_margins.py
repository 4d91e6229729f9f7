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
from tonus.runtime.control.referencing import Referencing
from tonus.runtime.states import Fault
from tonus.tools.margins.estimate import EXTERNAL, PLACE, SPEED, STATES, AxisEstimator
from tonus.tools.margins.observer import observer_margins
from tonus.tools.margins.task import Loop
from tonus.tools.tune.trial import Trial, play

Array = NDArray[np.float64]
WITHOUT_MISMATCH = {
    f"control.mismatch.{key}": 0.0 for key in ("mass", "axial_stiffness", "damping")
}
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


def test_the_shipped_gains_keep_the_floors() -> None:
    found = observer_margins(CONFIG, "bio_observer")
    assert found is not None
    assert found.meet(FLOORS)


def test_it_is_the_mismatch_that_takes_the_margin() -> None:
    least = observer_margins(CONFIG, "bio_observer")
    described = observer_margins(configured(**WITHOUT_MISMATCH), "bio_observer")
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
@pytest.mark.parametrize(("drum", "tension"), [(1e-5, 0.0), (0.0, 0.1)])
def test_the_estimator_of_an_axis_is_the_estimator(axis: int, drum: float, tension: float) -> None:
    """Its answers to a step of what the drums have wound and to one of the tensions."""
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
        reference = Referencing(robot, control.sequence, kinematics, 0.0, period)
        reference.rest(lengths, np.zeros(robot.cables), tensions)
        full = PoseEstimator(robot, control.estimator, CONFIG.tracker, kinematics, period)
        full.start(home, level, tensions, 60)
        for tick in range(1000):
            told = reference.lengths(np.zeros(robot.cables), tensions)
            full.step(told, tensions, reference.elastic, usable)
            if tick > 20 and tick % 8 == 0:
                full.track(home, level, CONFIG.tracker.latency_ms * 1e-3)
        found = np.empty((ticks, 3))
        for row in found:
            pulled = tensions + along * size * tension
            told = reference.lengths(along * size * drum / robot.drum_radius, pulled)
            now = full.step(told, pulled, reference.elastic, usable)
            row[:] = now.position[axis] - home[axis], now.velocity[axis], now.external[axis]
        return found

    cable = robot.cable
    estimator = AxisEstimator(
        CONFIG, gather, cable.axial_stiffness / float(lengths.mean()), cable.damping
    )
    state, modelled = np.zeros(STATES), np.empty((ticks, 3))
    for row in modelled:
        state, row[:] = estimator.step(state, drum, tension)
    found = answers(1.0) - answers(0.0)
    for part in (PLACE, SPEED, EXTERNAL):
        largest = np.abs(found[:, part]).max()
        np.testing.assert_allclose(modelled[:, part], found[:, part], atol=0.05 * largest)


def pushed(overrides: dict[str, Any], size: float) -> Trial:
    """A load that steps to ``size`` N."""
    begun = {"control.controller": "bio_observer", **QUICK}
    config, scenario = load("config/direct.yaml", "hold", begun | overrides)
    knots = (LoadPoint(at=2.6, force=0.0), LoadPoint(at=2.601, force=size))
    push = Load(direction=(1.0, 0.0, 0.0), point=(0.0, 0.0, 0.0), profile=knots)
    script = scenario.lab.model_copy(update={"load": push})
    return play(config, scenario.model_copy(update={"duration": 1.4, "lab": script}), seed=1)


def oscillation(overrides: dict[str, Any], size: float) -> float:
    """N, of the tension references from about a second after that; infinite where a fault ends the
    run."""
    trial = pushed(overrides, size)
    if trial.fault is not Fault.NONE:
        return math.inf
    assert trial.truth["load"][-1, 0] == pytest.approx(size)
    return float(trial.cycle["tension"]["reference"][-300:].std(axis=0).max())


def test_a_light_robot_with_stiff_cables_does_not_oscillate_under_a_load() -> None:
    """Robot 1004 of the study of drawn robots: a sixth too light, cables of its own each, some
    drums with hardly any friction."""
    assert oscillation(DRAWN, 25.0) < 0.3


@pytest.mark.wide
def test_cables_of_far_more_damping_than_described_end_in_a_stop() -> None:
    """And friction holds the robot with twice as much."""
    damping, bio = "lab.plant.damping_scale", {"control.controller": "bio"}
    assert oscillation(bio | {damping: 2.0}, 25.0) < 0.3
    assert pushed(bio | {damping: 4.0}, 25.0).fault is Fault.SPEED_LIMIT


def stiff(stiffness: float) -> dict[str, Any]:
    return {"control.pd.stiffness": stiffness, "control.stiffness.maximum": stiffness}


RESTING: dict[str, Any] = {
    "control.stiffness.force_gain": 0.0,
    "control.stiffness.velocity_gain": 0.0,
}


@pytest.mark.wide
@pytest.mark.parametrize(
    ("controller", "overrides", "plant", "holds"),
    [
        ("pd", stiff(7000.0), (1.0, 1.0, 1.0), True),
        ("pd", stiff(7000.0), (1.0, 1.0, 0.0), True),
        ("pd", stiff(7000.0), (1.0, 1.0, 2.5), False),
        ("pd", stiff(5000.0), (1.0, 1.0, 2.5), False),
        ("bio_observer", RESTING, (0.8, 1.06, 1.0), True),
        ("bio_observer", RESTING, (0.8, 1.06, 0.0), True),
        ("bio_observer", RESTING, (1.0, 1.0, 3.0), False),
    ],
)
def test_the_loop_says_what_becomes_of_a_robot_without_friction(
    controller: str,
    overrides: dict[str, Any],
    plant: tuple[float, float, float],
    *,
    holds: bool,
) -> None:
    """The margins are those of a robot without any, and so is this plant, which shares no code with
    them; 10 N, one stiffness, and a mass, stiffness and damping of the cables that the estimator
    has not been told and does not learn."""
    mass, stiffness, damping = plant
    config = configured(**overrides)
    law = make_controller(controller, config.robot, config.control)
    said = [
        Loop(
            config,
            law.tension_loop,
            law.linear_laws()[0],
            axis,
            follows=law.follows_platform,
            mass=mass,
            axial_stiffness=stiffness,
            damping=damping,
        ).stable
        for axis in range(3)
    ]
    assert all(said) is holds
    other = {
        "control.controller": controller,
        "lab.plant.mass_scale": mass,
        "lab.plant.stiffness_scale": stiffness,
        "lab.plant.damping_scale": damping,
    }
    found = oscillation(overrides | WITHOUT_FRICTION | UNCALIBRATED | other, 10.0)
    assert found < 0.3 if holds else found > 3.0
