"""Tensions stay in their bounds for any wrench, pose and loss of cables, and are optimal there."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tonus.config import load
from tonus.runtime.control.compiled import rotate
from tonus.runtime.control.distribution import TensionDistribution
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.signals import Solver

CONFIG, _ = load("config/can.yaml")
ROBOT, CONTROL = CONFIG.robot, CONFIG.control
LENGTH = ROBOT.geometry.moment_length
SCALE = np.array([1.0, 1.0, 1.0, 1.0 / LENGTH, 1.0 / LENGTH, 1.0 / LENGTH])
T_MIN, T_MAX = CONTROL.tension.min, CONTROL.tension.max
SHARED = TensionDistribution(CONTROL.distribution, LENGTH, 8)

forces = st.floats(-2000.0, 2000.0)
wrenches = st.tuples(*[forces] * 3, *[st.floats(-100.0, 100.0)] * 3)
places = st.tuples(*[st.floats(-0.3, 0.3)] * 3)
turns = st.tuples(*[st.floats(-0.2, 0.2)] * 3)
masks = st.lists(st.booleans(), min_size=8, max_size=8)
gradients = st.lists(st.floats(0.0, 1.5), min_size=8, max_size=8)
centres = st.lists(st.floats(0.0, 250.0), min_size=8, max_size=8)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(wrenches, places, turns, masks, centres, gradients)
def test_bounds_always_hold_and_the_optimum_conditions_with_them(
    wrench: tuple[float, ...],
    place: tuple[float, ...],
    turn: tuple[float, ...],
    mask: list[bool],
    centre: list[float],
    gradient: list[float],
) -> None:
    kinematics = Kinematics(ROBOT.geometry)
    level = np.array([1.0, 0.0, 0.0, 0.0])
    kinematics.evaluate(np.array(place), rotate(level, np.array(turn)))
    usable = np.array(mask)
    low, high = np.where(usable, T_MIN, 0.0), np.where(usable, T_MAX, 0.0)
    matrix, middle = kinematics.matrix * usable, np.where(usable, centre, 0.0)
    row = np.array(gradient)
    tensions = SHARED(matrix, np.array(wrench), middle, low, high, row)
    row = np.where(usable, row, 0.0)
    assert np.isfinite(tensions).all()
    assert (low <= tensions).all()
    assert (tensions <= high).all()
    miss = SCALE * (matrix @ tensions - wrench)
    assert abs(SHARED.deficit - np.linalg.norm(miss)) < 1e-9 * (1.0 + SHARED.deficit)
    if SHARED.solver is Solver.FALLBACK:
        return
    # Karush, Kuhn and Tucker: against a bound the slope may only point outwards, else it is zero.
    weight = CONTROL.distribution.wrench_weight
    slope = tensions - middle + weight * (SCALE[:, None] * matrix).T @ miss
    slope += CONTROL.distribution.stiffness_weight * row * (row @ (tensions - middle))
    # The solver stops at a gap relative to the cost, which the wrench's square dominates.
    asked = 50.0 + float(np.linalg.norm(SCALE * wrench))
    tolerance = weight * asked * math.sqrt(8.0 * CONTROL.distribution.tolerance)
    # Under an impossible wrench that gap leaves a bound by up to a few hundredths of a newton.
    near = 0.05
    free = (tensions > low + near) & (tensions < high - near)
    assert np.abs(slope[free]).max(initial=0.0) < tolerance
    assert (slope[usable & (tensions <= low + near)] > -tolerance).all()
    assert (slope[usable & (tensions >= high - near)] < tolerance).all()


@settings(max_examples=60, deadline=None, derandomize=True)
@given(wrenches, centres)
def test_the_fallback_keeps_the_bounds_too(wrench: tuple[float, ...], centre: list[float]) -> None:
    hurried = CONTROL.distribution.model_copy(update={"maximum_iterations": 1})
    found = TensionDistribution(hurried, LENGTH, 8)
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    low, high = np.full(8, T_MIN), np.full(8, T_MAX)
    tensions = found(kinematics.matrix, np.array(wrench), np.array(centre), low, high)
    assert found.solver in (Solver.FALLBACK, Solver.INTERIOR)
    assert (low <= tensions).all()
    assert (tensions <= high).all()
