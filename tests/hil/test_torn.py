"""Every cable torn at rest at home; `make test-long` does it at two more poses, `make torn` at all
27, and in motion."""

from __future__ import annotations

from functools import cache

import pytest

from tests.torn import CABLES, Place, Torn
from tonus.config.loader import load_bounds
from tonus.runtime.states import StopMode

pytestmark = pytest.mark.wide

HOME: Place = (0.0, 0.0, 0.0)
TENSION = 1.2 * 200.0
"""N: `tension` of config/bounds.yaml, of T_max"""


@cache
def robot(home: Place) -> Torn:
    """Brought up once for all cases there: each is forked from it."""
    return Torn(home)


@pytest.mark.parametrize(
    "home",
    [
        HOME,
        pytest.param((-0.15, -0.15, -0.06), marks=pytest.mark.long),
        pytest.param((0.15, 0.0, 0.0), marks=pytest.mark.long),
    ],
    ids=str,
)
def test_no_torn_cable_throws_the_platform(home: Place) -> None:
    bounds = load_bounds()
    for cable in range(CABLES):
        (case,) = robot(home).cases(cable, ("rest",))
        assert case.peak_speed <= bounds.speed, case
        assert case.peak_tension <= TENSION, case
        assert case.where == cable, case
        assert case.given_up == (cable,), case
        assert case.found_after is not None, case
        assert case.found_after <= bounds.found_within["cable_cut"], case
        assert case.at_rest, case
        assert case.ended_after is not None, case


@pytest.mark.parametrize(
    ("home", "cable"),
    [
        ((0.15, 0.15, 0.0), 0),
        pytest.param((-0.15, 0.15, 0.0), 1, marks=pytest.mark.long),
        pytest.param((-0.15, -0.15, 0.0), 2, marks=pytest.mark.long),
        pytest.param((0.15, -0.15, 0.0), 3, marks=pytest.mark.long),
    ],
)
def test_drums_that_pay_out_do_not_pull_a_thrown_platform_on(home: Place, cable: int) -> None:
    """In the corner next to its anchor the loss of an upper cable throws the platform farthest.
    With drums that damp their own rate the others pull 12 N on: 0.83 m/s."""
    (case,) = robot(home).cases(cable, ("rest",))
    assert case.peak_speed <= load_bounds().speed, case
    assert case.given_up == (cable,), case
    assert case.at_rest, case


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (0, 1),
        pytest.param(0, 2, marks=pytest.mark.long),
        (0, 4),
        pytest.param(3, 7, marks=pytest.mark.long),
        pytest.param(4, 2, marks=pytest.mark.long),
        (4, 6),
    ],
)
def test_a_second_cable_torn_in_the_descent_is_named_and_throws_nothing(
    first: int, second: int
) -> None:
    case = robot(HOME).again(first, second, after=0.3)
    assert case.named, case
    assert case.given_up == tuple(sorted((first, second))), case
    assert case.peak_speed <= load_bounds().speed, case
    assert case.peak_tension <= TENSION, case
    assert case.at_rest, case


@pytest.mark.parametrize(("first", "second"), [(4, 5), pytest.param(6, 7, marks=pytest.mark.long)])
def test_two_lower_cables_of_one_side_do_not_topple_the_platform(first: int, second: int) -> None:
    """Asked back to level with all of its spring, and with moments that hardly counted, it turned
    over at 7 rad/s and rose, and the stop became passive: 0.7 m/s."""
    case = robot(HOME).again(first, second, after=0.1)
    assert case.named, case
    assert case.mode == StopMode.DESCENT.name, case
    assert case.later_speed <= load_bounds().quiet_speed, case
    assert case.at_rest, case
