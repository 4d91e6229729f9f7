"""The supervisor's parts by themselves: every requirement on both sides of its limit, what it reads
of frames and records, when its heartbeat begins and ends."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import can
import numpy as np
import pytest
from can.interfaces.socketcan import SocketcanBus

from tonus.config import Config, load
from tonus.config.schema.bus import CanopenBus
from tonus.config.schema.bus.canopen import CellNode
from tonus.config.schema.supervisor import REQUIREMENT_TEXTS, Requirement
from tonus.drivers.fieldbus import RAW_FRAME
from tonus.runtime.recording.ring import RingReader, RingWriter
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import State
from tonus.runtime.supervisor.judge import NOWHERE, Judge, Violation
from tonus.runtime.supervisor.listener import Heard, Listener, Watched
from tonus.runtime.supervisor.observation import Observation, Observer
from tonus.runtime.supervisor.record import Claim, claims, of_ring
from tonus.runtime.supervisor.supervisor import Supervisor, _error, told
from tonus.runtime.supervisor.wiring import Value, Wiring

MS = 1_000_000
N = 8
STRICT = {
    "supervisor.period_ms": 2,
    "supervisor.timeout_ms": 22,
    "supervisor.patience_ms": 5,
    "supervisor.policy": "require",
}


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


# --- the judge -----------------------------------------------------------------------------------


def claim(state: State = State.ACTIVE, at_ms: float = 100.0, **given: Any) -> Claim:
    tension = np.full(N, 45.0)
    zero = np.zeros(N)
    tare, given_up = np.zeros(N + 1), np.zeros(N, bool)
    found = Claim(round(at_ms * MS), state, zero, tension, tension, tare, 0.0, 3210.0, given_up)
    return replace(found, **given)


def seen(at_ms: float = 100.0, said: Claim | None = None, **given: Any) -> Observation:
    """Everything in order at ``at_ms``, but for what is given."""
    said = claim(at_ms=at_ms) if said is None else said
    found = Observation(
        now_ns=round(at_ms * MS),
        axes=np.arange(N),
        enabled=np.ones(N, bool),
        rested=False,
        measured_age=np.zeros(N),
        torque_age=np.zeros(N),
        same=np.zeros(N, np.int64),
        mille=np.full(N, 100),
        torque=np.full(N, 45.0),
        rate=np.zeros(N),
        tension=np.full(N, 45.0),
        contact=0.0,
        cell_age=np.zeros(N),
        contact_age=0.0,
        defective=np.zeros(N, bool),
        contact_defective=False,
        unexplained=np.zeros(N),
        mean_torque=np.full(N, 45.0),
        swing=np.full(N, 0.2),
        jolt=np.zeros(N),
        claims=[said],
        claim=said,
        unlogged=np.zeros(N, bool),
    )
    return replace(found, **given)


def at(row: int, value: float, others: float = 0.0) -> Any:
    found = np.full(N, others)
    found[row] = value
    return found


def judged(config: Config, *looks: Observation) -> list[Violation | None]:
    assert config.supervisor is not None
    judge = Judge(config, config.supervisor)
    return [judge(look) for look in looks]


def lasting(config: Config, for_ms: float, state: State = State.ACTIVE, **given: Any) -> Any:
    """The verdict at the end of a condition that lasts."""
    first = seen(100.0, claim(state, 100.0), **given)
    last = seen(100.0 + for_ms, claim(state, 100.0 + for_ms), **given)
    return judged(config, first, last)[-1]


def test_a_robot_in_order_is_let_go_on(config: Config) -> None:
    for state in State:
        if state not in (State.OFF, State.STANDBY, State.FAULT):
            assert lasting(config, 1000.0, state) is None


SUDDEN = [
    (Requirement.TICK, {"said": claim(at_ms=94.0)}, {"said": claim(at_ms=96.0)}),
    (Requirement.TICK, {"said": claim(at_ms=106.0)}, {"said": claim(at_ms=104.0)}),
    (
        Requirement.TORQUE,
        {"torque_age": np.repeat([6.0, 5.0], [5, 3])},
        {"torque_age": np.repeat([6.0, 5.0], [4, 4])},
    ),
    (Requirement.TORQUE, {"torque_age": at(3, 151.0)}, {"torque_age": at(3, 149.0)}),
    (Requirement.FROZEN, {"same": np.repeat([6, 5], [5, 3])}, {"same": np.repeat([9, 5], [4, 4])}),
    (
        Requirement.STIFFNESS,
        {"said": claim(stiffness=5400.0)},
        {"said": claim(stiffness=5300.0)},
    ),
    (Requirement.STIFFNESS, {"said": claim(stiffness=float("nan"))}, {}),
    (
        Requirement.STIFFNESS,
        {"said": claim(stiffness=381.0)},
        {"said": claim(stiffness=382.0)},
    ),
    (Requirement.STALE, {"measured_age": at(5, 21.0)}, {"measured_age": at(5, 19.0)}),
]


@pytest.mark.parametrize(("requirement", "broken", "kept"), SUDDEN)
def test_what_is_judged_at_once(
    config: Config, requirement: Requirement, broken: Any, kept: Any
) -> None:
    found = judged(config, seen(**broken))[0]
    assert found is not None
    assert found.requirement is requirement
    assert judged(config, seen(**kept))[0] is None


FOR_A_WHILE = [
    (Requirement.OPPOSED, {"torque": at(1, -20.0, 45.0), "tension": at(1, 42.0, 45.0)}),
    (Requirement.OPPOSED, {"torque": at(1, 110.0, 45.0), "tension": at(1, 48.0, 45.0)}),
    (Requirement.TENSION, {"tension": at(6, 221.0, 45.0), "torque": at(6, 221.0, 45.0)}),
    (Requirement.MEASURED_LOGGED, {"tension": at(0, 61.0, 45.0)}),
    (Requirement.MEASURED_LOGGED, {"contact": 15.1}),
    (Requirement.MEASURED_LOGGED, {"contact": -15.1}),
]


@pytest.mark.parametrize(("requirement", "given"), FOR_A_WHILE)
def test_what_may_be_so_for_a_while(
    config: Config, requirement: Requirement, given: dict[str, Any]
) -> None:
    assert lasting(config, 4.0, **given) is None
    found = lasting(config, 5.0, **given)
    assert found is not None
    assert found.requirement is requirement
    assert lasting(config, 50.0, State.SAFE_STOP, **given) is None


@pytest.mark.parametrize("force", [27.6, -27.6])
def test_a_contact_that_the_daemon_records_too(config: Config, force: float) -> None:
    """On both sides of the bound, and in a stop."""
    for value, state, verdict in (
        (force, State.ACTIVE, Requirement.CONTACT),
        (force / 27.6 * 27.4, State.ACTIVE, None),
        (force, State.SAFE_STOP, None),
    ):
        said = [claim(state, at_ms=at_ms, contact=value) for at_ms in (100.0, 105.0)]
        looks = [seen(100.0, said[0], contact=value), seen(105.0, said[1], contact=value)]
        found = judged(config, *looks)[1]
        assert (found and found.requirement) == verdict


@pytest.mark.parametrize("value", [92.0, -92.0])
def test_a_torque_that_nothing_explains(config: Config, value: float) -> None:
    """In two looks: in one it may be a frame that was lost."""
    for given, state, verdict in (
        (value, State.ACTIVE, Requirement.UNEXPLAINED),
        (value / 92.0 * 91.0, State.ACTIVE, None),
        (value, State.SAFE_STOP, None),
    ):
        assert lasting(config, 1.9, state, unexplained=at(4, given)) is None
        found = lasting(config, 2.0, state, unexplained=at(4, given))
        assert (found and found.requirement) == verdict


NO_NUMBERS = [
    ("tension", Requirement.MEASURED_LOGGED, [State.ACTIVE]),
    ("reference", Requirement.OPPOSED, [State.ACTIVE]),
    ("tare", Requirement.MEASURED_LOGGED, [State.ACTIVE, State.SAFE_STOP]),
    ("contact", Requirement.MEASURED_LOGGED, [State.ACTIVE]),
]


def test_how_far_a_recorded_contact_is_off(config: Config) -> None:
    found = lasting(config, 5.0, contact=15.5)
    assert found is not None
    assert (found.where, found.value) == (NOWHERE, -15.5)


def test_most_drives_of_an_odd_number(config: Config) -> None:
    """Four of seven without a torque are more than half of them."""
    given = {"enabled": np.arange(N) < 7}
    for late, found in ((4, True), (3, False)):
        ages = np.where(np.arange(N) < late, 6.0, 0.0)
        verdict = judged(config, seen(torque_age=ages, **given))[0]
        assert (verdict is not None) is found


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


def test_a_tension_at_a_drive_that_is_not_enabled(config: Config) -> None:
    """Another drive's: the cables share the platform."""
    others = np.arange(N) != 6
    for state, tension, after in ((State.ACTIVE, 221.0, 5.0), (State.SAFE_STOP, 261.0, 110.0)):
        found = lasting(config, after, state, tension=at(6, tension, 45.0), enabled=others)
        assert found is not None
        assert (found.requirement, found.where) == (Requirement.TENSION, 6)


def test_rotation_of_the_platform(config: Config) -> None:
    """Rates made from a rotation about each axis in the middle."""
    geometry = config.robot.geometry
    frame, platform = np.array(geometry.frame), np.array(geometry.platform)
    along = (frame - platform) / np.linalg.norm(frame - platform, axis=1, keepdims=True)
    for state, after, slow, fast in (
        (State.ACTIVE, 5.0, 1.2, 2.2),
        (State.SAFE_STOP, 110.0, 6.0, 15.0),
    ):
        for axis in np.eye(3):
            arms = np.cross(platform, along) @ axis
            assert lasting(config, after, state, rate=slow * arms) is None
            found = lasting(config, after, state, rate=fast * arms)
            assert found is not None
            assert found.requirement is Requirement.SPEED


KEPT = [
    {"torque": at(1, -20.0, 45.0), "tension": at(1, 43.5, 45.0)},
    {"torque": at(1, -10.0, 45.0), "tension": at(1, 42.0, 45.0)},
    {"torque": at(1, 110.0, 45.0), "tension": at(1, 42.0, 45.0)},
    {"tension": at(6, 219.0, 205.0), "torque": np.full(N, 210.0)},
    {"contact": 14.9},
    {"tension": at(0, 59.0, 45.0)},
    {"tension": np.full(N, np.nan), "contact": float("nan"), "rate": np.full(N, np.nan)},
]


@pytest.mark.parametrize("given", KEPT, ids=range(len(KEPT)))
def test_what_is_within_its_limit(config: Config, given: dict[str, Any]) -> None:
    reference = claim(reference=np.full(N, 205.0)) if "205" in str(given) else None
    first = seen(100.0, said=reference, **given)
    if reference is not None:
        first = replace(first, claims=[], claim=replace(reference, tension=np.full(N, 205.0)))
    looks = [replace(first, now_ns=(100 + k) * MS, claim=replace(first.claim, at_ns=(100 + k) * MS))  # type: ignore[type-var]
             for k in range(20)]  # fmt: skip
    assert judged(config, *looks) == [None] * 20


def broken_looks(config: Config, pattern: str) -> int | None:
    """At which of the looks, 1 ms apart, a contact force that is beyond its bound where the pattern
    has an x is found."""
    said = [claim(at_ms=100.0 + k, contact=30.0) for k in range(len(pattern))]
    looks = [
        seen(100.0 + k, each, contact=30.0 if mark == "x" else 20.0)
        for k, (each, mark) in enumerate(zip(said, pattern, strict=True))
    ]
    verdicts = [found is not None for found in judged(config, *looks)]
    return verdicts.index(True) if any(verdicts) else None


@pytest.mark.parametrize(
    ("pattern", "found"),
    [
        ("xxxxxx", 5),
        ("xxxxx" + ".", None),
        ("xxxxx" + "....................." + "xxxxx", None),
        ("xxx.xxxx", 7),
        ("x." * 10, 14),
        ("x..." * 30, 80),
        ("x....." * 40, None),
        ("xxx" + "............" * 40, None),
        ("xxx" + "." * 200 + "xxxxxx", 208),
        ("x" + "....." + "xxxxxx", 11),
    ],
)
def test_a_condition_that_comes_and_goes(config: Config, pattern: str, found: int | None) -> None:
    """What lasts for more than a fifth of the time is found; a look now and then is forgotten."""
    assert broken_looks(config, pattern) == found


def test_what_held_before_the_robot_was_disarmed_is_over(config: Config) -> None:
    assert config.supervisor is not None
    judge = Judge(config, config.supervisor)
    contact = {"contact": 30.0}
    looks = [seen(100.0 + k, claim(at_ms=100.0 + k, contact=30.0), **contact) for k in range(5)]
    assert [judge(look) for look in looks] == [None] * 5
    judge.rest()
    later = [seen(109.0 + k, claim(at_ms=109.0 + k, contact=30.0), **contact) for k in range(5)]
    assert [judge(look) for look in later] == [None] * 5


@pytest.mark.parametrize(
    ("given", "requirement"),
    [
        ({"tension": at(6, 261.0, 45.0)}, Requirement.TENSION),
        ({"contact": 36.0}, Requirement.CONTACT),
        ({"rate": np.array([1, 1, 1, 1, -1, -1, -1, -1]) * 3.0}, Requirement.SPEED),
    ],
)
def test_the_wide_bounds_hold_in_a_stop_too(
    config: Config, given: dict[str, Any], requirement: Requirement
) -> None:
    assert lasting(config, 109.0, State.SAFE_STOP, **given) is None
    found = lasting(config, 110.0, State.SAFE_STOP, **given)
    assert found is not None
    assert found.requirement is requirement


def test_the_speed_of_the_drums_bounds_that_of_the_platform(config: Config) -> None:
    """Rates made from a motion of the platform in the middle: just within, and just beyond."""
    geometry = config.robot.geometry
    frame, platform = np.array(geometry.frame), np.array(geometry.platform)
    for speed, expected in ((0.274, None), (0.6, Requirement.SPEED)):
        for direction in np.eye(3):
            along = frame - platform
            rates = along @ (speed * direction) / np.linalg.norm(along, axis=1)
            found = lasting(config, 5.0, rate=rates, mille=np.full(N, 100))
            assert (found and found.requirement) == expected
    some = lasting(config, 5.0, rate=np.full(N - 1, 9.0))
    assert some is None, "some axes on another bus: not judged"


def test_the_speed_does_not_depend_on_the_order_of_the_drives(config: Config) -> None:
    geometry = config.robot.geometry
    along = np.array(geometry.frame) - np.array(geometry.platform)
    rates = along @ np.array([0.0, 0.0, 0.6]) / np.linalg.norm(along, axis=1)
    order = np.array([0, 4, 1, 5, 2, 6, 3, 7])
    found = [lasting(config, 200.0, rate=rates[axes], axes=axes) for axes in (np.arange(N), order)]
    assert found[0] is not None
    assert found[1] is not None
    assert found[1].value == pytest.approx(found[0].value)


def test_frozen_torques_outside_of_control(config: Config) -> None:
    same = {"same": np.full(N, 6)}
    assert judged(config, seen(said=claim(State.REFERENCING), **same)) == [None]
    for state in (State.REFERENCING, State.SAFE_STOP):
        found = judged(config, seen(said=claim(state), jolt=at(3, 0.031), **same))[0]
        assert found is not None
        assert found.requirement is Requirement.FROZEN
    silent = replace(seen(**same), claim=None, claims=[])
    assert [found and found.requirement for found in judged(config, silent)] == [Requirement.TICK]


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
        control = claim(State.ACTIVE, failed=failed)
        assert judged(config, seen(said=control, **given))[0] is not None


def test_a_cell_that_reports_its_own_defect(config: Config) -> None:
    """It is none to judge by while the daemon stops, and does not excuse a daemon that goes on."""
    bad = np.arange(N) == 3
    for given in (
        {"tension": at(3, 500.0, 45.0), "defective": bad},
        {"contact": 500.0, "contact_defective": True},
    ):
        assert lasting(config, 200.0, State.SAFE_STOP, **given) is None
        assert lasting(config, 200.0, State.ACTIVE, **given) is not None
    others = {"tension": at(3, 500.0, 45.0), "defective": ~bad}
    assert lasting(config, 200.0, State.SAFE_STOP, **others).where == 3
    other = {"contact": 500.0, "defective": np.ones(N, bool)}
    found = lasting(config, 200.0, State.SAFE_STOP, **other)
    assert found.requirement is Requirement.CONTACT


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


def test_a_drive_enabled_while_disarmed(config: Config) -> None:
    for state in (State.OFF, State.STANDBY, State.FAULT):
        assert lasting(config, 49.0, state) is None
        assert lasting(config, 50.0, state).requirement is Requirement.DISARMED


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
    judge.rest()
    assert judge(looks[1]) is None


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


# --- at the limits themselves --------------------------------------------------------------------

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


def test_frozen_torques_in_each_controlled_state(config: Config) -> None:
    for state in (State.PRETENSION, State.HOLD, State.ACTIVE):
        found = judged(config, seen(said=claim(state), same=np.full(N, 6)))[0]
        assert found is not None
        assert found.requirement is Requirement.FROZEN


def test_a_torque_in_any_of_the_newest_records_is_logged(config: Config) -> None:
    for state in (State.ACTIVE, State.SAFE_STOP):
        broken = {"unlogged": at(7, 1, 0) > 0}
        assert lasting(config, 2.9, state, **broken) is None
        found = lasting(config, 3.0, state, **broken)
        assert found is not None, "it compares what is a look old"
        assert (found.requirement, found.where) == (Requirement.COMMAND_LOGGED, 7)


def test_a_condition_that_wanders_from_axis_to_axis(config: Config) -> None:
    looks = [seen(100.0 + 2 * k, unlogged=np.arange(N) == k) for k in range(3)]
    found = judged(config, *looks)
    assert found[1] is None
    assert found[2] is not None
    assert found[2].where == 2


def test_every_torque_is_compared_with_the_records(config: Config) -> None:
    """Those of the look before, since a tick is recorded after its torques were sent; of a drive
    that was sent none, the last."""
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
    assert look([100, -101], [100, 101]) == []
    assert look([100, 101], [100, 101]) == [2], "one of two"
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
    none = {"mille": at(5, 0, 100)}
    assert judged(config, seen(**old, **none)) == [None]
    for age in (20.0, 21.0):
        assert judged(config, seen(**old, **sent, torque_age=at(5, age))) == [None]


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


def test_how_long_a_stop_may_last_and_how_long_it_did(config: Config) -> None:
    def stopping(at_ms: float) -> Observation:
        return seen(at_ms, claim(State.SAFE_STOP, at_ms))

    looks = judged(config, stopping(5_000), stopping(45_000), stopping(45_001))
    assert looks[:2] == [None, None]
    assert looks[2] is not None
    assert looks[2].value == pytest.approx(40.001)
    just = replace(stopping(45_000), now_ns=45_000 * MS + 1)
    assert judged(config, stopping(5_000), just)[1] is not None


@pytest.mark.parametrize("shift", [0.0, 0.12])
def test_the_bound_of_the_platforms_speed_is_the_least_over_the_poses(
    config: Config, shift: float
) -> None:
    """Against least squares at each of 27 poses, for motions with rotation and without; in a
    workspace whose middle is the frame's, and in another."""
    space = config.robot.workspace
    moved = {key: tuple(end + shift for end in getattr(space, key)) for key in ("x", "y", "z")}
    there = config.robot.model_copy(update={"workspace": space.model_copy(update=moved)})
    config = config.model_copy(update={"robot": there})
    geometry, space, settings = config.robot.geometry, config.robot.workspace, config.supervisor
    assert settings is not None
    turning = settings.model_copy(update={"rotation": 1e9, "rotation_stopping": 1e9})
    calm = config.model_copy(update={"supervisor": turning})
    frame, platform = np.array(geometry.frame), np.array(geometry.platform)
    middle = [0.5 * (low + high) for low, high in (space.x, space.y, space.z)]

    def rows(position: Any) -> Any:
        found = np.empty((N, 6))
        for cable in range(N):
            arm = frame[cable] - (position + platform[cable])
            found[cable, :3] = arm / np.linalg.norm(arm)
            found[cable, 3:] = np.cross(platform[cable], found[cable, :3])
        return found

    random = np.random.default_rng(4)
    for _ in range(20):
        twist = np.concatenate([random.normal(0.0, 2.0, 3), random.normal(0.0, 4.0, 3)])
        at_pose = np.array(middle) + random.uniform(-0.1, 0.1, 3)
        rates = rows(at_pose) @ twist
        least = np.inf
        for x in (-settings.spread, 0.0, settings.spread):
            for y in (-settings.spread, 0.0, settings.spread):
                for z in (-settings.spread, 0.0, settings.spread):
                    matrix = rows(np.add(middle, (x, y, z)))
                    solved = np.linalg.lstsq(matrix, rates, rcond=None)[0]
                    least = min(least, float(np.linalg.norm(solved[:3])))
        given = {"rate": rates, "unexplained": np.zeros(N)}
        found = lasting(calm, 200.0, **given)
        limit = 1.1 * config.control.envelope.speed_limit
        assert (found is not None) is (least > limit)
        assert found is None or found.value == pytest.approx(least, rel=1e-9)


# --- frames and records --------------------------------------------------------------------------


def test_numbers_of_a_frame() -> None:
    assert Value(16, 16).number(0xFFFE_0001) == -2
    assert Value(0, 16).unsigned(0xFFFE_8001) == 0x8001
    word = int.from_bytes(b"\0\0" + struct.pack("<f", -1.5), "little")
    assert Value(16, 32, real=True).number(word) == -1.5


class FakeBus(can.BusABC):
    """Gives what it is told, and keeps what is sent."""

    def __init__(self) -> None:
        self.waiting: list[can.Message] = []
        self.sent: list[can.Message] = []
        self.broken = False
        super().__init__("fake")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        assert timeout == 0, "it has no time to wait"
        if self.broken:
            raise can.CanOperationError("gone")
        return (self.waiting.pop(0) if self.waiting else None), True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        del timeout
        if self.broken:
            raise can.CanOperationError("gone")
        self.sent.append(msg)


WATCHED = [Watched(0x201, 4, (Value(16, 16),))]


def test_a_listener_on_messages() -> None:
    bus = FakeBus()
    listener = Listener(bus, WATCHED)
    good = can.Message(arbitration_id=0x201, is_extended_id=False, data=b"\x0f\0\5\0")
    bus.waiting = [
        good,
        good,
        can.Message(arbitration_id=0x201, is_extended_id=False, data=b"\x0f\0\7\0"),
        can.Message(arbitration_id=0x201, is_extended_id=False, data=b"\x0f\0\7"),
        can.Message(arbitration_id=0x201, is_extended_id=True, data=b"\x0f\0\x09\0"),
        can.Message(arbitration_id=0x202, is_extended_id=False, data=b"\x0f\0\x09\0"),
        can.Message(arbitration_id=0x201, is_extended_id=False, is_remote_frame=True, dlc=4),
        can.Message(arbitration_id=0x201, is_extended_id=False, is_error_frame=True, dlc=4),
    ]
    listener.read(7)
    heard = listener.heard[0x201]
    assert (heard.count, heard.same, heard.at_ns, heard.totals) == (3, 0, 7, [17.0])
    bus.waiting = [good] * 3
    listener.read(8)
    assert (heard.count, heard.same) == (6, 2)


def test_a_listener_on_arrays_of_frames() -> None:
    word = -1 << 32 | 0x0005_000F
    bus = FakeBus()
    bus.receive_frames = lambda _: np.array([(1, 0x201, 4, 0, 0, word)], RAW_FRAME)  # type: ignore[attr-defined]
    listener = Listener(bus, WATCHED)
    listener.read(9)
    assert listener.heard[0x201].totals == [5.0]
    assert listener.heard[0x201].word == 0xFFFF_FFFF_0005_000F


def test_frames_of_one_look_count_as_if_each_had_its_own() -> None:
    state = Value(0, 16)
    words = [
        off_or_on | number << 16
        for off_or_on, number in zip(
            (0x27, 0x27, 0x07, 0x40, 0x27, 0x27, 0x27), (1, 1, -2 & 0xFFFF, 3, 3, 3, 3), strict=True
        )
    ]
    together, apart = (Heard(4, (Value(16, 16),), state) for _ in range(2))
    together.take(words[:2], 1)
    together.take(words[2:], 2)
    for at, word in enumerate(words):
        apart.take([word], 1 + (at > 1))
    for name in Heard.__slots__:
        assert getattr(together, name) == getattr(apart, name)
    assert (together.count, together.same, together.off, together.totals) == (7, 2, 1, [12.0])


def test_a_channel_that_fails_in_mid_look_gives_what_came_before() -> None:
    bus = FakeBus()

    def fail(timeout: float | None = None) -> can.Message:
        if bus.waiting:
            return bus.waiting.pop()
        raise can.CanOperationError("gone")

    bus.waiting = [can.Message(arbitration_id=0x201, is_extended_id=False, data=bytes(4))]
    bus.recv = fail  # type: ignore[method-assign]
    listener = Listener(bus, WATCHED)
    with pytest.raises(can.CanOperationError):
        listener.read(7)
    assert (listener.heard[0x201].count, listener.heard[0x201].at_ns) == (1, 7)


def test_a_listener_takes_no_more_than_its_share_of_a_flood() -> None:
    bus = FakeBus()
    listener = Listener(bus, WATCHED)
    frame = can.Message(arbitration_id=0x201, is_extended_id=False, data=bytes(4))
    bus.waiting = [frame] * 5000
    listener.read(1)
    assert listener.heard[0x201].count == 4096


def test_a_listener_on_the_kernels_frames() -> None:
    frames = [struct.pack("<IB3x8s", 0x201, 4, b"\x0f\0\5\0")] * 5000

    def receive(_: int) -> bytes:
        assert blocking
        assert not blocking[-1]
        if not frames:
            raise BlockingIOError
        return frames.pop()

    bus = SocketcanBus.__new__(SocketcanBus)
    bus._is_shutdown = True
    blocking: list[bool] = []
    bus.socket = SimpleNamespace(setblocking=blocking.append, recv=receive)  # type: ignore[assignment]
    listener = Listener(bus, WATCHED)
    listener.read(1)
    assert listener.heard[0x201].count == 4096
    listener.read(2)
    assert listener.heard[0x201].count == 5000


def test_records_of_a_ring(tmp_path: Any) -> None:
    dtype = cycle_dtype(N)
    writer = RingWriter.create(tmp_path / "ring", dtype.itemsize, 16, {"kind": "record"})
    records = of_ring(RingReader.look(tmp_path / "ring"), N)
    record = np.zeros(1, dtype)
    for tick in range(3):
        record["stiffness"]["k_eq"] = 1000.0 + tick
        record["state"]["state"] = State.HOLD
        writer.publish(record.view(np.uint8), tick)
    assert [each.stiffness for each in claims(records())] == [1000.0, 1001.0, 1002.0]
    assert claims(records()) == []
    writer.close()


def test_wiring_of_an_axis_and_a_cell() -> None:
    """Identifiers, sizes and scales, by hand from the configuration: unlike axes, two signs."""
    robot = load("config/unlike_axes.yaml")[0].robot
    config = load("config/can.yaml")[0].model_copy(update={"robot": robot})
    assert isinstance(config.fieldbus, CanopenBus)
    wiring = Wiring(config)
    assert {config.robot.signs[axis.number] for axis in wiring.axes} == {1, -1}
    for axis in wiring.axes:
        train = config.robot.drive_trains[axis.number]
        node, sign = axis.number + 1, config.robot.signs[axis.number]
        assert (axis.sent, axis.received) == (0x200 + node, 0x180 + node)
        assert (axis.sent_bytes, axis.received_bytes) == (4, 8)
        turns = 1.0 / train.motor.increments_per_revolution / train.gearbox.ratio
        assert axis.metre == pytest.approx(sign * 3.14159265 * 2.0 * train.drum.radius * turns)
        motor = 1e-3 * train.motor.rated_torque
        assert axis.newton == pytest.approx(sign * motor * train.gearbox.ratio / train.drum.radius)
        assert axis.per_newton_metre == pytest.approx(sign / (motor * train.gearbox.ratio))
        assert axis.mass * train.drum.radius**2 == pytest.approx(train.drum.inertia)
        assert axis.damping * train.drum.radius**2 == pytest.approx(train.drum.viscous_friction)
    for cell in wiring.cells:
        assert (cell.received, cell.received_bytes) == (0x180 + 17 + cell.number, 4)
        assert cell.newton == 10.0**-config.fieldbus.force_cell.decimal_digits


def test_wiring_of_other_devices(config: Config) -> None:
    """A float for a force, an amplifier of several cells, a drive that alone knows its scale."""
    assert isinstance(config.fieldbus, CanopenBus)
    amplifier = CellNode(cells=(1, 0), node_id=17)
    channel = config.fieldbus.channels[0].model_copy(update={"force_cells": (amplifier,)})
    bus = config.fieldbus.model_copy(update={"channels": (channel,)})
    cells = Wiring(config.model_copy(update={"fieldbus": bus})).cells
    assert [(cell.number, cell.received, cell.force) for cell in cells] == [
        (1, 0x191, Value(0, 16)),
        (0, 0x191, Value(16, 16)),
    ]
    floats = config.fieldbus.force_cell.model_copy(update={"tpdo": (0x61300120,)})
    bus = config.fieldbus.model_copy(update={"force_cell": floats})
    real = Wiring(config.model_copy(update={"fieldbus": bus})).cells[0]
    assert (real.force.real, real.newton, real.received_bytes) == (True, 1.0, 4)
    mixed, _ = load("config/mixed_drives.yaml")
    assert any(axis.newton is None for axis in Wiring(mixed).axes)
    assert Wiring(load("config/ethercat.yaml")[0]).channels == []
    drive = config.fieldbus.every_profile["fieldbus.drive"].model_copy(
        update={"tpdo": (0x60410010,)}
    )
    with pytest.raises(ValueError, match="no PDO maps 0x6064"):
        Wiring(
            config.model_copy(
                update={"fieldbus": config.fieldbus.model_copy(update={"drive": drive})}
            )
        )


# --- observation ---------------------------------------------------------------------------------


class Stage:
    """The frames of every axis and cell, at times of the test's own."""

    def __init__(self, config: Config) -> None:
        assert config.supervisor is not None
        self.wiring = Wiring(config)
        self.heard: dict[tuple[str, int], Heard] = {}
        for axis in self.wiring.axes:
            self.heard[axis.channel, axis.sent] = Heard(4, (axis.torque,))
            self.heard[axis.channel, axis.received] = Heard(8, (axis.position,), axis.statusword)
        for cell in self.wiring.cells:
            self.heard[cell.channel, cell.received] = Heard(4, (cell.force,))
            self.heard[cell.channel, cell.emergency] = Heard(8, ())
        self.observe = Observer(self.wiring, config.supervisor, config.robot.contact_cell, MS)

    def tick(self, now_ns: int, *, newton: float, metre: float, force: float) -> None:
        for axis in self.wiring.axes:
            assert axis.newton is not None
            mille = round(newton / axis.newton) & 0xFFFF
            self.heard[axis.channel, axis.sent].take([mille << axis.torque.shift | 0xF], now_ns)
            place = round(metre / axis.metre) & 0xFFFFFFFF
            word = place << axis.position.shift | 0x0237
            self.heard[axis.channel, axis.received].take([word], now_ns)
        for cell in self.wiring.cells:
            self.heard[cell.channel, cell.received].take([round(force / cell.newton)], now_ns)


def test_what_neither_tension_nor_motion_explain(config: Config) -> None:
    """A drum that accelerates as its torque, its cable and its bearings have it is explained; the
    same with 100 N more torque is not, by 100 N."""
    stage, extra = Stage(config), Stage(config)
    axis = stage.wiring.axes[0]
    acceleration, force = 2.0, 45.0
    for k in range(40):
        t = k * 1e-3
        metre, rate = 0.5 * acceleration * t * t, acceleration * t
        pull = force + axis.mass * acceleration + axis.damping * rate
        for each, more in ((stage, 0.0), (extra, 100.0)):
            each.tick(k * MS, newton=pull + more, metre=metre, force=force)
        if k % 2 == 0:
            found = stage.observe(k * MS, stage.heard, [claim(at_ms=k)])
            other = extra.observe(k * MS, extra.heard, [claim(at_ms=k)])
            if k < 16:
                assert np.isnan(found.unexplained).all()
    assert found.rate == pytest.approx(acceleration * 0.037, rel=0.02)
    assert np.abs(found.unexplained).max() < 2.0
    assert other.unexplained == pytest.approx(100.0, abs=2.5)
    assert found.tension == pytest.approx(force)
    assert found.enabled.all()


@pytest.mark.parametrize("phase_ns", [-50_000, 0, 50_000])
def test_the_rate_does_not_depend_on_when_it_looks(config: Config, phase_ns: int) -> None:
    """Where PDOs arrive just when it looks, one look has one more of them than another."""
    stage = Stage(config)
    ticks = iter(range(200))
    tick = next(ticks)
    random = np.random.default_rng(3)
    for look in range(60):
        now_ns = look * 2 * MS + phase_ns + int(random.integers(-60_000, 60_000))
        while tick * MS <= now_ns:
            stage.tick(tick * MS, newton=45.0, metre=0.226e-3 * tick, force=45.0)
            tick = next(ticks)
        found = stage.observe(now_ns, stage.heard, [claim(at_ms=2.0 * look)])
        if look >= 10:
            assert found.rate == pytest.approx(0.226, rel=0.01)
            assert np.abs(found.unexplained).max() < 10.0


@pytest.mark.parametrize(("lost", "looks"), [(20, 2), (21, 2)])
def test_a_frame_that_is_lost_shows_in_single_looks(config: Config, lost: int, looks: int) -> None:
    """At either end of the window, so never in two looks in a row."""
    stage, beyond = Stage(config), []
    axis = stage.wiring.axes[0]
    for tick in range(60):
        before = stage.heard[axis.channel, axis.received]
        if tick == lost:
            stage.heard[axis.channel, axis.received] = Heard(8, (axis.position,), axis.statusword)
        stage.tick(tick * MS, newton=45.0, metre=0.226e-3 * tick, force=45.0)
        stage.heard[axis.channel, axis.received] = before
        if tick % 2 == 1:
            found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
            beyond.append(abs(found.unexplained[0]) > 40.0)
    assert 0 < sum(beyond) <= looks
    assert not any(first and second for first, second in pairwise(beyond))


def test_answers_that_come_too_often_do_not_slow_a_drum(config: Config) -> None:
    """Two SYNCs a tick, or a drive that sends each of its PDOs twice."""
    stage = Stage(config)
    for tick in range(40):
        for half in (0.0, 0.5):
            stage.tick(tick * MS, newton=45.0, metre=0.5e-3 * (tick + half), force=45.0)
        if tick % 2:
            found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
    assert found.rate == pytest.approx(0.5, rel=0.02)


def test_a_tick_as_long_as_the_time_between_two_looks(config: Config) -> None:
    """Some looks find no new answer, and others two."""
    stage, random = Stage(config), np.random.default_rng(2)
    assert config.supervisor is not None
    stage.observe = Observer(stage.wiring, config.supervisor, config.robot.contact_cell, 2 * MS)
    tick = 0
    for look in range(60):
        now_ns = 2 * MS * look + int(random.integers(-60_000, 60_000))
        while 2 * MS * tick <= now_ns:
            stage.tick(now_ns, newton=45.0, metre=0.4e-3 * tick, force=45.0)
            tick += 1
        found = stage.observe(now_ns, stage.heard, [claim(at_ms=2.0 * look)])
        if look >= 10:
            assert found.rate == pytest.approx(0.2, rel=0.02)
            assert np.abs(found.unexplained).max() < 10.0


@pytest.mark.parametrize("quick", [True, False])
def test_a_drive_in_quick_stop_is_powered(config: Config, quick: bool) -> None:
    """In a reaction to a fault it is not the daemon's any more, and that ends by itself."""
    stage = Stage(config)
    axis = stage.wiring.axes[2]
    heard = stage.heard[axis.channel, axis.received]
    assert not heard.powered
    heard.take([(0x0207 if quick else 0x020F) << axis.statusword.shift], 1)
    assert heard.powered is quick
    heard.take([0x0237 << axis.statusword.shift], 2)
    assert heard.powered
    heard.take([0x0233 << axis.statusword.shift], 3)
    assert not heard.powered
    assert heard.off == 2 - quick


def test_drives_that_were_without_power_between_two_looks(config: Config) -> None:
    """However short: every one of them, and not only some."""
    stage = Stage(config)

    def send(word: int, axes: Any) -> None:
        for axis in axes:
            received = stage.heard[axis.channel, axis.received]
            received.take([word << axis.statusword.shift], 1)

    axes = stage.wiring.axes
    send(0x0237, axes)
    assert not stage.observe(MS, stage.heard, [claim()]).rested
    send(0x0240, axes[:7])
    send(0x0237, axes)
    assert not stage.observe(2 * MS, stage.heard, [claim()]).rested
    send(0x0240, axes)
    send(0x0237, axes)
    found = stage.observe(3 * MS, stage.heard, [claim()])
    assert found.rested
    assert found.enabled.all()
    assert not stage.observe(4 * MS, stage.heard, [claim()]).rested


def test_positions_that_stop_to_arrive(config: Config) -> None:
    """No division by nothing: the drum is taken to rest once an answer is missing."""
    stage = Stage(config)
    for tick in range(20):
        stage.tick(tick * MS, newton=45.0, metre=0.1e-3 * tick, force=45.0)
        found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
    assert found.rate == pytest.approx(0.1, rel=0.02)
    for tick in range(20, 30, 2):
        found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
    assert found.rate.tolist() == [0.0] * N


def test_how_far_a_force_and_a_drum_go_while_the_torques_stay(config: Config) -> None:
    stage = Stage(config)
    metre, swings, jolts = 0.0, [], []
    for tick in range(60):
        speed = 0.1 + 0.002 * tick
        metre += speed * 1e-3
        newton = 45.0 + min(tick, 30)
        stage.tick(tick * MS, newton=newton, metre=metre, force=45.0 + 0.1 * tick)
        found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
        swings.append(found.swing.max())
        jolts.append(found.jolt.max())
    assert max(swings[:31]) == 0.0
    assert max(jolts[:31]) == 0.0
    assert swings[31:] == pytest.approx(0.1 * np.arange(1, 30), abs=0.02)
    assert jolts[31:] == pytest.approx(0.002 * np.arange(1, 30), abs=0.003), "an encoder's count"


def test_a_drive_that_alone_knows_its_scale(config: Config) -> None:
    """Neither its torque nor its drum's rate is judged."""
    stage = Stage(config)
    stage.wiring.axes = [replace(axis, newton=None, metre=None) for axis in stage.wiring.axes]
    assert config.supervisor is not None
    stage.observe = Observer(stage.wiring, config.supervisor, config.robot.contact_cell, MS)
    for tick in range(40):
        for axis in stage.wiring.axes:
            stage.heard[axis.channel, axis.sent].take([100 << axis.torque.shift], tick * MS)
            stage.heard[axis.channel, axis.received].take([tick << axis.position.shift], tick * MS)
        found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
    assert np.isnan(found.rate).all()
    assert np.isnan(found.torque).all()
    assert judged(config, seen(rate=found.rate, same=np.full(N, 6), swing=np.zeros(N))) == [None]


def test_before_anything_was_heard(config: Config) -> None:
    stage = Stage(config)
    found = stage.observe(MS, stage.heard, [])
    assert not found.enabled.any()
    assert np.isinf(found.torque_age).all()
    assert np.isnan(found.tension).all()
    assert np.isnan(found.contact)
    again = stage.observe(2 * MS, stage.heard, [claim()])
    assert np.isnan(again.tension).all()


@pytest.mark.parametrize("force", [float("nan"), float("inf"), float("-inf")])
def test_a_force_that_is_no_number_is_beyond_every_bound(config: Config, force: float) -> None:
    stage = Stage(config)
    assert config.supervisor is not None
    sound = stage.wiring.cells
    stage.wiring.cells = [
        replace(cell, force=Value(cell.force.shift, 32, real=True), newton=1.0) for cell in sound
    ]
    stage.observe = Observer(stage.wiring, config.supervisor, config.robot.contact_cell, MS)
    word = int.from_bytes(struct.pack("<f", force), "little")
    for cell in stage.wiring.cells:
        stage.heard[cell.channel, cell.received] = Heard(8, (cell.force,))
        stage.heard[cell.channel, cell.received].take([word << cell.force.shift], 0)
    found = stage.observe(MS, stage.heard, [claim()])
    assert (found.tension == np.inf).all()
    assert found.contact == np.inf
    assert found.cell_age.tolist() == [1.0] * N
    assert found.contact_age == 1.0


def test_a_cell_is_defective_until_its_amplifier_takes_the_error_back(config: Config) -> None:
    stage = Stage(config)
    cells = {cell.number: cell for cell in stage.wiring.cells}
    assert cells[2].emergency == 0x080 + 17 + 2
    for number in (2, config.robot.contact_cell):
        emergency = stage.heard[cells[number].channel, cells[number].emergency]
        for code, bad in ((0, False), (0x5010, True), (0x1000, True), (0, False)):
            emergency.take([code | 0x81 << 16], MS)
            found = stage.observe(MS, stage.heard, [claim()])
            assert found.contact_defective is (bad and number != 2)
            assert found.defective.tolist() == [bad and number == axis for axis in range(N)]


@pytest.mark.parametrize("force", [float("nan"), float("inf")])
def test_a_force_that_is_no_number_once_is_in_no_sum(force: float) -> None:
    value = Value(0, 32, real=True)
    heard = Heard(4, (value,))
    for each in (1.5, force, 2.5):
        heard.take([int.from_bytes(struct.pack("<f", each), "little")], 1)
    assert heard.totals == [4.0]
    assert heard.count == 3


def test_cells_on_another_bus(config: Config) -> None:
    stage = Stage(config)
    assert config.supervisor is not None
    stage.wiring.cells = []
    stage.observe = Observer(stage.wiring, config.supervisor, config.robot.contact_cell, MS)
    for k in range(30):
        stage.tick(k * MS, newton=45.0, metre=0.0, force=45.0)
        found = stage.observe(k * MS, stage.heard, [claim()])
    assert np.isnan(found.tension).all()
    assert np.isnan(found.unexplained).all()
    assert np.isnan(found.contact)
    assert not found.cell_age.any()
    assert found.contact_age == 0.0


# --- heartbeat -----------------------------------------------------------------------------------


class Watchdog:
    """A supervisor with a bus for each channel, and what it is given."""

    def __init__(self, config: Config) -> None:
        self.buses: list[FakeBus] = []
        self.records: list[tuple[int, Any]] = []
        self.state = State.SAFE_STOP
        self.supervisor = Supervisor(config, self._new, self._open)
        self.wiring = Wiring(config)

    def _open(self, *_: Any) -> can.BusABC:
        self.buses.append(FakeBus())
        return self.buses[-1]

    def _new(self) -> list[tuple[int, Any]]:
        new, self.records = self.records, []
        return new

    def step(
        self, now_ms: int, *, enabled: bool, tick: bool = True, deaf: Any = ()
    ) -> list[tuple[int, bytes]]:
        """What the first channel was sent in this step. Identifiers in ``deaf`` do not arrive; on
        the other channels no drive is enabled."""
        place = {channel: number for number, (_, channel, _) in enumerate(self.wiring.channels)}
        frames = {
            (cell.channel, cell.received): bytes(cell.received_bytes) for cell in self.wiring.cells
        }
        for axis in self.wiring.axes:
            word = 0x0237 if enabled and place[axis.channel] == 0 else 0x0240
            data = word.to_bytes(2, "little") + bytes(axis.received_bytes - 2)
            frames[axis.channel, axis.received] = data
            frames[axis.channel, axis.sent] = bytes(axis.sent_bytes)
        for (channel, identifier), data in frames.items():
            if (channel, identifier) not in deaf:
                self.buses[place[channel]].waiting.append(
                    can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
                )
        if tick:
            record = np.zeros(1, cycle_dtype(N))
            record["state"]["state"] = self.state
            self.records.append((now_ms * MS, record[0]))
        before = len(self.buses[0].sent)
        self.supervisor.step(now_ms * MS)
        return [(m.arbitration_id, bytes(m.data)) for m in self.buses[0].sent[before:]]

    def steps(self, start: int, stop: int, **given: Any) -> Iterator[list[tuple[int, bytes]]]:
        for now in range(start, stop, 2):
            yield self.step(now, **given)


BEAT = [(0x77E, b"\5")]


@pytest.fixture
def watchdog(config: Config) -> Iterator[Watchdog]:
    made = Watchdog(config)
    yield made
    made.supervisor.close()


def test_the_heartbeat_begins_when_nothing_was_enabled_for_a_while(watchdog: Watchdog) -> None:
    assert all(sent == [] for sent in watchdog.steps(0, 300, enabled=False))
    assert watchdog.step(300, enabled=False) == BEAT
    assert watchdog.step(302, enabled=True) == BEAT


def test_a_supervisor_that_finds_the_robot_armed_stays_silent(watchdog: Watchdog) -> None:
    assert all(sent == [] for sent in watchdog.steps(0, 2000, enabled=True))
    assert not watchdog.supervisor.beating


def test_a_violation_ends_it_and_quiet_begins_it_again(watchdog: Watchdog) -> None:
    list(watchdog.steps(0, 310, enabled=False))
    assert watchdog.step(310, enabled=True) == BEAT
    assert watchdog.step(312, enabled=True, tick=False) == BEAT
    sent = list(watchdog.steps(314, 700, enabled=True, tick=False))
    number = sent.index([]) - 1
    identifier, data = sent[number][0]
    code, register, place, value = struct.unpack("<HBBf", data)
    assert (identifier, code, register, place) == (0x0FE, 0xFF01, 0x81, 0xFF)
    assert value == pytest.approx(6.0)
    assert sent[number + 1 :] == [[]] * (len(sent) - number - 1)
    violation = watchdog.supervisor.violation
    assert violation is not None
    assert told(violation).startswith("SUP-1, 6: broken is: ")
    assert all(quiet == [] for quiet in watchdog.steps(700, 1000, enabled=False))
    assert watchdog.step(1000, enabled=False) == BEAT
    assert watchdog.supervisor.violation is None


def everything(watchdog: Watchdog) -> set[tuple[str, int]]:
    axes, cells = watchdog.wiring.axes, watchdog.wiring.cells
    heard = {(axis.channel, axis.received) for axis in axes}
    heard |= {(axis.channel, axis.sent) for axis in axes}
    return heard | {(cell.channel, cell.received) for cell in cells}


def test_it_does_not_begin_where_anything_does_not_arrive(config: Config) -> None:
    for missing in sorted(everything(Watchdog(config))):
        watchdog = Watchdog(config)
        silent = watchdog.steps(0, 400, enabled=False, deaf={missing})
        assert all(sent == [] for sent in silent), missing
        assert watchdog.step(400, enabled=False) == BEAT


def test_one_that_goes_deaf_while_the_robot_is_armed_falls_silent(watchdog: Watchdog) -> None:
    list(watchdog.steps(0, 310, enabled=False))
    assert watchdog.step(310, enabled=True) == BEAT
    deaf = everything(watchdog)
    sent = list(watchdog.steps(312, 1000, enabled=True, deaf=deaf))
    assert BEAT not in sent[11:], "20 ms without a drive, then at once"
    assert watchdog.supervisor.violation is not None
    assert watchdog.supervisor.violation.requirement is Requirement.TORQUE


def test_one_that_goes_deaf_while_nothing_is_enabled_falls_silent(watchdog: Watchdog) -> None:
    """Later than while the robot is armed: a daemon that begins anew takes its time."""
    list(watchdog.steps(0, 310, enabled=False))
    deaf = everything(watchdog)
    sent = list(watchdog.steps(310, 700, enabled=False, deaf=deaf))
    assert sent == [BEAT] * 150 + [[]] * 45, "0.3 s"
    assert watchdog.step(700, enabled=True, deaf=deaf) == []
    assert list(watchdog.steps(702, 1004, enabled=False))[-1] == BEAT


def on(watchdog: Watchdog, channel: str) -> set[tuple[str, int]]:
    """What the devices of a channel send."""
    wiring = watchdog.wiring
    return {
        (each.channel, each.received)
        for each in (*wiring.axes, *wiring.cells)
        if each.channel == channel
    }


@pytest.mark.parametrize(("enabled", "beats"), [(False, 150), (True, 9)])
def test_a_channel_on_which_nothing_answers_gets_no_heartbeat(
    watchdog: Watchdog, enabled: bool, beats: int
) -> None:
    """Its drives are to stop; those of the other channels belong to the daemon's stop. What the
    daemon sends is heard still: a host receives its own frames."""
    list(watchdog.steps(0, 310, enabled=False))
    _, channel, _ = watchdog.wiring.channels[1]
    before = [len(bus.sent) for bus in watchdog.buses]
    list(watchdog.steps(310, 700, enabled=enabled, deaf=on(watchdog, channel)))
    sent = [len(bus.sent) - count for bus, count in zip(watchdog.buses, before, strict=True)]
    assert sent == [195, beats, 195, 195]
    if enabled:
        list(watchdog.steps(700, 1000, enabled=True))
        assert len(watchdog.buses[1].sent) == before[1] + beats, "not while a drive is enabled"
    list(watchdog.steps(1000, 1304, enabled=False))
    assert len(watchdog.buses[1].sent) > before[1] + beats


def test_a_drive_that_was_enabled_and_is_silent_is_enabled_still(watchdog: Watchdog) -> None:
    axis = watchdog.wiring.axes[0]
    list(watchdog.steps(0, 310, enabled=False))
    assert watchdog.step(310, enabled=True) == BEAT
    alone = {(axis.channel, axis.received)}
    assert all(sent == BEAT for sent in watchdog.steps(312, 400, enabled=False, deaf=alone))
    sent = list(watchdog.steps(400, 800, enabled=False, deaf=alone, tick=False))
    assert sent[-1] == []
    violation = watchdog.supervisor.violation
    assert violation is not None
    assert violation.requirement is Requirement.TICK
    assert list(watchdog.steps(800, 1104, enabled=False))[-1] == BEAT
    assert watchdog.step(1104, enabled=True) == BEAT
    watchdog.state = State.FAULT
    pulled = watchdog.steps(1106, 2000, enabled=False, deaf=alone)
    assert all(sent == BEAT for sent in pulled), "the daemon is disarmed, and so are the others"


def test_what_held_is_over_when_the_drives_are_disabled(watchdog: Watchdog) -> None:
    """Twice 40 ms in a state in which no drive may be enabled for 50."""
    list(watchdog.steps(0, 310, enabled=False))
    watchdog.state = State.FAULT
    for start in (310, 352):
        assert all(sent == BEAT for sent in watchdog.steps(start, start + 40, enabled=True))
        assert watchdog.step(start + 40, enabled=False) == BEAT


def test_a_bus_that_is_gone_raises_nothing(watchdog: Watchdog) -> None:
    list(watchdog.steps(0, 310, enabled=False))
    watchdog.buses[1].broken = True
    assert watchdog.step(310, enabled=False) == BEAT
    assert watchdog.buses[2].sent


def test_where_there_is_none(config: Config) -> None:
    for settings in (None, config.supervisor.model_copy(update={"policy": "off"})):  # type: ignore[union-attr]
        with pytest.raises(ValueError, match="no supervisor"):
            Supervisor(
                config.model_copy(update={"supervisor": settings}), list, lambda *_: FakeBus()
            )


def test_an_axis_is_told() -> None:
    text = told(Violation(Requirement.TENSION, 3, 261.0))
    assert text == f"SUP-6 at axis 3, 261: broken is: {REQUIREMENT_TEXTS[Requirement.TENSION]}"


def test_one_that_looks_too_late_itself(config: Config) -> None:
    for late_ms, found in ((9, False), (10, True)):
        watchdog = Watchdog(config)
        list(watchdog.steps(0, 310, enabled=False))
        list(watchdog.steps(310, 330, enabled=True))
        sent = watchdog.step(328 + late_ms, enabled=True)
        assert (sent != BEAT) is found
        if found:
            code, _, _, value = struct.unpack("<HBBf", sent[0][1])
            assert (code, value) == (0xFF18, 10.0)
            assert watchdog.step(340, enabled=True) == []
        watchdog.supervisor.close()


@pytest.mark.parametrize(
    ("value", "sent"), [(3.0, 3.0), (1e39, np.inf), (-1e39, -np.inf), (np.inf, np.inf)]
)
def test_a_value_that_is_too_large_for_its_frame(value: float, sent: float) -> None:
    frame = _error(Violation(Requirement.TENSION, 3, value))
    assert struct.unpack("<HBBf", frame) == (0xFF06, 0x81, 3, sent)
    assert np.isinf(struct.unpack("<f", _error(Violation(Requirement.TENSION, 3, np.nan))[4:])[0])


def test_a_violation_at_an_axis_names_it(watchdog: Watchdog) -> None:
    axis = watchdog.wiring.axes[1]
    list(watchdog.steps(0, 310, enabled=False))
    steps = watchdog.steps(310, 600, enabled=True, deaf={(axis.channel, axis.sent)})
    sent = [frame for step in steps for frame in step]
    _, data = next(each for each in sent if each[0] == 0x0FE)
    code, _, place, _ = struct.unpack("<HBBf", data)
    assert (code, place) == (0xFF02, 1)
