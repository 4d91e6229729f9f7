"""The judge: what the daemon's record alone tells: stiffness, tare, states and stops."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.unit.supervisor_setup import (
    MS,
    STRICT,
    N,
    claim,
    judged,
    lasting,
    seen,
)
from tonus.config import Config, load
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import State, StopMode
from tonus.runtime.supervisor.judge import NOWHERE, Judge
from tonus.runtime.supervisor.observation import Observation


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


NO_NUMBERS = [
    ("tension", Requirement.MEASURED_LOGGED, [State.ACTIVE]),
    ("reference", Requirement.OPPOSED, [State.PRETENSION, State.ACTIVE]),
    ("tare", Requirement.MEASURED_LOGGED, [State.ACTIVE, State.SAFE_STOP]),
    ("contact", Requirement.MEASURED_LOGGED, [State.ACTIVE]),
]


def test_how_far_a_recorded_contact_is_off(config: Config) -> None:
    found = lasting(config, 5.0, contact=15.5)
    assert found is not None
    assert (found.where, found.value) == (NOWHERE, -15.5)


@pytest.mark.parametrize(("name", "requirement", "states"), NO_NUMBERS)
@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_a_record_that_is_no_number(
    config: Config, name: str, requirement: Requirement, states: list[State], value: float
) -> None:
    whole = getattr(claim(), name)
    wrong = (
        value if isinstance(whole, float) else np.where(np.arange(len(whole)) == 3, value, whole)
    )
    for state in states:
        looks = [seen(100.0 + k, claim(state, 100.0 + k, **{name: wrong})) for k in range(0, 11, 5)]
        found = judged(config, *looks)[-1]
        assert found is not None
        assert found.requirement is requirement


def test_how_fast_the_stiffness_rises(config: Config) -> None:
    def rise(newton_per_metre: float, first: State = State.ACTIVE, dt_ms: float = 1.0) -> Any:
        before = claim(first, 99.0)
        after = claim(at_ms=99.0 + dt_ms, stiffness=3210.0 + newton_per_metre)
        return judged(config, seen(claims=[before, after]))[0]

    assert rise(18.0) is None
    assert rise(-2800.0) is None
    assert rise(19.0).requirement is Requirement.STIFFNESS
    assert rise(19.0, State.PRETENSION) is None
    first, other = claim(State.HOLD, 98.0), claim(State.PRETENSION, 99.0)
    for rises, broken in ((37.0, False), (38.0, True)):
        last = claim(at_ms=100.0, stiffness=3210.0 + rises)
        found = judged(config, seen(claims=[first, other, last]))[0]
        assert (found is not None) is broken, "a state between them changes nothing"
    assert rise(18.0, dt_ms=0.0) is None, "as in a tick: a stamp may be wrong"
    assert rise(19.0, dt_ms=0.0).requirement is Requirement.STIFFNESS
    assert rise(19.0, dt_ms=-5.0).requirement is Requirement.STIFFNESS


def test_a_drive_enabled_while_disarmed(config: Config) -> None:
    for state in (State.OFF, State.STANDBY, State.FAULT):
        assert lasting(config, 49.0, state) is None
        assert lasting(config, 50.0, state).requirement is Requirement.DISARMED


@pytest.mark.parametrize("before", State)
def test_what_was_recorded_before_a_stop_tells_whether_it_was_controlled(
    config: Config, before: State
) -> None:
    """Whether or not a drive was enabled then. Power that begins with a stop is as disarmed."""
    assert config.supervisor is not None
    judge = Judge(config, config.supervisor)
    judge.forget()
    judge.note([claim(State.STANDBY, 97.0), claim(before, 98.0), claim(State.SAFE_STOP, 99.0)])
    found = [judge(seen(at_ms, claim(State.SAFE_STOP, at_ms))) for at_ms in (100.0, 150.0)][-1]
    if before in (State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE):
        assert found is None
    else:
        assert found is not None
        assert found.requirement is Requirement.DISARMED


def test_a_stop_that_does_not_end(config: Config) -> None:
    def stopping(at_ms: float, state: State = State.SAFE_STOP) -> Observation:
        return seen(at_ms, claim(state, at_ms))

    assert judged(config, stopping(0), stopping(39_999), stopping(40_001))[:2] == [None, None]
    last = judged(config, stopping(0), stopping(40_001))[1]
    assert last is not None
    assert last.requirement is Requirement.STOP_ENDS
    flickers = [stopping(0), stopping(30_000, State.STANDBY), stopping(50_000)]
    assert judged(config, *flickers)[2] is not None, "the drives stayed enabled"


def test_a_stop_that_is_followed_by_control(config: Config) -> None:
    """A stop ends in a disarmed state, by the record or by the drives."""
    looks = [seen(0.0, claim(State.SAFE_STOP, 0.0)), seen(2.0, claim(State.ACTIVE, 2.0))]
    one, other = (claim(state, 1.0) for state in (State.SAFE_STOP, State.STANDBY))
    active = claim(at_ms=2.0)
    for each in (
        looks,
        [looks[0], seen(1.0, other), looks[1]],
        [seen(2.0, active, claims=[one, active])],
    ):
        found = judged(config, *each)[-1]
        assert found is not None
        assert found.requirement is Requirement.STOP_ENDS
    assert judged(config, seen(2.0, active, claims=[active])) == [None]
    assert config.supervisor is not None
    judge = Judge(config, config.supervisor)
    assert judge(looks[0]) is None
    judge.rest(1 * MS)
    assert judge(looks[1]) is None


def test_a_stop_that_comes_back_to_a_mode_of_before(config: Config) -> None:
    """Also between two looks. The next stop begins anew."""
    path, descent, passive = (
        lambda at_ms, mode=mode: claim(State.SAFE_STOP, at_ms, stop_mode=mode)
        for mode in (StopMode.ON_PATH, StopMode.DESCENT, StopMode.PASSIVE)
    )
    for before, after in ((descent, path), (passive, descent), (passive, path)):
        found = judged(config, seen(0.0, before(0.0)), seen(2.0, after(2.0)))
        assert found[0] is None
        assert found[1] is not None
        assert found[1].requirement is Requirement.STOP_ENDS
        onward = judged(config, seen(0.0, after(0.0)), seen(2.0, before(2.0)))
        assert onward == [None, None]
    between = seen(2.0, passive(2.0), claims=[passive(0.0), descent(1.0), passive(2.0)])
    assert judged(config, between)[0] is not None
    assert config.supervisor is not None
    judge = Judge(config, config.supervisor)
    assert judge(seen(0.0, descent(0.0))) is None
    judge.rest(1 * MS)
    assert judge(seen(2.0, path(2.0))) is None


@pytest.mark.parametrize("state", [8, 255, -1])
def test_a_state_that_does_not_exist(config: Config, state: int) -> None:
    """Is none in which a drive may be enabled."""
    found = lasting(config, 50.0, state)  # type: ignore[arg-type]
    assert found is not None
    assert found.requirement is Requirement.DISARMED


def test_a_tare_beyond_its_limit(config: Config) -> None:
    tare = np.zeros(N + 1)
    tare[3] = -5.1
    said = claim(tare=tare)
    first, last = seen(said=said), seen(105.0, replace(said, at_ns=105 * MS))
    found = judged(config, first, last)[1]
    assert found is not None
    assert (found.requirement, found.where) == (Requirement.MEASURED_LOGGED, NOWHERE)


def test_a_tare_at_its_limit_and_its_value_beyond(config: Config) -> None:
    tare = np.zeros(N + 1)
    for value, broken in ((5.0, False), (5.1, True)):
        tare[3] = -value
        late = seen(150.0, claim(at_ms=150.0, tare=tare))
        found = judged(config, seen(said=claim(tare=tare)), late)[1]
        assert (found is not None) is broken
        assert found is None or found.value == pytest.approx(value)


def test_the_stiffness_is_judged_in_hold_and_active_only(config: Config) -> None:
    for state in (State.REFERENCING, State.PRETENSION, State.SAFE_STOP):
        assert judged(config, seen(said=claim(state, stiffness=9e9))) == [None]
    assert judged(config, seen(said=claim(State.HOLD, stiffness=9e9)))[0] is not None


def test_how_fast_the_stiffness_may_rise_at_most(config: Config) -> None:
    fastest = config.control.stiffness.rise_rate * 1.1 * 1e-3
    before = claim(at_ms=99.0, stiffness=3000.0)
    exactly = claim(at_ms=100.0, stiffness=3000.0 + fastest)
    assert judged(config, seen(claims=[before, exactly])) == [None]


def test_how_long_a_stop_may_last_and_how_long_it_did(config: Config) -> None:
    def stopping(at_ms: float) -> Observation:
        return seen(at_ms, claim(State.SAFE_STOP, at_ms))

    looks = judged(config, stopping(5_000), stopping(45_000), stopping(45_001))
    assert looks[:2] == [None, None]
    assert looks[2] is not None
    assert looks[2].value == pytest.approx(40.001)
    just = replace(stopping(45_000), now_ns=45_000 * MS + 1)
    assert judged(config, stopping(5_000), just)[1] is not None
