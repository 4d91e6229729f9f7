"""Tensions stay in their bounds for any wrench, pose and loss of cables, and are optimal there."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tonus.config import load
from tonus.runtime.control.compiled import rotate
from tonus.runtime.control.distribution import TensionDistribution
from tonus.runtime.control.distribution_kernels import opposition, tension_bounds
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.programme import corrected
from tonus.runtime.signals import Solver

CONFIG, _ = load("config/can.yaml")
ROBOT, CONTROL = CONFIG.robot, CONFIG.control
LENGTH = ROBOT.geometry.moment_length
SCALE = np.array([1.0, 1.0, 1.0, 1.0 / LENGTH, 1.0 / LENGTH, 1.0 / LENGTH])
T_MIN, T_MAX = CONTROL.tension.min, CONTROL.tension.max
SHARED = TensionDistribution(CONTROL.distribution, LENGTH, 8)

Array = NDArray[np.float64]

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


REFERENCE = TensionDistribution(
    CONTROL.distribution.model_copy(update={"solver": "clarabel"}), LENGTH, 8
)
befores = st.lists(st.floats(0.0, 250.0), min_size=8, max_size=8)
reaches = st.sampled_from([0.0, 4.0, 40.0, 400.0])


@settings(max_examples=300, deadline=None, derandomize=True)
@given(wrenches, places, turns, masks, befores, reaches, st.floats(-1.0, 2.0))
def test_what_daqp_finds_is_the_optimum_and_clarabel_comes_near_it(
    wrench: tuple[float, ...],
    place: tuple[float, ...],
    turn: tuple[float, ...],
    mask: list[bool],
    before: list[float],
    reach: float,
    contraction: float,
) -> None:
    """Within the bounds of a tick, some without any room, at any pose and for any cables. By the
    conditions of the programme as it is stated, in long double: what they leave over bounds the
    distance from the optimum."""
    kinematics = Kinematics(ROBOT.geometry)
    level = np.array([1.0, 0.0, 0.0, 0.0])
    kinematics.evaluate(np.array(place), rotate(level, np.array(turn)))
    asked, last, usable = np.array(wrench), np.array(before), np.array(mask)
    agonism, row, low, high, middle = np.zeros((5, 8))
    bearing = np.zeros((6, 8))
    opposition(kinematics.matrix, kinematics.lengths, asked[:3], 5.0, agonism, row)
    levels = (T_MIN, T_MAX, CONTROL.tension.pre, reach)
    tension_bounds(
        kinematics.matrix, last, usable, levels, contraction, agonism, low, high, middle, bearing
    )
    given = (bearing, asked, middle, low, high, row)
    found = SHARED(*given)
    assert SHARED.solver in (Solver.OPTIMAL, Solver.INTERIOR)
    left = _left_over(*given, found)
    size = 1.0 + np.abs(found).max() + float(np.linalg.norm(SCALE * asked))
    assert left < CONTROL.distribution.largest_error + 1e-10 * size
    reference = REFERENCE(*given)
    if REFERENCE.solver is Solver.FALLBACK:
        return
    # Half of |T - T*|^2 is the least that a distance from the optimum costs, and Clarabel stops at
    # a gap relative to the cost.
    slope = CONTROL.distribution.stiffness_weight * (row @ (found - middle)) ** 2
    cost = 0.5 * float(((found - middle) ** 2).sum() + slope)
    cost += 0.5 * CONTROL.distribution.wrench_weight * SHARED.deficit**2
    gap = CONTROL.distribution.tolerance * (1.0 + cost)
    assert np.linalg.norm(reference - found) <= math.sqrt(2.0 * gap)
    assert np.abs(reference - found).max() < 0.05


def _left_over(
    matrix: Array,
    wrench: Array,
    middle: Array,
    low: Array,
    high: Array,
    row: Array,
    tensions: Array,
) -> float:
    """Of the optimality conditions of the programme, at ``tensions``."""
    matrix, wrench, middle, row = (
        each.astype(np.longdouble) for each in (matrix, wrench, middle, row)
    )
    row = np.where(high > low, row, 0.0)
    scaled = SCALE[:, None] * matrix
    miss = scaled @ tensions - SCALE * wrench
    slope = tensions - middle + CONTROL.distribution.wrench_weight * scaled.T @ miss
    slope += CONTROL.distribution.stiffness_weight * row * (row @ (tensions - middle))
    slope = np.where(tensions <= low, np.minimum(slope, 0.0), slope)
    slope = np.where(tensions >= high, np.maximum(slope, 0.0), slope)
    return float(np.sqrt((slope**2).sum()))


def test_what_is_compiled_gives_what_python_gives() -> None:
    random = np.random.default_rng(2)
    for _ in range(200):
        rows = random.normal(size=(6, 8))
        normal, free = np.eye(8) + 1e4 * rows.T @ rows, random.uniform(-300.0, 500.0, 8)
        low = random.uniform(0.0, 50.0, 8)
        high = low + random.choice([0.0, 4.0, 100.0], 8)
        given = (normal, free, low, high, random.normal(size=8), random.normal(size=8).round())
        compiled, plain = np.empty(8), np.empty(8)
        errors = (corrected(*given, compiled), corrected.py_func(*given, plain))
        assert errors[0].hex() == errors[1].hex()
        assert compiled.tobytes() == plain.tobytes()
