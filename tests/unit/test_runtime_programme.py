"""The solvers of the tension programme: what DAQP answers is proven, and where it is not, Clarabel
is asked, and the log says so."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tonus.config import load
from tonus.runtime.control import programme
from tonus.runtime.control.distribution import TensionDistribution
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.programme import ActiveSet, InteriorPoint, corrected
from tonus.runtime.signals import Solver

CONFIG, _ = load("config/can.yaml")
SETTINGS, ROBOT = CONFIG.control.distribution, CONFIG.robot
N, LENGTH = ROBOT.cables, ROBOT.geometry.moment_length
LOW, HIGH, CENTRE = np.full(N, 20.0), np.full(N, 200.0), np.full(N, 50.0)
OVERLOAD = np.array([500.0, -300.0, 60.0, 0.0, 0.0, 0.0])
Array = NDArray[np.float64]


def structure() -> Array:
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(np.array([0.12, -0.07, 0.05]), np.array([1.0, 0.0, 0.0, 0.0]))
    return kinematics.matrix.copy()


MATRIX = structure()
SCALED = MATRIX / np.array([1.0] * 3 + [LENGTH] * 3)[:, None]
NORMAL = np.eye(N) + SETTINGS.wrench_weight * SCALED.T @ SCALED
FREE = np.linspace(-60.0, 300.0, N)
"""beyond both bounds"""


def distribution(**changes: Any) -> TensionDistribution:
    return TensionDistribution(SETTINGS.model_copy(update=changes), LENGTH, N)


def best(normal: Array, free: Array, low: Array, high: Array) -> Array:
    """Every choice of bounds that are met is tried: the one that meets all conditions."""
    count = len(free)
    for choice in np.ndindex(*[3] * count):
        side = np.array(choice)
        tensions = np.where(side == 1, low, high).astype(float)
        inner = side == 0
        given = normal[np.ix_(inner, ~inner)] @ (tensions - free)[~inner]
        tensions[inner] = free[inner] - np.linalg.solve(normal[np.ix_(inner, inner)], given)
        slope = normal @ (tensions - free)
        if (
            ((low <= tensions) & (tensions <= high))[inner].all()
            and (slope[(side == 1) & (high > low)] >= 0.0).all()
            and (slope[(side == 2) & (high > low)] <= 0.0).all()
        ):
            return tensions
    raise AssertionError


def test_the_shipped_solver_is_daqp_and_a_log_that_names_none_was_made_by_clarabel() -> None:
    assert SETTINGS.solver == "daqp"
    named = SETTINGS.model_dump()
    del named["solver"]
    assert type(SETTINGS).model_validate(named).solver == "clarabel"


@pytest.mark.parametrize("room", [0.0, 30.0])
def test_both_find_the_tensions_that_meet_every_condition(room: float) -> None:
    """Six unknowns, so that each of the 729 choices can be tried; one has no room, or some."""
    normal, free = NORMAL[:6, :6].copy(), FREE[:6].copy()
    low, high = LOW[:6].copy(), HIGH[:6].copy()
    low[2], high[2] = 40.0, 40.0 + room
    expected = best(normal, free, low, high)
    found, taken = ActiveSet(SETTINGS, 6)(normal, free, low, high)
    assert found is not None
    np.testing.assert_allclose(found, expected, atol=SETTINGS.largest_error)
    assert 0 < taken < 10
    found, taken = InteriorPoint(SETTINGS, 6)(normal, free, low, high)
    assert found is not None
    np.testing.assert_allclose(found, expected, atol=2e-3)
    assert 0 < taken <= SETTINGS.maximum_iterations


def test_a_tension_at_its_bound_is_the_bound_to_the_last_bit() -> None:
    found, _ = ActiveSet(SETTINGS, N)(NORMAL, FREE, LOW, HIGH)
    assert found is not None
    assert LOW[0] in found.tolist()
    assert HIGH[0] in found.tolist()


@pytest.mark.parametrize("solver", [ActiveSet, InteriorPoint])
def test_what_is_given_is_left_alone_and_nothing_is_remembered(
    solver: type[ActiveSet | InteriorPoint],
) -> None:
    normal, free, low, high = (each.copy() for each in (NORMAL, FREE, LOW, HIGH))
    used, fresh = solver(SETTINGS, N), solver(SETTINGS, N)
    random = np.random.default_rng(5)
    for _ in range(30):
        used(normal, random.uniform(-500.0, 500.0, N), low, high)
    again, first = used(normal, free, low, high), fresh(normal, free, low, high)
    assert again[0] is not None
    assert first[0] is not None
    assert (again[0].tobytes(), again[1]) == (first[0].tobytes(), first[1])
    for given, kept in ((normal, NORMAL), (free, FREE), (low, LOW), (high, HIGH)):
        assert given.tobytes() == kept.tobytes()


# --- the proof -----------------------------------------------------------------------------------

PLAIN = np.array([[2.0, 1.0], [1.0, 3.0]])


@pytest.mark.parametrize(
    ("free", "correction", "multipliers", "tensions", "error"),
    [
        # Within its bounds the whole slope H x is left over.
        ([5.0, 5.0], [0.0, 0.0], [0.0, 0.0], [5.0, 5.0], 0.0),
        ([5.0, 5.0], [1.0, 0.0], [0.0, 0.0], [6.0, 5.0], math.hypot(2.0, 1.0)),
        ([5.0, 5.0], [0.5, -1.0], [0.0, 0.0], [5.5, 4.0], math.hypot(0.0, -2.5)),
        # Beyond a bound it is put there, and only a slope inwards counts: here it is outwards.
        ([12.0, 5.0], [-2.5, 1.0], [1e-9, 0.0], [10.0, 6.0], math.hypot(0.0, 1.0)),
        ([12.0, 5.0], [-1.0, 0.0], [0.0, 0.0], [10.0, 5.0], math.hypot(0.0, -2.0)),
        ([-2.0, 5.0], [2.5, -1.0], [-1e-9, 0.0], [0.0, 4.0], math.hypot(0.0, -1.0)),
        ([-2.0, 5.0], [1.0, 0.0], [0.0, 0.0], [0.0, 5.0], math.hypot(0.0, 2.0)),
        # At the wrong bound it points inwards.
        ([5.0, 5.0], [5.0, 0.0], [1.0, 0.0], [10.0, 5.0], math.hypot(10.0, 5.0)),
        ([5.0, 5.0], [-5.0, 0.0], [-1.0, 0.0], [0.0, 5.0], math.hypot(10.0, 5.0)),
    ],
)
def test_what_is_left_of_the_conditions_is_how_far_the_optimum_can_be(
    free: list[float],
    correction: list[float],
    multipliers: list[float],
    tensions: list[float],
    error: float,
) -> None:
    found, low, high = np.full(2, 7.0), np.zeros(2), np.full(2, 10.0)
    given = (np.array(each) for each in (correction, multipliers))
    got = corrected(PLAIN, np.array(free), low, high, *given, found)
    assert found.tolist() == tensions
    assert got == pytest.approx(error, abs=1e-12)


def test_a_cable_without_room_is_at_its_optimum_whatever_the_slope() -> None:
    found, low, high = np.full(2, 7.0), np.array([3.0, 0.0]), np.array([3.0, 10.0])
    for free in ([12.0, 5.0], [-12.0, 5.0]):
        inward = -(3.0 - free[0]) / 3.0
        got = corrected(
            PLAIN, np.array(free), low, high, np.array([0.0, inward]), np.zeros(2), found
        )
        assert found.tolist() == pytest.approx([3.0, 5.0 + inward])
        assert got == pytest.approx(0.0, abs=1e-12)


def test_the_optimum_is_never_further_than_that() -> None:
    random = np.random.default_rng(11)
    low, high = LOW[:4], HIGH[:4]
    for _ in range(60):
        rows = random.normal(size=(3, 4))
        normal, free = np.eye(4) + 50.0 * rows.T @ rows, random.uniform(-200.0, 400.0, 4)
        optimum, found = best(normal, free, low, high), np.empty(4)
        wrong = optimum - free + random.normal(scale=random.choice([0.0, 1e-3, 5.0]), size=4)
        error = corrected(normal, free, low, high, wrong, np.zeros(4), found)
        assert np.linalg.norm(found - optimum) <= error + 1e-9


@pytest.mark.parametrize("where", [0, 5])
def test_what_is_no_number_is_proven_nothing_of(where: int) -> None:
    """`ActiveSet` asks whether the error is small, not whether it is large."""
    found, free = np.empty(N), FREE.copy()
    free[where] = math.nan
    error = corrected(NORMAL, free, LOW, HIGH, np.zeros(N), np.zeros(N), found)
    assert not error <= 1e300


# --- failures ------------------------------------------------------------------------------------


def answering(
    monkeypatch: pytest.MonkeyPatch, correction: Array, flag: int, multipliers: Array | None = None
) -> None:
    """DAQP from now on answers this."""
    told = {"iterations": 3, "lam": np.zeros(N) if multipliers is None else multipliers}

    def solve(*_: Any, **__: Any) -> tuple[Array, float, int, dict[str, Any]]:
        return correction, 0.0, flag, told

    monkeypatch.setattr(programme.daqp, "solve", solve)


def test_an_answer_of_daqp_is_taken_and_named() -> None:
    found = distribution()
    found(MATRIX, OVERLOAD, CENTRE, LOW, HIGH)
    assert found.solver is Solver.OPTIMAL
    assert 0 < found.iterations < 12


@pytest.mark.parametrize("flag", [1, 2, 0, -1, -2, -3, -4, -5, -6, -7, -8])
def test_only_what_daqp_says_to_be_optimal_is_taken(
    flag: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same right answer each time."""
    right, _ = ActiveSet(SETTINGS, N)(NORMAL, FREE, LOW, HIGH)
    assert right is not None
    sides = (right == HIGH) * 1.0 - (right == LOW)
    answering(monkeypatch, right - FREE, flag, sides)
    found, taken = ActiveSet(SETTINGS, N)(NORMAL, FREE, LOW, HIGH)
    assert taken == 3
    if flag == 1:
        assert found is not None
        np.testing.assert_allclose(found, right, atol=1e-9)
    else:
        assert found is None


def test_where_daqp_has_no_answer_clarabel_is_asked_and_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found, reference = distribution(), distribution(solver="clarabel")
    expected = reference(MATRIX, OVERLOAD, CENTRE, LOW, HIGH)
    assert reference.solver is Solver.OPTIMAL
    answering(monkeypatch, np.zeros(N), -2)
    tensions = found(MATRIX, OVERLOAD, CENTRE, LOW, HIGH)
    assert found.solver is Solver.REFERENCE
    assert tensions.tobytes() == expected.tobytes()
    assert (found.iterations, found.deficit) == (reference.iterations, reference.deficit)


@pytest.mark.parametrize("wrong", [0.0, 1.0, math.nan, math.inf])
def test_an_answer_that_is_not_proven_is_not_taken(
    wrong: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, reference = distribution(), distribution(solver="clarabel")
    expected = reference(MATRIX, OVERLOAD, CENTRE, LOW, HIGH)
    answering(monkeypatch, np.full(N, wrong), 1)
    tensions = found(MATRIX, OVERLOAD, CENTRE, LOW, HIGH)
    assert found.solver is Solver.REFERENCE
    assert tensions.tobytes() == expected.tobytes()


def test_the_largest_error_that_is_taken_is_of_the_configuration(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A tension within its bounds that is off by a millionth of a newton tilts the slope by the
    column of H."""
    right, _ = ActiveSet(SETTINGS, N)(NORMAL, FREE, LOW, HIGH)
    assert right is not None
    within = int(np.flatnonzero((right > LOW) & (right < HIGH))[0])
    off = right - FREE
    off[within] += 1e-6
    error = corrected(NORMAL, FREE, LOW, HIGH, off, np.zeros(N), np.empty(N))
    assert error > 1e-3
    answering(monkeypatch, off, 1)
    for largest, taken in ((0.9 * error, False), (error, True), (1.1 * error, True)):
        settings = SETTINGS.model_copy(update={"largest_error": largest})
        found, iterations = ActiveSet(settings, N)(NORMAL, FREE, LOW, HIGH)
        assert (found is not None) is taken
        assert iterations == 3


def test_clarabel_by_choice_is_asked_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    answering(monkeypatch, np.full(N, math.nan), -1)
    found = distribution(solver="clarabel")
    found(MATRIX, OVERLOAD, CENTRE, LOW, HIGH)
    assert found.solver is Solver.OPTIMAL
    assert found.iterations > 3


def test_where_neither_has_an_answer_the_closed_form_has_one() -> None:
    found = distribution(maximum_iterations=1)
    tensions = found(MATRIX, OVERLOAD, CENTRE, LOW, HIGH)
    assert (found.solver, found.iterations) == (Solver.FALLBACK, 1)
    assert ((tensions >= LOW) & (tensions <= HIGH)).all()
