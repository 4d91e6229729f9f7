"""Lengths from drums and tensions: what a cable's damping leaves of a changing tension."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tonus.config import load
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.referencing import Referencing

CONFIG, _ = load("config/can.yaml")
ROBOT, PERIOD = CONFIG.robot, CONFIG.control.rates.period
SLACK, LENGTH, LEVEL = 2.0, 1.1, 45.0
Array = NDArray[np.float64]


def at_rest(tension: float = LEVEL) -> Referencing:
    made = Referencing(ROBOT, CONFIG.control.sequence, Kinematics(ROBOT.geometry), SLACK, PERIOD)
    made.rest(np.full(8, LENGTH), np.zeros(8), np.full(8, tension))
    return made


def told(made: Referencing, tension: float, skipped: int = 0) -> float:
    return float(made.lengths(np.zeros(8), np.full(8, tension), skipped)[0])


def test_it_is_the_solution_of_a_spring_and_a_damper() -> None:
    """A tension that swings by 20 N at 25 Hz, against scipy's solution of c de/dt + k e = T."""
    times = np.arange(1, 200) * PERIOD
    swing = 2.0 * math.pi * 25.0

    def tension(t: float) -> float:
        return LEVEL + 20.0 * math.sin(swing * t)

    made = at_rest()
    found = np.array([told(made, tension(t)) for t in times])
    free, cable = float(made.wound[0]), ROBOT.cable
    stiffness = cable.axial_stiffness / free
    solved = solve_ivp(
        lambda t, e: (tension(t) - stiffness * e) / cable.damping,
        (0.0, times[-1]),
        [LEVEL / stiffness],
        t_eval=times,
        rtol=1e-9,
        atol=1e-12,
    )
    swung = 20.0 / stiffness
    np.testing.assert_allclose(found - free, solved.y[0], atol=0.01 * swung)
    at_once = np.array([tension(t) for t in times]) / stiffness
    assert np.abs(at_once - solved.y[0]).max() > 0.25 * swung


def test_a_tick_that_was_skipped_is_passed_over() -> None:
    """A tension that rises evenly tells the same with and without the ticks in between."""
    whole, gaps = at_rest(), at_rest()
    for tick in range(1, 10):
        length = told(whole, LEVEL + tick)
    told(gaps, LEVEL + 1)
    told(gaps, LEVEL + 6, skipped=4)
    assert told(gaps, LEVEL + 9, skipped=2) == pytest.approx(length, rel=1e-12)


def test_a_cable_that_does_not_pull_is_not_stretched() -> None:
    """Torn, it is as short as it was wound in the same tick: nothing delays that it is found."""
    made = at_rest()
    assert told(made, LEVEL) == pytest.approx(LENGTH, rel=1e-12)
    free = float(made.wound[0])
    assert told(made, 0.0) == pytest.approx(free, rel=1e-12)
    # And what it pulls with again it pulls with at once, at most.
    assert free < told(made, 10.0) <= free * (1.0 + 10.0 / ROBOT.cable.axial_stiffness)


def test_without_damping_a_tension_stretches_at_once() -> None:
    undamped, _ = load("config/can.yaml", overrides={"robot.cable.damping": 0.0})
    made = Referencing(
        undamped.robot,
        undamped.control.sequence,
        Kinematics(undamped.robot.geometry),
        SLACK,
        PERIOD,
    )
    made.rest(np.full(8, LENGTH), np.zeros(8), np.full(8, LEVEL))
    free = LENGTH / (1.0 + LEVEL / ROBOT.cable.axial_stiffness)
    assert told(made, 60.0) == pytest.approx(free * (1.0 + 60.0 / ROBOT.cable.axial_stiffness))
