"""The judge: torques that do not change (SUP-3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.unit.supervisor_setup import (
    STRICT,
    N,
    at,
    claim,
    judged,
    seen,
)
from tonus.config import Config, load
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import State


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


def test_frozen_torques_outside_of_control(config: Config) -> None:
    same = {"same": np.full(N, 6)}
    assert judged(config, seen(said=claim(State.REFERENCING), **same)) == [None]
    for state in (State.REFERENCING, State.SAFE_STOP):
        found = judged(config, seen(said=claim(state), jolt=at(3, 0.031), **same))[0]
        assert found is not None
        assert found.requirement is Requirement.FROZEN
    silent = replace(seen(**same), claim=None, claims=[])
    assert [found and found.requirement for found in judged(config, silent)] == [Requirement.TICK]


def test_torques_that_have_no_reason_to_change(config: Config) -> None:
    """With cells that have no noise, on a platform at rest."""
    for swing, frozen in ((0.05, False), (0.051, True)):
        found = judged(config, seen(same=np.full(N, 6), swing=at(4, swing)))[0]
        assert (found is not None) is frozen


def test_a_cable_that_is_given_up_may_move_while_the_others_stand(config: Config) -> None:
    """In a slow stop equal torques are right; what moves meanwhile is a drum without torque."""
    given_up, without = np.arange(N) == 3, at(3, 0.0, 20.0)
    for failed, mille, moves, found in (
        (given_up, without, 3, False),
        (given_up, without, 4, True),
        (~given_up, without, 3, True),
        (given_up, at(3, 1.0, 20.0), 3, True),
        (given_up | True, np.zeros(N), 3, True),
    ):
        given = {"same": np.full(N, 6), "mille": mille, "jolt": at(moves, 0.04)}
        stop = claim(State.SAFE_STOP, failed=failed)
        assert (judged(config, seen(said=stop, **given))[0] is not None) is found
        control = seen(said=claim(State.ACTIVE, failed=failed), swing=np.zeros(N), **given)
        assert judged(config, control)[0] is not None


def test_which_torques_are_frozen(config: Config) -> None:
    """All, or more than half of them that pull; what changed has to be at one of those."""
    half, most = np.arange(N) < 4, np.arange(N) < 5
    for frozen, mille, swing, found in (
        (most, 100, 0, True),
        (half, 100, 0, False),
        (most, 100, 7, False),
        (most, 0, 0, False),
        (np.ones(N, bool), 0, 0, True),
    ):
        given = np.where(frozen, mille, 100)
        look = seen(
            same=np.where(frozen, 6, 0),
            mille=given,
            swing=at(swing, 1.0),
        )
        assert (judged(config, look)[0] is not None) is found
        stopping = replace(look, claim=claim(State.SAFE_STOP), jolt=np.full(N, 0.04))
        assert (judged(config, stopping)[0] is not None) is bool(frozen.all())


def test_frozen_torques_in_each_controlled_state(config: Config) -> None:
    for state in (State.PRETENSION, State.HOLD, State.ACTIVE):
        found = judged(config, seen(said=claim(state), same=np.full(N, 6)))[0]
        assert found is not None
        assert found.requirement is Requirement.FROZEN


@pytest.mark.parametrize(
    ("state", "jolt", "found"),
    [
        (State.SAFE_STOP, 0.07, True),
        (State.SAFE_STOP, 0.059, False),
        (State.REFERENCING, 0.07, True),
        (State.REFERENCING, 0.059, False),
        (State.HOLD, 0.031, True),
        (State.HOLD, 0.029, False),
    ],
)
def test_a_torque_that_was_the_same_before_the_others(
    config: Config, state: State, jolt: float, found: bool
) -> None:
    """In twelve frames its drum has changed its rate; all have been the same for six of them. Where
    a stop lets go only what is of these counts."""
    same, swing = at(2, 12.0, 6.0).astype(np.int64), np.zeros(N)
    look = seen(said=claim(state), same=same, jolt=at(2, jolt), swing=swing)
    verdict = judged(config, look)[0]
    assert (verdict is not None) is found
    assert verdict is None or (verdict.requirement, verdict.value) == (Requirement.FROZEN, 6)


def test_how_many_torques_have_been_equal(config: Config) -> None:
    """The value is the least over the drives: so many are equal at each of them."""
    found = judged(config, seen(same=np.array([9, 6, 7, 8, 9, 9, 9, 9])))[0]
    assert found is not None
    assert (found.requirement, found.value) == (Requirement.FROZEN, 6)


@pytest.mark.parametrize(
    ("pull", "error", "rate", "right"),
    [
        (-600.0, -100.0, -0.5, True),
        (-600.0, 100.0, -0.5, False),
        (600.0, 100.0, 0.5, True),
        (600.0, -100.0, 0.5, False),
        (600.0, -100.0, -0.5, True),
        (-600.0, 100.0, 0.5, True),
        (-600.0, 100.0, 0.0, False),
        (600.0, -100.0, -0.001, True),
        (-600.0, 100.0, 0.001, True),
        (0.5, 100.0, 0.0, True),
        (0.5, -100.0, 0.0, False),
        (-0.5, -100.0, 0.0, True),
        (0.0, 100.0, 0.0, False),
        (600.0, 0.5, 0.0, True),
        (600.0, -0.5, 0.0, False),
        (600.0, 0.0, 0.0, False),
    ],
)
def test_a_motor_at_its_limit_in_a_stop(
    config: Config, pull: float, error: float, rate: float, right: bool
) -> None:
    """It cannot give more, as long as the tension goes to its reference by it, or the drum is
    braked. Where one axis is not at its limit, its torque has to change."""
    tension = 150.0
    stop = claim(State.SAFE_STOP, reference=np.full(N, tension + error))
    given = {
        "same": np.full(N, 6),
        "torque": np.full(N, tension + pull),
        "tension": np.full(N, tension),
        "rate": np.full(N, rate),
        "jolt": np.full(N, 0.04),
    }
    limited = np.ones(N, bool)
    found = judged(config, seen(said=stop, limited=limited, **given))[0]
    assert (found is None) is right
    for free in (limited & (np.arange(N) != 3), ~limited):
        assert judged(config, seen(said=stop, limited=free, **given))[0] is not None
    kept = judged(
        config, seen(said=stop, limited=np.arange(N) != 3, **given | {"jolt": at(4, 0.04)})
    )
    assert (kept[0] is None) is right, "what moves is an axis at its limit"
    control = claim(State.ACTIVE, reference=stop.reference, tension=stop.tension)
    found = judged(config, seen(said=control, limited=limited, **given))[0]
    assert found is not None
    assert found.requirement is Requirement.FROZEN


@pytest.mark.parametrize("state", [State.SAFE_STOP, State.FAULT])
def test_drives_without_a_torque_that_would_only_lose_it(state: State) -> None:
    """Every cable is given up. Drives that lose the heartbeat brake, those on a relay do not. Nor
    in the look in which the daemon is disarmed, and the drives are not yet."""
    stop = claim(state, failed=np.ones(N, bool))
    given = {"same": np.full(N, 6), "jolt": np.full(N, 0.04), "torque": np.zeros(N)}
    for path, found in (("config/can.yaml", True), ("config/ethercat.yaml", False)):
        config = load(path, overrides=STRICT)[0]
        verdict = judged(config, seen(said=stop, mille=np.zeros(N, np.int64), **given))[0]
        assert (verdict is not None) is found
        some = judged(config, seen(said=stop, mille=at(2, 1.0), **given))[0]
        assert some is not None
        assert some.requirement is Requirement.FROZEN
