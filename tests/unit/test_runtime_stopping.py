"""A stop tick by tick: which it is, what it waits for, and when the drives are disabled."""

from __future__ import annotations

import numpy as np
import pytest

from tests.unit.sequence_setup import (
    CONTROL,
    HELD_TICKS,
    LANDING_TICKS,
    RELEASE_TICKS,
    REST_TICKS,
    ROBOT,
    STOP_TICKS,
    N,
    Way,
    descent,
    enabled,
    until,
)
from tonus.drivers.process_image import AxisCommand, AxisState
from tonus.runtime.states import Fault, Operator, State, StopMode

TENSION, STIFFNESS, STOP = CONTROL.tension, CONTROL.stiffness, CONTROL.stop
MOVING = (State.PRETENSION, State.HOLD, State.ACTIVE)
STALE = CONTROL.freshness.stale_stop_ticks


@pytest.fixture
def way() -> Way:
    """Its stop began along the path in ACTIVE; the first tick is over."""
    return Way().stop()


# --- which stop ----------------------------------------------------------------------------------


def test_a_stop_with_everything_keeps_to_the_path() -> None:
    for state in MOVING:
        way = Way().stop(state)
        assert way.sequence.stop_mode is StopMode.ON_PATH
        assert way.sequence.regulating
        assert not way.sequence.descending
        assert way.sequence.carrying.all()


@pytest.mark.parametrize(
    ("cells", "mode"),
    [
        ((7,), StopMode.DESCENT),
        ((0, 1, 2), StopMode.DESCENT),
        ((0, 1, 2, 3), StopMode.PASSIVE),
        ((N,), StopMode.ON_PATH),
    ],
)
def test_how_many_cables_a_descent_needs(cells: tuple[int, ...], mode: StopMode) -> None:
    """Five of eight; the contact cell is none of a cable."""
    way = Way().to(State.ACTIVE).fail(*cells)
    assert way.sequence.stop_mode is mode
    assert way.sequence.descending is (mode is StopMode.DESCENT)
    assert way.sequence.regulating is (mode is not StopMode.PASSIVE)


def test_after_a_contradiction_seven_are_needed() -> None:
    way = Way().to(State.ACTIVE)
    way.contradiction = (Fault.LENGTH_JUMP, 2)
    way.step()
    assert way.sequence.stop_mode is StopMode.DESCENT
    way.fail(5)
    assert way.sequence.stop_mode is StopMode.PASSIVE


def test_a_cable_that_is_not_present_is_left_out(way: Way) -> None:
    way.sensing.present[3] = False
    way.step()
    assert way.sequence.stop_mode is StopMode.DESCENT
    assert np.flatnonzero(~way.sequence.carrying).tolist() == [3]
    way.sensing.present[3] = True
    way.step()
    assert way.sequence.stop_mode is StopMode.DESCENT, "never a better one again"


def test_where_the_pose_is_not_known_it_is_passive() -> None:
    before = Way().to(State.REFERENCING)
    before.step(Operator.STOP)
    assert before.sequence.stop_mode is StopMode.PASSIVE
    for place, mode in ((-1, StopMode.PASSIVE), (2, StopMode.DESCENT)):
        way = Way().to(State.HOLD)
        way.contradiction = (Fault.LENGTH_DRIFT, place)
        way.step()
        assert way.sequence.stop_mode is mode


def test_there_is_no_mode_after_a_stop(way: Way) -> None:
    way.steps(STOP_TICKS)
    way.steps(1, after=State.STANDBY)
    assert way.sequence.stop_mode is StopMode.NONE
    assert not way.sequence.enabled
    again = way.stop()
    assert again.sequence.stop_mode is StopMode.ON_PATH
    assert enabled(again) == STOP_TICKS


# --- along the path ------------------------------------------------------------------------------


def test_a_stop_along_the_path_lasts_until_the_tensions_are_down(way: Way) -> None:
    """Full until a quarter is left, and then down to the tensions of referencing."""
    sequence = way.sequence
    for passed, left in ((0, 1.0), (48, 1.0), (8, 0.5), (4, 0.25)):
        way.steps(passed)
        levels = sequence.levels
        assert levels.low == pytest.approx(TENSION.slack + left * (TENSION.min - TENSION.slack))
        for found, least, most in (
            (levels.high, TENSION.referencing, TENSION.max),
            (levels.level, TENSION.referencing, TENSION.pre),
            (sequence.stiffness_cap, STIFFNESS.minimum, STIFFNESS.base),
        ):
            assert found == pytest.approx(least + left * (most - least))
    assert sequence.stop_ends == pytest.approx(0.064)
    way.steps(3)
    assert sequence.axis_command is AxisCommand.ENABLE
    assert sequence.stop_time == pytest.approx(0.063)
    way.steps(1)
    assert sequence.axis_command is AxisCommand.DISABLE
    assert not sequence.regulating
    assert sequence.levels.level == pytest.approx(TENSION.referencing)


def test_a_stop_in_pretension_does_not_tighten_the_cables() -> None:
    way = Way().to(State.PRETENSION)
    way.steps(4)
    share = way.sequence.levels.level
    way.step(Operator.STOP)
    assert way.sequence.levels.level == pytest.approx(share)
    way.steps(48)
    assert way.sequence.levels.level == pytest.approx(share)
    way.steps(14)
    left = TENSION.referencing + 0.125 * (TENSION.pre - TENSION.referencing)
    assert way.sequence.levels.level == pytest.approx(left)


def test_the_way_down_is_as_long_as_planned(way: Way) -> None:
    way.sequence.plan_stop(0.064)
    assert way.sequence.stop_ends == pytest.approx(0.096)
    assert enabled(way) == 96


def test_a_stop_because_of_contact_is_soft() -> None:
    way = Way().to(State.ACTIVE)
    way.envelope.fault = Fault.CONTACT_LIMIT
    way.step()
    assert way.sequence.stop_mode is StopMode.ON_PATH
    assert way.sequence.stiffness_cap == STIFFNESS.minimum


def test_the_drives_have_to_be_off_before_it_ends(way: Way) -> None:
    """Or silent for longer than a measurement may be old."""
    way.obeying = False
    way.steps(STOP_TICKS + 5)
    way.image.axes["state"][1:] = AxisState.SWITCHED_ON
    way.image.axes["age"][0] = STALE
    way.steps(5)
    way.image.axes["age"][0] = STALE + 1
    way.steps(1, after=State.STANDBY)


def test_drives_that_are_off_too_early_do_not_end_it(way: Way) -> None:
    """Nor count as faults, where their statuswords are old."""
    way.obeying = False
    way.image.axes["state"] = AxisState.SWITCH_ON_DISABLED
    way.image.axes["age"] = CONTROL.freshness.measurement_ticks + 1
    way.steps(STOP_TICKS - 1)
    way.steps(1, after=State.STANDBY)


def test_after_its_end_tensions_and_stiffness_stay_at_their_least(way: Way) -> None:
    way.obeying = False
    way.steps(STOP_TICKS + 10)
    levels = way.sequence.levels
    assert (levels.low, levels.level) == (TENSION.slack, TENSION.referencing)
    assert levels.high == TENSION.referencing
    assert way.sequence.stiffness_cap == STIFFNESS.minimum


def test_a_stop_by_a_fault_ends_in_fault() -> None:
    way = Way().to(State.ACTIVE)
    way.envelope.fault = Fault.SPEED_LIMIT
    way.step()
    way.steps(STOP_TICKS + REST_TICKS)
    way.steps(1, after=State.FAULT)
    assert not way.sequence.enabled
    assert way.sequence.fault is Fault.SPEED_LIMIT


def test_a_stop_by_a_fault_lets_go_by_its_drums_alone() -> None:
    """By the cells an operator's, whose robot is in order; and a path that has not led down."""
    for fault, height, drums in (
        (Fault.SPEED_LIMIT, 0.0, True),
        (Fault.SPEED_LIMIT, 0.031, False),
        (Fault.NONE, 0.0, False),
    ):
        way = Way().to(State.ACTIVE)
        way.envelope.fault = fault
        way.step(Operator.STOP)
        way.sequence.height = height
        shares = []
        while way.sequence.axis_command is AxisCommand.ENABLE:
            way.step()
            assert not (way.sequence.regulating and way.sequence.releasing)
            shares.append(way.sequence.passive_share)
        assert (max(shares) == 1.0) is drums
        if drums:
            lowered = shares.index(1.0)
            assert lowered == STOP_TICKS - RELEASE_TICKS - 1
            assert set(shares[:lowered]) == {-1.0}
            assert shares[lowered:] == sorted(shares[lowered:], reverse=True)
            assert shares.count(0.0) == REST_TICKS + 1
        else:
            assert shares == [-1.0] * len(shares)


# --- under a load --------------------------------------------------------------------------------


def test_under_a_load_it_holds_for_a_while(way: Way) -> None:
    way.sequence.load = 10.1
    assert enabled(way) == STOP_TICKS + HELD_TICKS


def test_a_load_that_it_can_be_let_go_with_is_none(way: Way) -> None:
    way.sequence.load = 10.0
    assert enabled(way) == STOP_TICKS


def test_once_the_load_is_gone_it_goes_on_and_does_not_wait_again(way: Way) -> None:
    way.sequence.load = 100.0
    way.steps(21)
    assert way.sequence.stop_time == pytest.approx(0.015), "at the standstill"
    way.sequence.load = 0.0
    way.steps(1)
    way.sequence.load = 100.0
    assert enabled(way) == STOP_TICKS - 16


def test_a_load_while_the_platform_comes_to_rest_is_nothing_to_wait_for(way: Way) -> None:
    way.sequence.load = 100.0
    way.steps(15)
    way.sequence.load = 0.0
    assert enabled(way) == STOP_TICKS - 15


def test_with_contact_nothing_is_waited_for_nor_by_a_descent_that_has_landed() -> None:
    """Whatever load it measures: a wrong cell would be one."""
    touching = Way().to(State.ACTIVE)
    touching.envelope.fault = Fault.CONTACT_LIMIT
    touching.step()
    touching.sequence.load = 100.0
    assert enabled(touching) == STOP_TICKS + REST_TICKS
    down = descent()
    down.sequence.load, down.sequence.height = 100.0, 0.0
    assert enabled(down) == STOP_TICKS + RELEASE_TICKS + REST_TICKS


@pytest.mark.parametrize(("aside", "height"), [(15.0, 0.01), (100.0, 0.011)])
def test_a_path_may_push_above_the_cradle_and_a_little_in_it(aside: float, height: float) -> None:
    way = Way().stop()
    way.steps(20)
    way.sequence.aside, way.sequence.height = aside, height
    assert enabled(way) == STOP_TICKS - 20
    assert way.sequence.stop_mode is StopMode.ON_PATH


def test_a_path_that_presses_the_platform_against_its_cradle_is_left(way: Way) -> None:
    """By more than what pushed it before it was down."""
    way.sequence.aside, way.sequence.height = 30.0, 0.011
    way.steps(20)
    way.sequence.height = 0.01
    way.steps(5)
    way.sequence.aside = 45.0
    way.steps(5)
    way.sequence.aside = 45.1
    assert until(way, StopMode.PASSIVE) == 1
    assert way.sequence.faults.first is Fault.NONE


def test_another_stop_waits_anew(way: Way) -> None:
    way.sequence.load = 100.0
    way.steps(STOP_TICKS + HELD_TICKS)
    way.steps(1, after=State.STANDBY)
    way.stop()
    assert way.sequence.stop_time == 0.0
    assert enabled(way) == STOP_TICKS + HELD_TICKS


# --- descent -------------------------------------------------------------------------------------


def test_the_tensions_of_a_descent() -> None:
    way = descent()
    levels = way.sequence.levels
    assert (levels.low, levels.high) == (STOP.least_tension, STOP.most_tension)
    assert levels.level == STOP.passive_tension
    assert way.sequence.stiffness_cap == STIFFNESS.minimum
    assert way.sequence.passive_share == -1.0


def test_a_descent_lets_go_when_the_platform_has_landed_and_its_time_is_over() -> None:
    """The tensions take 16 ms to go, and the drums have to stand for 8 ms."""
    way = descent()
    way.sequence.height = STOP.landed
    assert enabled(way) == STOP_TICKS + RELEASE_TICKS + REST_TICKS
    high = descent()
    high.sensing.rate = np.full(N, 1.0)
    high.steps(STOP_TICKS + 5)
    assert high.sequence.axis_command is AxisCommand.ENABLE
    assert not high.sequence.releasing
    high.sequence.height = STOP.landed
    high.steps(1)
    assert high.sequence.releasing
    assert enabled(high) == RELEASE_TICKS + LANDING_TICKS


def test_a_descent_that_has_let_go_does_not_wait_for_the_time_of_a_passive_stop() -> None:
    """Where the way down was so short that this would be longer; the drums never stand."""
    way = descent()
    way.sequence.plan_stop(0.0)
    way.sensing.rate, way.sequence.height = np.full(N, 1.0), STOP.landed
    assert enabled(way) == 2 * RELEASE_TICKS + LANDING_TICKS + RELEASE_TICKS


def test_what_pushes_a_descent_aside_in_its_cradle_is_no_path() -> None:
    way = descent()
    way.steps(20)
    way.sequence.height, way.sequence.aside = STOP.landed, 100.0
    way.steps(10)
    assert way.sequence.stop_mode is StopMode.DESCENT


def test_a_descent_that_never_lands_becomes_passive() -> None:
    """Its drums at rest at once, else after a while."""
    moving = descent()
    moving.sensing.rate = np.full(N, 1.0)
    assert until(moving, StopMode.PASSIVE) == STOP_TICKS + LANDING_TICKS
    standing = descent()
    assert until(standing, StopMode.PASSIVE) == STOP_TICKS
    landed = descent()
    landed.sequence.height = STOP.landed
    landed.steps(STOP_TICKS - 1)
    assert landed.sequence.stop_mode is StopMode.DESCENT


def test_a_descent_that_rises_becomes_passive() -> None:
    """By more than 20 mm over the least height since it has settled."""
    way = descent()
    way.sensing.rate = np.full(N, 1.0)
    way.sequence.height = 0.1
    way.steps(REST_TICKS - 2)
    way.sequence.height = 0.2
    way.steps(4)
    assert way.sequence.stop_mode is StopMode.DESCENT, "it has not settled yet"
    way.sequence.height = 0.15
    way.steps(2)
    way.sequence.height = 0.16
    way.steps(2)
    way.sequence.height = 0.15 + STOP.rise
    way.steps(2)
    assert way.sequence.stop_mode is StopMode.DESCENT
    way.sequence.height = 0.1701
    way.steps(1)
    assert way.sequence.stop_mode is StopMode.PASSIVE


@pytest.mark.parametrize(
    ("lost", "height", "passive"),
    [((5,), 0.1, True), ((), 0.1, False), ((5,), STOP.landed, False)],
)
def test_a_descent_that_nothing_supports_becomes_passive(
    lost: tuple[int, ...], height: float, passive: bool
) -> None:
    """Once several cables are lost, above its cradle; what is missed in between is forgotten."""
    most = 0.5 * ROBOT.platform.mass * ROBOT.gravity
    way = descent(4)
    way.fail(*lost)
    way.sensing.rate, way.sequence.height = np.full(N, 1.0), height
    for missed, count in ((most + 0.1, 15), (most, 1), (most + 0.1, 15)):
        way.sequence.missed = missed
        way.steps(count)
        assert way.sequence.stop_mode is StopMode.DESCENT
    way.steps(1)
    assert (way.sequence.stop_mode is StopMode.PASSIVE) is passive


def test_the_least_height_counts_from_the_tick_in_which_it_has_settled() -> None:
    way = descent()
    way.sensing.rate = np.full(N, 1.0)
    way.steps(REST_TICKS - 1)
    way.sequence.height = 0.1
    way.steps(1)
    way.sequence.height = 0.125
    way.steps(1)
    assert way.sequence.stop_mode is StopMode.PASSIVE


def test_drums_that_have_just_stood_for_long_enough_in_a_descent() -> None:
    way = descent()
    way.sensing.rate = np.full(N, 1.0)
    way.steps(STOP_TICKS - REST_TICKS)
    way.sensing.rate = np.zeros(N)
    assert until(way, StopMode.PASSIVE) == REST_TICKS


def test_settling_counts_from_the_beginning_of_the_descent(way: Way) -> None:
    way.sequence.height = 0.1
    way.steps(20)
    way.sensing.rate = np.full(N, 1.0)
    way.fail(2)
    assert way.sequence.stop_mode is StopMode.DESCENT
    way.steps(REST_TICKS - 1)
    way.sequence.height = 0.2
    way.steps(3)
    assert way.sequence.stop_mode is StopMode.DESCENT
    way.sequence.height = 0.23
    way.steps(1)
    assert way.sequence.stop_mode is StopMode.PASSIVE


def test_a_length_that_is_wrong_in_a_descent_excludes_no_cable() -> None:
    for cable in (-1, 0, 6):
        way = descent()
        way.isolation.misread = cable
        way.contradiction = (Fault.LENGTH_JUMP, 1)
        way.step()
        faults = way.sequence.faults
        assert faults.at(Fault.LENGTH_DRIFT, cable) is (cable >= 0)
        assert np.flatnonzero(faults.failed).tolist() == [4]
        assert way.asked[-2:] == [StopMode.NONE, StopMode.DESCENT]


def test_a_bound_that_is_met_in_a_descent_is_found() -> None:
    way = descent()
    way.envelope.fault, way.envelope.where = Fault.OVER_TENSION, 1
    way.step()
    assert way.sequence.faults.at(Fault.OVER_TENSION, 1)
