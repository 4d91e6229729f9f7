"""The judge: every requirement on both sides of its limit, and how long a condition may hold."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.unit.supervisor_setup import (
    MS,
    STRICT,
    N,
    at,
    claim,
    judged,
    lasting,
    seen,
)
from tonus.config import Config, load
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import State, StopMode
from tonus.runtime.supervisor.judge import Judge, Violation


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


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


def test_most_drives_of_an_odd_number(config: Config) -> None:
    """Four of seven without a torque are more than half of them."""
    given = {"enabled": np.arange(N) < 7}
    for late, found in ((4, True), (3, False)):
        ages = np.where(np.arange(N) < late, 6.0, 0.0)
        verdict = judged(config, seen(torque_age=ages, **given))[0]
        assert (verdict is not None) is found


def test_a_tension_at_a_drive_that_is_not_enabled(config: Config) -> None:
    """Another drive's: the cables share the platform."""
    others = np.arange(N) != 6
    for state, tension, after in ((State.ACTIVE, 221.0, 5.0), (State.SAFE_STOP, 261.0, 20.0)):
        found = lasting(config, after, state, tension=at(6, tension, 45.0), enabled=others)
        assert found is not None
        assert (found.requirement, found.where) == (Requirement.TENSION, 6)


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


@pytest.mark.parametrize("again_ms", [124.0, 166.0, 168.0])
def test_what_was_broken_before_is_found_no_later_than_at_first(
    config: Config, again_ms: float
) -> None:
    """Looks 22 ms apart in between, in which it is not: the time that counts ends at a period below
    zero, which the next look makes up for, and is forgotten with the second."""
    between = [each for each in (122.0, 144.0, 166.0) if each < again_ms]
    times = [100.0, *between, *np.arange(again_ms, again_ms + 120.0, 2.0)]
    looks = [
        seen(
            at_ms,
            claim(State.SAFE_STOP, at_ms),
            contact=20.0 if at_ms in between else 36.0,
        )
        for at_ms in times
    ]
    found = [verdict is not None for verdict in judged(config, *looks)]
    assert times[found.index(True)] == again_ms + 110.0


@pytest.mark.parametrize(
    ("given", "after", "requirement"),
    [
        ({"tension": at(6, 261.0, 45.0)}, 20.0, Requirement.TENSION),
        ({"tension": at(6, 260.0, 45.0)}, 200.0, None),
        ({"contact": 36.0}, 110.0, Requirement.CONTACT),
    ],
)
def test_the_wide_bounds_hold_in_a_stop_too(
    config: Config, given: dict[str, Any], after: float, requirement: Requirement | None
) -> None:
    assert lasting(config, after - 0.1, State.SAFE_STOP, **given) is None
    found = lasting(config, after, State.SAFE_STOP, **given)
    assert (found and found.requirement) == requirement


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


@pytest.mark.parametrize(("defects", "found"), [(3, False), (4, True), (8, True)])
def test_cells_that_report_a_defect_and_are_most(config: Config, defects: int, found: bool) -> None:
    """A supply that dips makes all amplifiers report one, and go on measuring. One that breaks with
    all of its cells shows the end of their range."""
    given = {"tension": np.full(N, 300.0), "defective": np.arange(N) < defects}
    given["tension"][defects:] = 45.0
    verdict = lasting(config, 20.0, State.SAFE_STOP, **given)
    assert (verdict is not None and verdict.requirement is Requirement.TENSION) is found
    given["tension"][:defects] = 400.1
    assert lasting(config, 300.0, State.SAFE_STOP, **given) is None
    given["tension"][0] = 400.0
    assert (lasting(config, 20.0, State.SAFE_STOP, **given) is not None) is found


@pytest.mark.parametrize(
    ("contact", "found"), [(34.9, False), (35.1, True), (-70.0, True), (70.1, False)]
)
def test_a_contact_cell_that_reports_a_defect_and_shows_a_contact(
    config: Config, contact: float, found: bool
) -> None:
    """What breaks shows the end of its range; what a person may bear is a contact."""
    given = {"contact": contact, "contact_defective": True}
    assert lasting(config, 109.0, State.SAFE_STOP, **given) is None
    verdict = lasting(config, 110.0, State.SAFE_STOP, **given)
    assert (verdict is not None and verdict.requirement is Requirement.CONTACT) is found


def test_a_contact_cell_whose_reading_is_no_number(config: Config) -> None:
    for contact in (math.nan, math.inf):
        given = {"contact": contact, "contact_defective": True}
        assert lasting(config, 200.0, State.SAFE_STOP, **given) is None


@pytest.mark.parametrize(
    ("tension", "for_ms", "found"),
    [(219.0, 300.0, False), (221.0, 219.0, False), (221.0, 220.0, True), (261.0, 20.0, True)],
)
@pytest.mark.parametrize("mode", [StopMode.ON_PATH, StopMode.DESCENT, StopMode.PASSIVE])
def test_how_long_a_stop_may_pull(
    config: Config, mode: StopMode, tension: float, for_ms: float, found: bool
) -> None:
    said = claim(State.SAFE_STOP, stop_mode=mode, reference=at(3, 200.0, 45.0))
    given = {"tension": at(3, tension, 45.0), "torque": at(3, 12.0, 12.0)}
    looks = [
        seen(at_ms, replace(said, at_ns=round(at_ms * MS)), **given)
        for at_ms in (100.0, 100.0 + for_ms)
    ]
    verdict = judged(config, *looks)[-1]
    tense = verdict is not None and verdict.requirement is Requirement.TENSION
    assert tense is found


@pytest.mark.parametrize(("tension", "found"), [(200.0 * 1.1, False), (221.0, True)])
@pytest.mark.parametrize("state", [State.OFF, State.STANDBY, State.FAULT])
def test_a_robot_at_rest_that_was_not_controlled_has_no_such_tension(
    config: Config, state: State, tension: float, found: bool
) -> None:
    """Closed brakes keep what each burst of several adds. After control the drives may be on their
    way to be switched off."""
    assert config.supervisor is not None
    for rested in (True, False):
        judge = Judge(config, config.supervisor)
        if rested:
            judge.forget()
        given = {"tension": at(3, tension, 45.0), "torque": np.zeros(N), "mille": np.zeros(N, int)}
        looks = [seen(at_ms, claim(state, at_ms), **given) for at_ms in (100.0, 104.9, 105.0)]
        verdicts = [judge(look) for look in looks]
        assert verdicts[:2] == [None, None]
        assert (verdicts[2] is not None) is (found and rested)
    disabled = {
        "tension": at(3, 300.0, 45.0),
        "enabled": np.arange(N) == 4,
        "mille": np.zeros(N, int),
    }
    judge.forget()
    looks = [seen(at_ms, claim(state, at_ms), **disabled) for at_ms in (200.0, 205.0)]
    assert [judge(look) for look in looks] == [None, None], "a brake alone holds it"


@pytest.mark.parametrize(("name", "found"), [("can", False), ("ethercat", True)])
def test_a_torque_that_no_record_has_in_one_look_of_ten(name: str, found: bool) -> None:
    """Frames that are lost make some on CAN, but do not make a drive's own figure another."""
    config, _ = load(f"config/{name}.yaml", overrides=STRICT)
    assert config.supervisor is not None
    judge = Judge(config, config.supervisor)
    verdicts = [
        judge(seen(2.0 * look, claim(at_ms=2.0 * look), unlogged=np.full(N, look % 10 == 0)))
        for look in range(100)
    ]
    numbers = {each.requirement for each in verdicts if each is not None}
    assert numbers == ({Requirement.COMMAND_LOGGED} if found else set())


@pytest.mark.parametrize(("of", "bursts"), [(5, 3), (15, 4), (30, 5), (66, None)])
@pytest.mark.parametrize("state", [State.STANDBY, State.SAFE_STOP])
def test_torque_that_comes_and_goes_where_the_record_is_disarmed(
    config: Config, state: State, of: int, bursts: int | None
) -> None:
    """In one look of so many, and none is enabled in the others: it is forgotten 64 times slower
    than it was counted, so that emergency stops one after the other do not add up. A stop that was
    never controlled is as disarmed."""
    assert config.supervisor is not None
    judge = Judge(config, config.supervisor)
    judge.forget()

    def pulled(at_ms: float) -> Violation | None:
        return judge(
            seen(at_ms, claim(state, at_ms), mille=np.full(N, 100), pulled=np.ones(N, bool))
        )

    for look in range(((bursts or 12) + 1) * of):
        at_ms = 100.0 + 2.0 * look
        if look % of:
            judge.rest(round(at_ms * MS))
            continue
        found = pulled(at_ms)
        assert (found is not None) is (look // of == bursts)
        if found is not None:
            assert found.requirement is Requirement.DISARMED
            judge.forget()
            assert pulled(at_ms) is None
            break
