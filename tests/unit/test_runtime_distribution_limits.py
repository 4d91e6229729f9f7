"""Bounds, centre, preference and failures of the tension distribution: by hand, by NumPy, and as
bounded least squares by another solver."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from tonus.config import load
from tonus.runtime.control.compiled import rotate
from tonus.runtime.control.distribution import TensionDistribution, closed_form
from tonus.runtime.control.distribution_kernels import delivered, prepare
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.signals import Solver

CONFIG, _ = load("config/can.yaml")
SETTINGS, ROBOT = CONFIG.control.distribution, CONFIG.robot
LENGTH = ROBOT.geometry.moment_length
SCALE = np.array([1.0] * 3 + [1.0 / LENGTH] * 3)
N = ROBOT.cables
LOWEST, HIGHEST = 20.0, 200.0
LOW, HIGH = np.full(N, LOWEST), np.full(N, HIGHEST)
Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
OFF = {"daqp": SETTINGS.largest_error, "clarabel": 2e-3}
"""N from the optimum that each solver may be"""


def structure(place: tuple[float, float, float], turn: tuple[float, float, float]) -> Array:
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(np.array(place), rotate(np.array([1.0, 0.0, 0.0, 0.0]), np.array(turn)))
    return kinematics.matrix.copy()


ASKEW = structure((0.12, -0.07, 0.05), (0.06, -0.1, 0.08))
"""no two cables are alike here"""


def distribution(**changes: Any) -> TensionDistribution:
    return TensionDistribution(SETTINGS.model_copy(update=changes), LENGTH, N)


# --- bounds and centre ---------------------------------------------------------------------------


class Prepared:
    """Arrays that hold something else before they are prepared."""

    def __init__(
        self,
        matrix: Array,
        force: Array,
        before: Array,
        present: Mask,
        contraction: float = 0.5,
        least: float = 5.0,
    ) -> None:
        cables = len(before)
        self.lengths = np.linspace(1.0, 2.0, cables)
        self.agonism, self.gradient, self.low, self.high, self.centre = np.full((5, cables), 7.0)
        self.bearing = np.full((6, cables), 7.0)
        prepare(
            matrix,
            self.lengths,
            force,
            before,
            present,
            LOWEST,
            HIGHEST,
            50.0,
            contraction,
            least,
            4.0,
            self.agonism,
            self.gradient,
            self.low,
            self.high,
            self.centre,
            self.bearing,
        )


DIRECTIONS = np.array(
    [
        [0.48, 0.64, 0.6],
        [0.8, -0.6, 0.0],
        [-0.48, -0.64, -0.6],
        [0.48 * 0.856, 0.64 * 0.856, 0.6 * 0.856],
        [-0.36 * 0.48, -0.36 * 0.64, 0.0],
    ]
).T
"""(3, 5); the last two are no unit vectors: only their part along the force counts"""


def test_agonism_and_gradient_are_weighed_by_the_force() -> None:
    """Ten newtons beside five that make it smooth: 10/15 of the cosine, and of the square of the
    cosine and its mean over all directions, a third, weighted 100 to 25."""
    cosines = np.array([0.48, 0.64, 0.6]) @ DIRECTIONS
    matrix = np.vstack([DIRECTIONS, np.full((3, 5), 9.0)])
    every = np.ones(5, dtype=bool)
    got = Prepared(matrix, np.array([4.8, 6.4, 6.0]), np.full(5, 50.0), every)
    np.testing.assert_allclose(got.agonism, cosines * 10.0 / 15.0, atol=1e-15)
    share = 0.8 * cosines**2 + 0.2 / 3.0
    np.testing.assert_allclose(got.gradient, (1.0 - share) / got.lengths, rtol=1e-14)
    none = Prepared(matrix, np.zeros(3), np.full(5, 50.0), every)
    assert none.agonism.tolist() == [0.0] * 5
    np.testing.assert_allclose(none.gradient, 2.0 / 3.0 / none.lengths, rtol=1e-14)


@pytest.mark.parametrize(
    ("before", "low", "high"),
    [
        (100.0, 96.0, 104.0),
        (22.0, LOWEST, 26.0),
        (24.0, LOWEST, 28.0),
        (24.5, 20.5, 28.5),
        (197.0, 193.0, HIGHEST),
        (0.0, LOWEST, LOWEST),
        (500.0, HIGHEST, HIGHEST),
    ],
)
def test_a_reference_moves_no_further_than_it_may_and_into_the_bounds(
    before: float, low: float, high: float
) -> None:
    """Four newtons in a tick; from outside at once to the bound."""
    present = np.arange(N) != 5
    got = Prepared(ASKEW, np.zeros(3), np.full(N, before), present)
    assert got.low.tolist() == np.where(present, low, 0.0).tolist()
    assert got.high.tolist() == np.where(present, high, 0.0).tolist()


@pytest.mark.parametrize(
    ("contraction", "centres"),
    [
        (0.0, [50.0, 50.0, 50.0]),
        # Antagonists (the third) rise by 5/3 of the share, agonists by a third of it.
        (0.5, [50.0 + 25.0 / 3.0, 75.0, 50.0 + 125.0 / 3.0]),
        (-0.36, [44.0, 32.0, LOWEST]),
        (3.0, [100.0, HIGHEST, HIGHEST]),
        (4.5, [125.0, HIGHEST, HIGHEST]),
    ],
)
def test_the_centre_rises_with_the_contraction(contraction: float, centres: list[float]) -> None:
    matrix = np.vstack([DIRECTIONS[:, :3], np.zeros((3, 3))])
    force, before = np.array([4.8, 6.4, 6.0]), np.full(3, 50.0)
    for lost in (-1, 0, 1, 2):
        present = np.arange(3) != lost
        got = Prepared(matrix, force, before, present, contraction)
        np.testing.assert_allclose(got.centre, np.where(present, centres, 0.0), rtol=1e-14)


def test_a_lost_cable_bears_nothing() -> None:
    present = np.arange(N) % 3 != 1
    got = Prepared(ASKEW, np.array([1.0, 2.0, 3.0]), np.full(N, 50.0), present)
    np.testing.assert_array_equal(got.bearing, ASKEW * present)


def test_what_is_delivered_is_the_product_with_the_structure_matrix() -> None:
    reference, measured = np.linspace(30.0, 90.0, N), np.linspace(80.0, 20.0, N)
    commanded, gradient = np.arange(10.0, 16.0), np.linspace(0.1, 0.9, N)
    wrench, shortfall = np.full(6, 7.0), np.full(3, 7.0)
    geometric = delivered(ASKEW, reference, commanded, gradient, measured, wrench, shortfall)
    np.testing.assert_allclose(wrench, ASKEW @ reference, rtol=1e-12)
    np.testing.assert_allclose(shortfall, commanded[:3] - (ASKEW @ reference)[:3], rtol=1e-12)
    assert geometric == pytest.approx(gradient @ measured, rel=1e-12)


# --- the optimum ---------------------------------------------------------------------------------


def least_squares(
    matrix: Array, wrench: Array, centre: Array, low: Array, high: Array, gradient: Array
) -> Array:
    """The cables that have room, by an active-set method; the others are left out of it."""
    room = high > low
    found = np.zeros(len(centre))
    root = math.sqrt(SETTINGS.wrench_weight)
    row = math.sqrt(SETTINGS.stiffness_weight) * gradient[room]
    middle = centre[room]
    rows = np.vstack([np.eye(len(middle)), root * SCALE[:, None] * matrix[:, room], row])
    right = np.concatenate([middle, root * SCALE * wrench, [row @ middle]])
    bounds = (low[room], high[room])
    found[room] = lsq_linear(rows, right, bounds, method="bvls", tol=1e-14).x
    return found


WRENCHES = {
    "weight": [0.0, 0.0, 60.0, 0.0, 0.0, 0.0],
    "load": [70.0, -40.0, 90.0, 2.0, -3.0, 1.0],
    "little": [0.0, 0.0, 0.0, 0.1, 0.0, 0.0],
    "too much": [500.0, -300.0, 60.0, 0.0, 0.0, 0.0],
    "a moment too much": [0.0, 0.0, 60.0, 80.0, -50.0, 0.0],
}
LOST: list[tuple[int, ...]] = [(), (2,), (0, 5), (1, 2, 6), (0, 1, 2, 3, 4, 5), tuple(range(N))]


@pytest.mark.parametrize("name", WRENCHES)
@pytest.mark.parametrize("lost", LOST)
@pytest.mark.parametrize("steepness", [0.0, 0.6])
@pytest.mark.parametrize("solver", OFF)
def test_it_is_the_bounded_least_squares_of_the_cables_that_are_left(
    name: str, lost: tuple[int, ...], steepness: float, solver: str
) -> None:
    """With a preference of the stiffness too; a lost cable has a gradient and takes no part."""
    present = ~np.isin(np.arange(N), lost)
    centre = np.linspace(40.0, 70.0, N) * present
    low, high = LOW * present, np.linspace(120.0, 200.0, N) * present
    gradient, wrench = steepness * np.linspace(0.3, 1.2, N), np.array(WRENCHES[name])
    matrix = ASKEW * present
    found = distribution(solver=solver)
    tensions = found(matrix, wrench, centre, low, high, gradient)
    expected = least_squares(matrix, wrench, centre, low, high, gradient)
    np.testing.assert_allclose(tensions, expected, atol=OFF[solver])
    assert (low <= tensions).all()
    assert (tensions <= high).all()
    miss = np.linalg.norm(SCALE * (matrix @ tensions - wrench))
    assert found.deficit == pytest.approx(miss, rel=1e-9)
    inside = bool(((low < expected) & (expected < high))[present].all())
    assert found.solver is (Solver.INTERIOR if inside else Solver.OPTIMAL)
    assert (found.iterations == 0) is inside
    assert found.iterations <= SETTINGS.maximum_iterations


def test_a_lost_cable_takes_no_part_in_the_preference() -> None:
    """It has a gradient, but would have to be pulled for it: the others are the free minimiser."""
    present = np.arange(N) != 2
    matrix, centre = ASKEW * present, np.linspace(40.0, 60.0, N) * present
    wrench, low, high = matrix @ np.full(N, 50.0), 5.0 * present, HIGH * present
    found = distribution()
    tensions = found(matrix, wrench, centre, low, high, np.linspace(0.3, 1.2, N))
    assert found.solver is Solver.INTERIOR
    assert tensions[2] == 0.0
    expected = least_squares(matrix, wrench, centre, low, high, np.linspace(0.3, 1.2, N))
    np.testing.assert_allclose(tensions, expected, atol=1e-6)


def test_without_a_gradient_there_is_no_preference() -> None:
    wrench, centre = np.array(WRENCHES["load"]), np.full(N, 50.0)
    plain = distribution()(ASKEW, wrench, centre, LOW, HIGH)
    zero = distribution()(ASKEW, wrench, centre, LOW, HIGH, np.zeros(N))
    assert plain.tobytes() == zero.tobytes()


@pytest.mark.parametrize("bound", [LOWEST, HIGHEST])
def test_a_tension_at_its_bound_lies_in_it(bound: float) -> None:
    """A wrench of nothing by nothing: the centre itself is the answer, to the last bit."""
    found, centre = distribution(), np.full(N, 50.0)
    centre[3] = bound
    tensions = found(np.zeros((6, N)), np.zeros(6), centre, LOW, HIGH)
    assert tensions.tolist() == centre.tolist()
    assert (found.solver, found.iterations, found.deficit) == (Solver.INTERIOR, 0, 0.0)


@pytest.mark.parametrize("solver", OFF)
def test_without_any_room_the_bounds_are_the_answer(solver: str) -> None:
    found, only = distribution(solver=solver), np.linspace(30.0, 60.0, N)
    tensions = found(ASKEW, np.array(WRENCHES["load"]), np.full(N, 50.0), only, only)
    assert tensions.tolist() == only.tolist()


def test_a_finer_tolerance_takes_more_iterations_and_comes_closer() -> None:
    wrench, centre = np.array(WRENCHES["load"]), np.full(N, 50.0)
    expected = least_squares(ASKEW, wrench, centre, LOW, HIGH, np.zeros(N))
    taken, off = [], []
    for tolerance in (1e-1, 1e-5, 1e-10):
        found = distribution(solver="clarabel", tolerance=tolerance)
        tensions = found(ASKEW, wrench, centre, LOW, HIGH)
        assert found.solver is Solver.OPTIMAL
        taken.append(found.iterations)
        off.append(np.abs(tensions - expected).max())
    assert taken[0] < taken[1] < taken[2]
    assert off[0] > off[1] > off[2]


@pytest.mark.parametrize("solver", OFF)
def test_the_solver_says_nothing(solver: str, capfd: pytest.CaptureFixture[str]) -> None:
    found = distribution(solver=solver)
    found(ASKEW, np.array(WRENCHES["too much"]), np.full(N, 50.0), LOW, HIGH)
    assert found.solver is Solver.OPTIMAL
    assert capfd.readouterr() == ("", "")


def test_before_the_first_tick_nothing_was_solved() -> None:
    found = distribution()
    assert (found.solver, found.iterations, found.deficit) == (Solver.NONE, 0, 0.0)


# --- failures ------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("what", ["matrix", "wrench", "centre", "gradient"])
def test_without_numbers_the_centre_answers_within_its_bounds(what: str, bad: float) -> None:
    """The programme is not asked: it would be given no numbers."""
    matrix, wrench = ASKEW.copy(), np.array(WRENCHES["weight"])
    centre, gradient = np.linspace(10.0, 220.0, N), np.full(N, 0.5)
    expected = np.clip(centre, LOW, HIGH)
    given = {"matrix": matrix, "wrench": wrench, "centre": centre, "gradient": gradient}
    given[what].flat[4] = bad
    if what == "centre":
        expected[4] = HIGHEST if bad == math.inf else LOWEST
    found = distribution()
    tensions = found(matrix, wrench, centre, LOW, HIGH, gradient)
    assert tensions.tolist() == expected.tolist()
    assert (found.solver, found.iterations, found.deficit) == (Solver.FALLBACK, 0, math.inf)
    again = (ASKEW, np.array(WRENCHES["too much"]), np.full(N, 50.0), LOW, HIGH)
    assert found(*again).tobytes() == distribution()(*again).tobytes()


def test_squares_that_are_no_numbers_ask_no_programme_either() -> None:
    found, centre = distribution(), np.full(N, 50.0)
    with np.errstate(all="ignore"):
        tensions = found(ASKEW * 1e200, np.zeros(6), centre, LOW, HIGH)
    assert tensions.tolist() == centre.tolist()
    assert (found.solver, found.iterations) == (Solver.FALLBACK, 0)


def test_the_closed_form_is_the_nearest_that_balances_the_wrench() -> None:
    """By the pseudoinverse, at tensions that give a wrench by themselves."""
    centre, wrench = np.linspace(20.0, 90.0, N), np.array(WRENCHES["load"])
    assert np.linalg.norm(ASKEW @ centre) > 1.0
    nearest = centre + np.linalg.pinv(ASKEW) @ (wrench - ASKEW @ centre)
    np.testing.assert_allclose(closed_form(ASKEW, wrench, centre), nearest, atol=1e-4)


def test_the_closed_form_does_not_turn_round_where_a_matrix_has_no_rank() -> None:
    """Of a lever s a wrench w is shared as s w / (s^2 + 1e-9), which vanishes with s."""
    for lever in (0.0, 2e-5, 1e-4):
        found = closed_form(np.array([[lever, 0.0]]), np.array([3.0]), np.array([1.0, 2.0]))
        first = 1.0 + lever * (3.0 - lever) / (lever * lever + 1e-9)
        np.testing.assert_allclose(found, [first, 2.0], rtol=1e-9)
