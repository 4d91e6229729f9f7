"""A passive stop tick by tick: which drums it waits for, and when it releases them."""

from __future__ import annotations

import numpy as np
import pytest

from tests.unit.sequence_setup import (
    CONTROL,
    FAST,
    LANDING_TICKS,
    LOWER_TICKS,
    PASSIVE_TICKS,
    RELEASE_TICKS,
    REST_TICKS,
    ROBOT,
    N,
    Way,
    descent,
    enabled,
    passive,
)
from tonus.drivers.process_image import AxisCommand
from tonus.runtime.states import Fault, Operator, State, StopMode

STOP = CONTROL.stop


def test_a_passive_stop_releases_the_drums_once_they_stand() -> None:
    """All of them, for 8 ms; the tensions then take 16 ms to go, and the drums have to stand for
    8 ms once more before the drives are disabled."""
    way = passive()
    way.steps(30)
    assert way.sequence.passive_share == 1.0
    way.sensing.rate = 0.99 * STOP.rest_speed / ROBOT.drum_radius
    way.steps(REST_TICKS - 1)
    assert way.sequence.passive_share == 1.0
    shares = []
    for _ in range(3):
        way.steps(1)
        shares.append(way.sequence.passive_share)
    assert shares == pytest.approx([1.0, 1.0 - 1 / RELEASE_TICKS, 1.0 - 2 / RELEASE_TICKS])
    assert not way.sequence.regulating
    assert enabled(way) == RELEASE_TICKS - 2 + REST_TICKS
    assert way.sequence.passive_share == 0.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_drum_that_turns_is_waited_for(sign: float) -> None:
    """Any of them, to both sides; it then has to stand for the whole time again."""
    way = passive()
    way.sensing.rate = np.zeros(N)
    way.steps(REST_TICKS - 2)
    way.sensing.rate[N - 1] = sign * 1.01 * STOP.rest_speed / ROBOT.drum_radius[N - 1]
    way.steps(1)
    way.sensing.rate[N - 1] = 0.0
    assert enabled(way) == REST_TICKS + RELEASE_TICKS + REST_TICKS


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_drums_that_are_slow_for_as_long_as_lowering_takes_are_released(sign: float) -> None:
    """Their tension may be all that moves them. One that is fast is waited for anew."""
    way = passive()
    slow = 0.99 * STOP.passive_speed / ROBOT.drum_radius
    way.sensing.rate = slow.copy()
    way.steps(LOWER_TICKS - 1)
    way.sensing.rate[2] = sign * 1.01 * STOP.passive_speed / ROBOT.drum_radius[2]
    way.steps(1)
    way.sensing.rate = slow
    way.steps(LOWER_TICKS)
    assert way.sequence.passive_share == 1.0
    way.steps(2)
    assert way.sequence.passive_share < 1.0


@pytest.mark.parametrize("fast", [True, False])
def test_drums_that_are_not_fast_any_more_are_released_after_lowering(fast: bool) -> None:
    """After a tick at the bound itself, which is fast; or from the first on. A time that is over
    by the last tick is over."""
    way = passive()
    summed = 0.0
    for _ in range(LOWER_TICKS):
        summed += CONTROL.rates.period
    way.sequence.plan_stop(summed)
    radius = ROBOT.drum_radius[2]
    slow, bound = 0.5 * STOP.passive_speed / radius, STOP.passive_speed / radius
    assert bound * radius == STOP.passive_speed
    if fast:
        way.sensing.rate = np.full(N, slow)
        way.steps(5)
        way.sensing.rate = np.where(np.arange(N) == 2, bound, slow)
        way.steps(1)
    way.sensing.rate = np.full(N, slow)
    way.steps(LOWER_TICKS - 1)
    assert not way.sequence.releasing
    way.steps(1)
    assert way.sequence.releasing


def test_drums_that_are_never_slow_are_released_in_the_end() -> None:
    assert enabled(passive()) == PASSIVE_TICKS + RELEASE_TICKS + LANDING_TICKS


def test_without_a_tension_a_platform_has_the_time_of_a_passive_stop_to_come_down() -> None:
    """Drums that are slow, and do not stand: they go on damping until `passive_s` is over, and for
    `landing_s` at least."""
    for late in (0, PASSIVE_TICKS - LOWER_TICKS):
        way = passive()
        way.steps(late)
        way.sensing.rate = 1.01 * STOP.rest_speed / ROBOT.drum_radius
        left = PASSIVE_TICKS if late == 0 else LOWER_TICKS + LANDING_TICKS
        assert enabled(way) == pytest.approx(left + RELEASE_TICKS, abs=1)


def test_drums_that_are_torn_or_not_believed_are_not_waited_for() -> None:
    for fault in (Fault.CABLE_TORN, Fault.DRUM_STUCK, Fault.DRUM_TORQUE):
        way = passive()
        way.disobedient = (fault, 3)
        way.sensing.rate = np.where(np.arange(N) == 3, 9.0, 0.0)
        assert enabled(way) == REST_TICKS + RELEASE_TICKS + REST_TICKS
    way = passive()
    way.disobedient = (Fault.CELL_FROZEN, 3)
    way.sensing.rate = np.where(np.arange(N) == 3, 9.0, 0.0)
    assert enabled(way) > REST_TICKS + RELEASE_TICKS + REST_TICKS


def test_a_stop_that_becomes_passive_counts_from_there() -> None:
    way = descent()
    way.sensing.rate = np.full(N, FAST)
    way.steps(20)
    way.step(finite=False)
    assert way.sequence.stop_mode is StopMode.PASSIVE
    assert enabled(way) == PASSIVE_TICKS + RELEASE_TICKS + LANDING_TICKS


def test_standing_in_a_descent_is_no_standing_in_a_passive_stop() -> None:
    way = descent()
    way.steps(30)
    way.step(finite=False)
    assert enabled(way) == REST_TICKS + RELEASE_TICKS + REST_TICKS


def test_bounds_and_contradictions_are_not_looked_at_in_a_passive_stop() -> None:
    way = passive()
    way.contradiction = (Fault.LENGTH_JUMP, 1)
    way.envelope.fault = Fault.SPEED_LIMIT
    way.steps(2)
    assert not way.sequence.faults.has(Fault.LENGTH_JUMP)
    assert not way.sequence.faults.has(Fault.SPEED_LIMIT)


def test_another_passive_stop_is_released_anew() -> None:
    way = passive()
    enabled(way)
    way.steps(1, after=State.FAULT)
    way.step(Operator.RESET)
    way.to(State.ACTIVE)
    way.sensing.rate = np.full(N, FAST)
    way.step(finite=False)
    assert way.sequence.passive_share == 1.0
    assert enabled(way) == PASSIVE_TICKS + RELEASE_TICKS + LANDING_TICKS


def test_slow_drums_of_an_earlier_passive_stop_do_not_count() -> None:
    slow = np.full(N, 0.5 * STOP.passive_speed / ROBOT.drum_radius.max())
    way = passive()
    way.sensing.rate = slow
    way.steps(LOWER_TICKS + 1)
    assert way.sequence.releasing
    way.sensing.rate = np.zeros(N)
    enabled(way)
    way.steps(1, after=State.FAULT)
    way.step(Operator.RESET)
    way.to(State.ACTIVE)
    way.sensing.rate = slow
    way.step(finite=False)
    way.steps(LOWER_TICKS - 3)
    assert not way.sequence.releasing


def test_before_references_the_cables_are_slackened_from_what_they_were() -> None:
    way = Way().to(State.REFERENCING)
    while way.sequence.straightening < 0.5:
        way.step()
    share = way.sequence.straightening
    way.step(Operator.STOP)
    assert way.sequence.passive_share == pytest.approx(share)
    way.steps(4)
    assert way.sequence.passive_share == pytest.approx(0.75 * share)
    assert enabled(way) == RELEASE_TICKS - 4


def test_a_robot_whose_drives_were_never_enabled_is_not_enabled_by_its_stop() -> None:
    way = Way().to(State.STANDBY)
    way.obeying = False
    way.step(Operator.ARM)
    way.step(Operator.STOP)
    assert way.state is State.SAFE_STOP
    assert way.sequence.axis_command is AxisCommand.DISABLE
    assert way.sequence.passive_share == 0.0


def test_the_share_stays_at_nothing() -> None:
    """While drives do not say that they are off: after references, and before them."""
    after = passive()
    after.obeying = False
    before = Way().to(State.REFERENCING)
    before.steps(3)
    before.step(Operator.STOP)
    before.obeying = False
    for way in (after, before):
        way.steps(PASSIVE_TICKS + RELEASE_TICKS + 10)
        assert way.sequence.passive_share == 0.0
