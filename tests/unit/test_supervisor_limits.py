"""The judge: at the limits themselves, and what is sent against what is recorded."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.unit.supervisor_setup import (
    MS,
    STRICT,
    N,
    Stage,
    at,
    claim,
    judged,
    lasting,
    seen,
)
from tonus.config import Config, load
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import State
from tonus.runtime.supervisor.judge import NOWHERE, Judge
from tonus.runtime.supervisor.observation import Observation
from tonus.runtime.supervisor.record import CONTROLLED, Claim


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


AT_A_LIMIT = [
    {"said": claim(at_ms=95.0)},
    {"said": claim(stiffness=1.1 * 4879.2)},
    {"contact": 1.1 * 25.0, "said": claim(contact=1.1 * 25.0)},
    {"contact": -1.1 * 25.0, "said": claim(contact=-1.1 * 25.0)},
    {"contact": 20.0, "said": claim(contact=5.0)},
    {"said": claim(at_ms=105.0)},
    {"said": claim(stiffness=420.0 / 1.1)},
    {"tension": at(6, 1.1 * 200.0, 45.0), "torque": at(6, 1.1 * 200.0, 45.0)},
    {
        "torque": at(1, -15.0, 45.0),
        "said": claim(reference=np.full(N, 50.0)),
    },
    {"torque": at(1, -20.0, 45.0), "tension": at(1, 43.0, 45.0)},
    {"torque_age": np.full(N, 5.0)},
    {"torque_age": at(3, 150.0)},
    {"measured_age": at(3, 20.0)},
    {"cell_age": at(3, 20.0)},
    {"contact_age": 20.0},
    {"contact": 35.0, "said": claim(State.SAFE_STOP)},
    {"unexplained": at(4, 91.25)},
    {"jolt": np.full(N, 0.03), "same": np.full(N, 6), "said": claim(State.REFERENCING)},
]


@pytest.mark.parametrize("given", AT_A_LIMIT, ids=range(len(AT_A_LIMIT)))
def test_what_is_at_its_limit_is_within(config: Config, given: dict[str, Any]) -> None:
    said = given.get("said", claim())
    rest = {key: value for key, value in given.items() if key != "said"}
    age = 100 * MS - said.at_ns
    if "tension" in rest:
        said = replace(said, tension=rest["tension"])
    looks = []
    for k in range(0, 150, 5):
        now = replace(said, at_ns=(100 + k) * MS - age)
        looks.append(replace(seen(100.0 + k, now, **rest), claims=[]))
    looks[0] = replace(looks[0], claims=[said])
    assert judged(config, *looks) == [None] * 30


def test_a_torque_in_any_of_the_newest_records_is_logged(config: Config) -> None:
    for state in (State.ACTIVE, State.SAFE_STOP):
        broken = {"unlogged": at(7, 1, 0) > 0}
        assert lasting(config, 2.9, state, **broken) is None
        found = lasting(config, 3.0, state, **broken)
        assert found is not None, "it compares what is a look old"
        assert (found.requirement, found.where) == (Requirement.COMMAND_LOGGED, 7)


def test_a_torque_that_is_not_logged_where_nothing_may_last(config: Config) -> None:
    """With a patience no longer than the time between two looks, it is found in the first."""
    assert config.supervisor is not None
    for patience_ms in (2.0, 1.0):
        settings = config.supervisor.model_copy(update={"patience_ms": patience_ms})
        found = Judge(config, settings)(seen(unlogged=at(7, 1, 0) > 0))
        assert found is not None
        assert found.requirement is Requirement.COMMAND_LOGGED


def test_torques_of_one_channel_that_come_late(config: Config) -> None:
    """The channel's drives have to stop, not the others: those are sent what is recorded. Where
    torques of several channels are late, or of the only one, all have to."""
    rows = np.arange(N)
    one, two, none = rows < 1, rows < 2, rows < 0
    apart = (rows == 1) | (rows == 6)
    for unlogged, late, same, enabled, alone, where in (
        (two, two, none, ~none, True, 0),
        (two, ~none, none, ~none, True, 0),
        (apart, apart, none, ~none, False, 1),
        (rows < 7, rows < 7, none, ~none, False, 0),
        (two, one, none, ~none, False, 1),
        (two, two, one, ~none, False, 0),
        (two, two, two & ~one, ~none, False, 1),
        (~none, ~none, none, ~none, False, 0),
        (two, two, none, two, False, 0),
        (one, one, none, two, False, 0),
    ):
        look = {"unlogged": unlogged, "late": late, "enabled": enabled}
        look["same"] = np.where(same, 6, 5)
        assert lasting(config, 2.9, State.SAFE_STOP, **look) is None
        found = lasting(config, 3.0, State.SAFE_STOP, **look)
        assert found is not None
        assert (found.requirement, found.alone, found.where) == (
            Requirement.COMMAND_LOGGED,
            alone,
            where,
        )
    zeros = {"unlogged": one, "late": one, "same": np.full(N, 60), "mille": at(0, 0, 100)}
    found = lasting(config, 3.0, State.SAFE_STOP, **zeros)
    assert found is not None
    assert (found.requirement, found.alone) == (Requirement.COMMAND_LOGGED, True), (
        "of a drum that had no torque until now"
    )


def test_what_is_wrong_with_all_comes_before_a_channel(config: Config) -> None:
    late = {"unlogged": np.arange(N) == 2, "late": np.arange(N) == 2}
    found = lasting(config, 60.0, State.FAULT, **late)
    assert found is not None
    assert (found.requirement, found.alone) == (Requirement.DISARMED, False)


def test_a_condition_that_wanders_from_axis_to_axis(config: Config) -> None:
    looks = [seen(100.0 + 2 * k, unlogged=np.arange(N) == k) for k in range(3)]
    found = judged(config, *looks)
    assert found[1] is None
    assert found[2] is not None
    assert found[2].where == 2


def test_every_torque_is_compared_with_the_records(config: Config) -> None:
    """Those of the look before, since a tick is recorded after its torques were sent; and the one
    that acts, also of a drive that was sent none."""
    stage = Stage(config)
    axis, other = stage.wiring.axes[2], stage.wiring.axes[5]
    assert config.supervisor is not None
    tick = 0

    def told(mille: int) -> Claim:
        torque = np.array([mille / each.per_newton_metre for each in stage.wiring.axes])
        return claim(at_ms=float(tick), torque=torque)

    def look(sent: list[int], recorded: list[int], *, to: Any = (axis,)) -> list[int]:
        nonlocal tick
        tick += 1
        for each in stage.wiring.axes:
            for mille in sent if each in to else recorded:
                word = (mille & 0xFFFF) << each.torque.shift
                stage.heard[each.channel, each.sent].take([word], tick * MS)
        found = stage.observe(tick * MS, stage.heard, [told(mille) for mille in recorded])
        return np.flatnonzero(found.unlogged).tolist()

    for _ in range(5):
        assert look([100, 101], [100, 101]) == []
    assert look([-100, 101], [100, 101]) == []
    assert look([100, -101], [100, 101]) == [2], "one of two, and the one that acts"
    assert look([100, 101], [100, 101]) == [2]
    assert look([100, 101], [100, 101]) == []
    assert look([102, 99], [100, 101]) == []
    assert look([103], [104, 104]) == [], "by one it may differ: rounding"
    assert look([], [104, 104], to=(axis, other)) == [], "recorded a look later"
    for _ in range(4):
        look([], [200, 200], to=(axis, other))
    assert look([], [200, 200], to=(axis, other)) == [2, 5], "what stays is not what is recorded"
    many = [300 + 10 * k for k in range(40)]
    assert look(many, many) == []
    assert look(many, many) == [], "however many there are between two looks"


@pytest.mark.parametrize("mille", [1, -1, 100])
def test_what_is_sent_to_a_drive_without_measurements(config: Config, mille: int) -> None:
    old = {"measured_age": at(5, 21.0)}
    sent = {"mille": at(5, mille, 100)}
    found = judged(config, seen(**old, **sent))[0]
    assert found is not None
    assert (found.requirement, found.where) == (Requirement.STALE, 5)
    stop = claim(State.SAFE_STOP)
    none = {"mille": at(5, 0, 100)}
    assert judged(config, seen(100.0, stop, **old, **none)) == [None]
    for age in (20.0, 21.0):
        assert judged(config, seen(100.0, stop, **old, **sent, torque_age=at(5, age))) == [None]


@pytest.mark.parametrize("state", [*CONTROLLED, State.SAFE_STOP])
def test_control_without_an_enabled_drives_measurements(config: Config, state: State) -> None:
    """Whatever that drive is sent: a daemon that is right has stopped by then."""
    for age, enabled, broken in ((20.0, True, False), (21.0, True, True), (21.0, False, False)):
        given = {"enabled": at(5, float(enabled), 1.0) > 0.0, "mille": at(5, 0, 100)}
        (found,) = judged(config, seen(100.0, claim(state), measured_age=at(5, age), **given))
        assert (found is not None) is (broken and state in CONTROLLED)
        assert found is None or (found.requirement, found.where) == (Requirement.STALE, 5)


def test_a_cell_that_is_not_heard_any_more(config: Config) -> None:
    for given, where in (({"cell_age": at(3, 20.5)}, 3), ({"contact_age": 20.5}, NOWHERE)):
        found = judged(config, seen(**given))[0]
        assert found is not None
        assert (found.requirement, found.where) == (Requirement.STALE, where)
        assert judged(config, seen(said=claim(State.SAFE_STOP), **given)) == [None]


@pytest.mark.parametrize(
    ("pull", "error", "opposed"),
    [
        (61.0, 2.1, False),
        (61.0, -2.1, True),
        (-61.0, 2.1, True),
        (-61.0, -2.1, False),
        (60.0, -2.1, False),
        (61.0, -2.0, False),
    ],
)
def test_a_torque_against_the_reference(
    config: Config, pull: float, error: float, opposed: bool
) -> None:
    tension = 70.0
    said = claim(reference=np.full(N, tension + error), tension=np.full(N, tension))
    given = {"torque": np.full(N, tension + pull), "tension": np.full(N, tension)}
    looks = [seen(100.0 + k, replace(said, at_ns=(100 + k) * MS), **given) for k in (0, 50)]
    found = judged(config, *looks)[1]
    assert (found is not None) is opposed
    assert found is None or found.requirement is Requirement.OPPOSED


@pytest.mark.parametrize("beating", [True, False])
def test_a_torque_to_a_drive_that_does_not_answer(config: Config, beating: bool) -> None:
    """Enabled or not when it answered last. On a channel without a heartbeat it stops by itself."""
    disabled = at(5, 0.0, 1.0) > 0.0
    given = {"measured_age": at(5, 21.0), "enabled": disabled, "beating": at(5, beating, 1.0) > 0.0}
    (found,) = judged(config, seen(**given))
    assert (found is not None) is beating
    assert found is None or (found.requirement, found.where) == (Requirement.STALE, 5)


def opposing(at_ms: int, tension: float, pull: float) -> Observation:
    """A torque that is more, or less, than a tension beyond its reference, or below it."""
    error = -2.1 if pull > 0.0 else 2.1
    said = claim(reference=np.full(N, tension + error), tension=np.full(N, tension))
    forces = {"torque": np.full(N, tension + pull), "tension": np.full(N, tension)}
    return seen(float(at_ms), replace(said, at_ns=at_ms * MS), **forces)


@pytest.mark.parametrize("pull", [61.0, -61.0])
@pytest.mark.parametrize(("way", "opposed"), [(0.01, True), (0.0, True), (-0.01, False)])
def test_a_tension_that_goes_against_a_torque_is_not_driven_by_it(
    config: Config, pull: float, way: float, opposed: bool
) -> None:
    """A platform that is thrown takes the tension along, and the torque makes its drum follow.
    ``way``: N of each look in the direction of the torque."""
    step = way if pull > 0.0 else -way
    looks = [opposing(100 + 2 * k, 70.0 + step * k, pull) for k in range(10)]
    found = [verdict for verdict in judged(config, *looks[1:]) if verdict is not None]
    assert bool(found) is opposed
    assert {each.requirement for each in found} <= {Requirement.OPPOSED}


def test_a_tension_of_before_is_forgotten_with_all_else(config: Config) -> None:
    assert config.supervisor is not None
    for over in (Judge.forget, lambda judge: judge.rest(101 * MS)):
        judge = Judge(config, config.supervisor)
        assert judge(opposing(100, 80.0, 50.0)) is None
        over(judge)
        assert judge(opposing(102, 70.0, 61.0)) is None
        found = judge(opposing(107, 70.0, 61.0))
        assert found is not None
        assert found.requirement is Requirement.OPPOSED
