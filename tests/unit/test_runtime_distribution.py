"""The tension distribution against an independent bounded least-squares solver."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from tonus.config import load
from tonus.config.schema.control import Distribution
from tonus.runtime.control.compiled import rotate
from tonus.runtime.control.distribution import TensionDistribution
from tonus.runtime.control.distribution_kernels import opposition
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.signals import Solver

CONFIG, _ = load("config/can.yaml")
SETTINGS, TENSION, ROBOT = CONFIG.control.distribution, CONFIG.control.tension, CONFIG.robot
LENGTH = ROBOT.geometry.moment_length
SCALE = np.array([1.0, 1.0, 1.0, 1.0 / LENGTH, 1.0 / LENGTH, 1.0 / LENGTH])
LOW, HIGH = np.full(8, TENSION.min), np.full(8, TENSION.max)
WEIGHT = ROBOT.platform.mass * ROBOT.gravity
Array = NDArray[np.float64]


def matrix_at(position: tuple[float, ...] = (0.0, 0.0, 0.0), tilt: float = 0.0) -> Array:
    kinematics = Kinematics(ROBOT.geometry)
    level = np.array([1.0, 0.0, 0.0, 0.0])
    kinematics.evaluate(np.array(position), rotate(level, np.array([tilt, 0.0, -tilt])))
    return kinematics.matrix


def wrench_of(x: float = 0.0, y: float = 0.0, z: float = 0.0, moment: float = 0.0) -> Array:
    return np.array([x, y, z + WEIGHT, moment, 0.0, -moment])


def reference(matrix: Array, wrench: Array, centre: Array, low: Array, high: Array) -> Array:
    """The same programme as bounded least squares, solved by an active-set method."""
    root = np.sqrt(SETTINGS.wrench_weight)
    rows = np.vstack([np.eye(8), root * SCALE[:, None] * matrix])
    right = np.concatenate([centre, root * SCALE * wrench])
    return np.asarray(lsq_linear(rows, right, (low, high), method="bvls", tol=1e-14).x)


def distribution(settings: Distribution = SETTINGS) -> TensionDistribution:
    return TensionDistribution(settings, LENGTH, 8)


CASES = {
    "home": ((0.0, 0.0, 0.0), 0.0, wrench_of(), 45.0),
    "load": ((0.0, 0.0, 0.0), 0.0, wrench_of(x=100.0), 58.0),
    "corner": ((0.24, -0.24, 0.18), 0.1, wrench_of(y=25.0, moment=1.0), 45.0),
    "at T_min": ((0.1, 0.1, 0.0), 0.0, wrench_of(z=60.0), TENSION.min),
    "too much": ((0.0, 0.0, 0.0), 0.0, wrench_of(x=900.0, z=-200.0), 45.0),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(("solver", "off"), [("daqp", 1e-6), ("clarabel", 1e-3)])
def test_it_finds_the_optimum_an_independent_solver_finds(
    case: str, solver: str, off: float
) -> None:
    position, tilt, wrench, level = CASES[case]
    matrix, centre = matrix_at(position, tilt), np.full(8, level)
    found = distribution(SETTINGS.model_copy(update={"solver": solver}))
    tensions = found(matrix, wrench, centre, LOW, HIGH)
    expected = reference(matrix, wrench, centre, LOW, HIGH)
    np.testing.assert_allclose(tensions, expected, atol=off)
    inside = bool(((expected > LOW + 1e-3) & (expected < HIGH - 1e-3)).all())
    assert found.solver is (Solver.INTERIOR if inside else Solver.OPTIMAL)
    miss = np.linalg.norm(SCALE * (matrix @ expected - wrench))
    assert found.deficit == pytest.approx(miss, abs=1e-2)


def test_what_is_feasible_is_delivered_and_what_is_not_is_reported() -> None:
    found = distribution()
    tensions = found(matrix_at(), wrench_of(x=25.0), np.full(8, 45.0), LOW, HIGH)
    np.testing.assert_allclose(matrix_at() @ tensions, wrench_of(x=25.0), atol=0.02)
    assert found.deficit < 0.02
    found(matrix_at(), wrench_of(x=900.0), np.full(8, 45.0), LOW, HIGH)
    assert found.deficit > 100.0


def test_co_contraction_raises_tension_and_leaves_the_wrench() -> None:
    found, matrix = distribution(), matrix_at()
    soft = found(matrix, wrench_of(), np.full(8, 45.0), LOW, HIGH)
    stiff = found(matrix, wrench_of(), np.full(8, 68.0), LOW, HIGH)
    assert stiff.mean() - soft.mean() > 20.0
    np.testing.assert_allclose(matrix @ stiff, matrix @ soft, atol=0.03)


def test_agonists_pull_with_the_wrench_and_antagonists_against_it() -> None:
    """To +x pull the cables anchored there, whose other halves hold against them."""
    kinematics, agonism, gradient = home()
    opposition(
        kinematics.matrix, kinematics.lengths, np.array([80.0, 0, 0]), 5.0, agonism, gradient
    )
    anchored = np.sign(np.array(ROBOT.geometry.frame)[:, 0])
    np.testing.assert_array_equal(np.sign(agonism), anchored)
    opposition(kinematics.matrix, kinematics.lengths, np.zeros(3), 5.0, agonism, gradient)
    assert not agonism.any()


def home() -> tuple[Kinematics, Array, Array]:
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    return kinematics, np.zeros(8), np.zeros(8)


@pytest.mark.parametrize("axis", range(3))
def test_the_gradient_is_that_of_the_force_of_constant_tensions(axis: int) -> None:
    """Geometric stiffness by definition: how the force of unchanging tensions grows against a
    displacement, by central difference."""
    kinematics, agonism, gradient = home()
    tensions, step = np.linspace(30.0, 70.0, 8), 1e-5
    along = np.zeros(3)
    along[axis] = 1.0
    opposition(kinematics.matrix, kinematics.lengths, 1e9 * along, 5.0, agonism, gradient)
    ahead, behind = matrix_at(tuple(step * along)), matrix_at(tuple(-step * along))
    slope = -((ahead - behind) @ tensions)[axis] / (2.0 * step)
    assert gradient @ tensions == pytest.approx(slope, rel=1e-6)


def test_the_preference_keeps_the_stiffness_along_the_wrench_and_still_delivers_it() -> None:
    kinematics, agonism, gradient = home()
    wrench, centre = wrench_of(x=80.0), np.full(8, 50.0)
    opposition(kinematics.matrix, kinematics.lengths, wrench[:3], 5.0, agonism, gradient)
    found, off = distribution(), []
    for preferred in (None, gradient):
        tensions = found(kinematics.matrix, wrench, centre, LOW, HIGH, preferred)
        np.testing.assert_allclose(kinematics.matrix @ tensions, wrench, atol=0.03)
        off.append(abs(float(gradient @ (tensions - centre))))
    assert off[1] < 0.7 * off[0]


@pytest.mark.parametrize("lost", range(8))
def test_a_lost_cable_carries_nothing_and_the_others_do_what_they_can(lost: int) -> None:
    usable = np.arange(8) != lost
    low, high = np.where(usable, LOW, 0.0), np.where(usable, HIGH, 0.0)
    found = distribution()
    centre = np.where(usable, 45.0, 0.0)
    matrix = matrix_at() * usable
    tensions = found(matrix, wrench_of(), centre, low, high)
    assert tensions[lost] == 0.0
    assert (tensions[usable] >= TENSION.min).all()
    # The seven cannot balance the weight at their lower bound; what is best is still unique.
    high[lost] = 1e-9
    np.testing.assert_allclose(
        tensions, reference(matrix, wrench_of(), centre, low, high), atol=5e-3
    )


def test_at_the_iteration_limit_the_closed_form_answers_and_says_so() -> None:
    found = distribution(SETTINGS.model_copy(update={"maximum_iterations": 1}))
    matrix, wrench, centre = matrix_at(), wrench_of(x=60.0), np.full(8, TENSION.min + 5.0)
    tensions = found(matrix, wrench, centre, LOW, HIGH)
    assert found.solver is Solver.FALLBACK
    nearest = centre + np.linalg.pinv(matrix) @ (wrench - matrix @ centre)
    assert (nearest < TENSION.min).any(), "else the programme would not have been asked"
    np.testing.assert_allclose(tensions, np.clip(nearest, LOW, HIGH), atol=1e-3)
    overload = found(matrix, wrench_of(x=900.0), centre, LOW, HIGH)
    assert (overload >= LOW).all()
    assert (overload <= HIGH).all()
    assert found.deficit > 100.0


def test_results_do_not_depend_on_what_was_solved_before() -> None:
    random = np.random.default_rng(3)
    fresh, used = distribution(), distribution()
    for _ in range(25):
        place = tuple(random.uniform(-0.2, 0.2, 3))
        usable = random.uniform(size=8) > 0.2
        high = np.where(usable, random.uniform(50.0, 200.0, 8), 0.0)
        used(
            matrix_at(place, random.uniform(-0.1, 0.1)) * usable,
            random.normal(0.0, 200.0, 6),
            random.uniform(0.0, 200.0, 8),
            np.zeros(8),
            high,
        )
    arguments = (matrix_at((0.1, 0.0, 0.0)), wrench_of(x=30.0), np.full(8, 50.0), LOW, HIGH)
    assert fresh(*arguments).tobytes() == used(*arguments).tobytes()
    assert fresh.iterations == used.iterations
