"""What is demanded of a stop, of the orders that lead to it, and of cables that hang loose."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.unit.supervisor_setup import MS, STRICT, N, at, claim, judged, lasting, seen
from tonus.config import Config, load
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import ARMED, Fault, Operator, State, StopMode
from tonus.runtime.supervisor.judge import NOWHERE, Judge
from tonus.runtime.supervisor.observation import Observation
from tonus.runtime.supervisor.record import claims

CONTROLLED = (State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE)


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


# --- a contact in a stop -------------------------------------------------------------------------


@pytest.mark.parametrize("force", [70.1, -70.1, 70.0, -70.0, 69.9])
def test_a_contact_in_a_stop_that_nobody_bears(config: Config, force: float) -> None:
    """Not for 110 ms, but for as long as any other condition."""
    beyond = abs(force) > 70.0
    assert lasting(config, 4.9, State.SAFE_STOP, contact=force) is None
    found = lasting(config, 5.0, State.SAFE_STOP, contact=force)
    assert (found is not None and found.requirement is Requirement.CONTACT) is beyond
    defective = {"contact": force, "contact_defective": True}
    assert lasting(config, 50.0, State.SAFE_STOP, **defective) is None
    other = lasting(config, 5.0, State.SAFE_STOP, contact=force, defective=np.ones(N, bool))
    assert (other is not None) is beyond
    assert lasting(config, 49.0, State.FAULT, contact=force) is None, "another bound's"


# --- orders --------------------------------------------------------------------------------------


def told(state: State, at_ms: float = 100.0, **given: Any) -> Observation:
    return seen(at_ms, claim(state, at_ms, **given))


def ordered(
    config: Config, first: State, order: Operator, *then: State
) -> list[Requirement | None]:
    """What is found 5 ms and more after the order's record."""
    looks = [told(first, 100.0, operator=order)]
    looks += [told(state, 101.0 + 5.0 * k) for k, state in enumerate((then[0], *then))]
    return [found and found.requirement for found in judged(config, *looks)][2:]


@pytest.mark.parametrize("state", CONTROLLED)
def test_an_order_to_stop_that_is_not_followed(config: Config, state: State) -> None:
    for order in (Operator.STOP, Operator.ESTOP):
        assert ordered(config, state, order, state) == [Requirement.ORDERS]
    for order in (Operator.NONE, Operator.ARM, Operator.START, Operator.HOLD, Operator.RESET):
        assert ordered(config, state, order, state) == [None]


def test_what_follows_an_order(config: Config) -> None:
    """A stop ends an order to stop, power that is off an emergency stop; a controlled stop is none
    of them that may be made of it."""
    stop = State.SAFE_STOP
    assert ordered(config, State.ACTIVE, Operator.STOP, stop, stop) == [None, None]
    assert ordered(config, State.ACTIVE, Operator.ESTOP, stop) == [Requirement.ORDERS]
    assert ordered(config, stop, Operator.ESTOP, stop) == [Requirement.ORDERS]
    assert ordered(config, stop, Operator.STOP, stop) == [None]
    assert ordered(config, State.ACTIVE, Operator.ESTOP, State.FAULT) == [None]


@pytest.mark.parametrize("later", [Operator.START, Operator.HOLD, Operator.RESET, Operator.ARM])
def test_an_order_to_stop_is_not_taken_back_by_another(config: Config, later: Operator) -> None:
    for first in (Operator.STOP, Operator.ESTOP):
        looks = [told(State.HOLD, 100.0, operator=first)]
        looks += [told(State.HOLD, 101.0, operator=later), told(State.HOLD, 106.0)]
        found = judged(config, *looks)[-1]
        assert found is not None
        assert found.requirement is Requirement.ORDERS


def test_an_emergency_stop_is_not_taken_back_by_a_stop(config: Config) -> None:
    for first, then in ((Operator.ESTOP, Operator.STOP), (Operator.STOP, Operator.ESTOP)):
        looks = [told(State.SAFE_STOP, 100.0, operator=first)]
        looks += [told(State.SAFE_STOP, 101.0, operator=then), told(State.SAFE_STOP, 106.0)]
        found = judged(config, *looks)[-1]
        assert found is not None
        assert (found.requirement, found.where) == (Requirement.ORDERS, NOWHERE)
        assert found.value == State.SAFE_STOP


def test_an_order_between_two_looks(config: Config) -> None:
    first = claim(State.HOLD, 99.0, operator=Operator.STOP)
    newest = claim(State.HOLD, 100.0)
    looks = [seen(100.0, newest, claims=[first, newest]), told(State.HOLD, 105.0)]
    found = judged(config, *looks)[-1]
    assert found is not None
    assert found.requirement is Requirement.ORDERS
    off = claim(State.FAULT, 99.5)
    looks[0] = seen(100.0, newest, claims=[first, off, newest])
    assert judged(config, *looks)[-1] is not None, "the drives say when power is off"


def test_a_fault_that_is_recorded_once_and_no_more(config: Config) -> None:
    first = told(State.ACTIVE, 100.0, fault=Fault.DRIVE_LOST)
    looks = [first, *(told(State.ACTIVE, at_ms) for at_ms in (102.0, 104.9, 105.0))]
    found = [each and each.requirement for each in judged(config, *looks)]
    assert found == [None, None, None, Requirement.ORDERS]


def test_a_torque_that_a_disarmed_daemon_sends(config: Config) -> None:
    """For its time to switch off a drive is sent none."""
    for state in (State.STANDBY, State.FAULT):
        for at_ms, broken in ((4.9, False), (5.0, True)):
            pulled = lasting(config, at_ms, state, mille=at(2, -1.0).astype(np.int64))
            assert (pulled is not None) is broken
            assert pulled is None or (pulled.requirement, pulled.where) == (
                Requirement.DISARMED,
                2,
            )
        others = {"mille": at(2, -1.0).astype(np.int64), "enabled": at(2, 0.0, 1.0) > 0.0}
        assert lasting(config, 49.0, state, **others) is None


def test_an_order_is_over_once_no_drive_is_enabled(config: Config) -> None:
    assert config.supervisor is not None
    judge = Judge(config, config.supervisor)
    assert judge(told(State.HOLD, 100.0, operator=Operator.STOP)) is None
    judge.rest(101 * MS)
    assert judge(told(State.HOLD, 102.0)) is None
    assert judge(told(State.HOLD, 108.0)) is None


@pytest.mark.parametrize("given", [{"operator": Operator.ESTOP}, {"fault": Fault.DRIVE_LOST}])
@pytest.mark.parametrize("between", [(), (State.FAULT,)])
def test_an_order_after_arming_and_before_any_power(
    config: Config, given: dict[str, Any], between: tuple[State, ...]
) -> None:
    """However long drives take: only a disarmed record ends it, as it ends one of before arming."""
    assert config.supervisor is not None
    judge = Judge(config, config.supervisor)
    for state in (State.REFERENCING, *between):
        judge.note([claim(state, 0.0, **given)])
        judge.rest(0)
        judge.forget()
    looks = [told(State.REFERENCING, at_ms) for at_ms in (400.0, 405.0)]
    found = [each and each.requirement for each in map(judge, looks)]
    assert found == [None, None if between else Requirement.ORDERS]


@pytest.mark.parametrize("given", [{"operator": Operator.STOP}, {"fault": Fault.DRIVE_LOST}])
def test_an_order_of_before_a_disarmed_record_is_over(
    config: Config, given: dict[str, Any]
) -> None:
    """Also where all that falls between two looks."""
    assert config.supervisor is not None
    judge = Judge(config, config.supervisor)
    said = [
        claim(State.REFERENCING, 0.0, **given),
        claim(State.STANDBY, 1.0),
        claim(State.REFERENCING, 2.0),
    ]
    judge.note(said)
    judge.rest(0)
    assert [judge(told(State.REFERENCING, at_ms)) for at_ms in (400.0, 405.0)] == [None, None]


@pytest.mark.parametrize("state", [*CONTROLLED, State.SAFE_STOP])
def test_a_fault_that_stops_nothing(config: Config, state: State) -> None:
    looks = [told(state, at_ms, fault=Fault.DRIVE_LOST) for at_ms in (100.0, 104.9, 105.0)]
    found = [each and each.requirement for each in judged(config, *looks)]
    ignored = Requirement.ORDERS if state in CONTROLLED else None
    assert found == [None, None, ignored]


@pytest.mark.parametrize("first", CONTROLLED)
@pytest.mark.parametrize("then", CONTROLLED)
def test_a_state_of_arming_after_a_later_one(config: Config, first: State, then: State) -> None:
    """From HOLD to ACTIVE and back it goes as ordered; all else is a fault of the record, which
    lasts until the drives are off."""
    stiff = (State.HOLD, State.ACTIVE)
    back = then < first and not (first in stiff and then in stiff)
    assert config.supervisor is not None
    judge = Judge(config, config.supervisor)
    looks = [told(first, 98.0), *(told(then, at_ms) for at_ms in (100.0, 104.9, 105.0))]
    looks.append(told(State.ACTIVE, 106.0))
    wanted = Requirement.ORDERS if back else None
    found = [each and each.requirement for each in map(judge, looks)]
    assert found == [None, None, None, wanted, wanted]
    judge.note([claim(State.STANDBY, 107.0)])
    judge.rest(107 * MS)
    looks = [told(then, at_ms) for at_ms in (200.0, 206.0)]
    assert list(map(judge, looks)) == [None, None]


def test_an_earlier_state_between_two_looks(config: Config) -> None:
    said = [claim(state, 99.0) for state in (State.ACTIVE, State.PRETENSION, State.ACTIVE)]
    looks = [seen(100.0, said[-1], claims=said), told(State.ACTIVE, 105.0)]
    found = judged(config, *looks)[-1]
    assert found is not None
    assert found.requirement is Requirement.ORDERS


@pytest.mark.parametrize("state", [*CONTROLLED, State.SAFE_STOP])
def test_a_cable_that_is_given_up_and_no_stop(config: Config, state: State) -> None:
    """Nothing is controlled without one of its cables."""
    given_up = np.arange(N) == 5
    looks = [told(state, 98.0)]
    looks += [told(state, at_ms, failed=given_up) for at_ms in (100.0, 104.9, 105.0)]
    found = [each and each.requirement for each in judged(config, *looks)]
    ignored = Requirement.ORDERS if state in CONTROLLED else None
    assert found == [None, None, None, ignored]


@pytest.mark.parametrize("state", ARMED)
@pytest.mark.parametrize("row", [0, N])
@pytest.mark.parametrize("moved", [-1e-9, 0.1])
def test_a_tare_that_moves_while_the_robot_is_armed(
    config: Config, state: State, row: int, moved: float
) -> None:
    """By as little as it is: it is taken off once, before."""
    assert config.supervisor is not None
    judge = Judge(config, config.supervisor)
    tare = np.full(N + 1, 1.0)
    other = tare.copy()
    other[row] += moved
    looks = [told(state, 98.0, tare=tare)]
    looks += [told(state, at_ms, tare=other) for at_ms in (100.0, 104.9, 105.0)]
    found = list(map(judge, looks))
    assert found[:-1] == [None] * 3
    assert found[-1] is not None
    assert found[-1].requirement is Requirement.MEASURED_LOGGED
    assert found[-1].value == pytest.approx(abs(moved))
    judge.note([claim(State.STANDBY, 106.0)])
    judge.rest(106 * MS)
    looks = [told(state, at_ms, tare=other) for at_ms in (200.0, 206.0)]
    assert list(map(judge, looks)) == [None, None], "a new one, for a new arming"


def test_a_tare_before_arming_may_be_another(config: Config) -> None:
    looks = [told(State.STANDBY, 98.0, tare=np.ones(N + 1))]
    looks += [told(State.REFERENCING, at_ms) for at_ms in (100.0, 106.0)]
    found = [each and each.requirement for each in judged(config, *looks)]
    assert Requirement.MEASURED_LOGGED not in found


def test_orders_and_faults_of_a_record() -> None:
    record = np.zeros(1, cycle_dtype(N))
    for name, value in (("fault", 12), ("operator", 5), ("stop_mode", 3)):
        record["state"][name] = value
    found = claims(([1], record))[0]
    assert (found.fault, found.operator, found.stop_mode) == (12, 5, 3)


def test_the_contact_of_a_record_is_the_one_that_is_measured_in_every_state() -> None:
    record = np.zeros(1, cycle_dtype(N))
    record["wrench"]["contact"] = 20.0  # as control left it
    record["force_cells"]["filtered"][0, -1] = 3.0
    assert claims(([1], record))[0].contact == 3.0


# --- a passive stop ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("torque", "rate", "found"),
    [
        (17.1, 0.01, True),
        (17.0, 0.01, False),
        (44.1, -0.01, False),
        (300.0, -2.0, False),
        (-5.1, -0.001, True),
        (-4.9, -0.001, False),
        (-300.0, 0.5, False),
        (300.0, 0.0, False),
        (-300.0, 0.0, False),
        (-300.0, np.nan, False),
    ],
)
def test_a_torque_that_drives_its_drum_in_a_passive_stop(
    config: Config, torque: float, rate: float, found: bool
) -> None:
    """By 5 N beyond the passive tension of 12 N, or below none: it is let down in the end."""

    def look(at_ms: float, state: State = State.SAFE_STOP, mode: int = StopMode.PASSIVE) -> Any:
        said = claim(state, at_ms, stop_mode=mode)
        turning = {"torque": at(3, torque, 12.0), "rate": at(3, rate)}
        return seen(at_ms, said, unexplained=np.full(N, np.nan), **turning)

    verdict = judged(config, look(100.0), look(104.9), look(105.0))
    assert verdict[:2] == [None, None]
    assert (verdict[2] is not None) is found
    if verdict[2] is not None:
        assert (verdict[2].requirement, verdict[2].where) == (Requirement.BRAKED, 3)
    for mode in (StopMode.ON_PATH, StopMode.DESCENT):
        assert judged(config, look(100.0, mode=mode), look(105.0, mode=mode)) == [None, None]
    disabled = [replace(look(at_ms), enabled=np.arange(N) != 3) for at_ms in (100.0, 105.0)]
    assert judged(config, *disabled) == [None, None]


@pytest.mark.parametrize("rate", [0.01, -0.01, 0.0])
@pytest.mark.parametrize(("age_ms", "torque"), [(5.1, 17.1), (5.1, -5.1), (5.0, 17.1), (5.1, 17.0)])
def test_which_way_a_drum_turns_that_has_not_answered_for_long(
    config: Config, age_ms: float, torque: float, rate: float
) -> None:
    """Is not known: neither direction may be driven."""

    def look(at_ms: float) -> Any:
        said = claim(State.SAFE_STOP, at_ms, stop_mode=StopMode.PASSIVE)
        turning = {"torque": at(3, torque, 12.0), "rate": at(3, rate)}
        return seen(at_ms, said, measured_age=at(3, age_ms), **turning)

    found = judged(config, look(100.0), look(105.0))[1]
    known = age_ms == 5.0
    driven = torque == 17.1 and rate > 0.0 if known else torque != 17.0
    assert (found is not None) is driven
    assert found is None or found.requirement is Requirement.BRAKED


@pytest.mark.parametrize(
    ("torque", "given", "found"),
    [
        (12.9, {}, True),
        (13.1, {}, False),
        (12.9, {"incredible": np.arange(N) == 3}, False),
        (12.9, {"measured_age": at(3, 5.1)}, False),
        (12.9, {"failed": np.arange(N) == 3}, False),
    ],
)
def test_a_drum_that_pays_out_is_damped(
    config: Config, torque: float, given: dict[str, Any], found: bool
) -> None:
    """At 0.3 m/s by 36 N; half of it less 5 N has to be there, in any RPDO since the last look."""
    state = {key: given[key] for key in given if key == "failed"}
    turning = {key: given[key] for key in given if key != "failed"}
    for least in (torque, 0.0):
        torques = np.array([at(3, least, 12.0), at(3, torque, 12.0)])
        looks = [
            seen(
                at_ms,
                claim(State.SAFE_STOP, at_ms, stop_mode=StopMode.PASSIVE, **state),
                **{"torque": torques[1], "torques": torques, "rate": at(3, -0.3)} | turning,
            )
            for at_ms in (100.0, 104.9, 105.0)
        ]
        verdict = judged(config, *looks)
        assert verdict[:2] == [None, None]
        assert (verdict[2] is not None) is found
        if verdict[2] is not None:
            assert (verdict[2].requirement, verdict[2].where) == (Requirement.BRAKED, 3)


@pytest.mark.parametrize(("of", "bursts"), [(5, 3), (15, 4), (30, 5), (66, None)])
def test_bursts_in_a_passive_stop(config: Config, of: int, bursts: int | None) -> None:
    """In one look of so many: its drum keeps the speed of each."""
    settings = config.supervisor
    assert settings is not None
    judge = Judge(config, settings)
    for look in range(((bursts or 12) + 1) * of):
        at_ms = 2.0 * look
        said = claim(State.SAFE_STOP, at_ms, stop_mode=StopMode.PASSIVE)
        torque = at(3, 12.0 if look % of else 690.0, 12.0)
        found = judge(seen(at_ms, said, torque=torque, rate=at(3, 0.01)))
        assert (found is not None) is (look // of == bursts)
        if found is not None:
            assert found.requirement is Requirement.BRAKED
            break


def test_a_torque_between_two_looks_counts_in_a_passive_stop(config: Config) -> None:
    """A look sees the newest torque; a daemon may send a wrong one in every second tick."""
    said = claim(State.SAFE_STOP, 100.0, stop_mode=StopMode.PASSIVE)
    right = np.full(N, 10.0)
    for rate, torques, found in (
        (0.1, (right, right), False),
        (0.1, (right, at(3, 18.0, 10.0)), True),
        (-0.1, (right, at(3, 18.0, 10.0)), False),
        (-0.1, (at(3, -6.0, 10.0), right), True),
    ):
        given = {"torque": right, "torques": np.array(torques), "rate": np.full(N, rate)}
        looks = [
            seen(at_ms, replace(said, at_ns=round(at_ms * MS)), **given) for at_ms in (100.0, 105.0)
        ]
        verdict = judged(config, *looks)[-1]
        assert (verdict is not None) is found
        if verdict is not None:
            assert (verdict.requirement, verdict.where) == (Requirement.BRAKED, 3)


@pytest.mark.parametrize("late", [True, False])
def test_a_torque_of_before_a_passive_stop(config: Config, late: bool) -> None:
    """On a channel that brings torques late the drives keep one that the stop does not send: its
    heartbeat ends, and no other's."""
    said = claim(State.SAFE_STOP, 100.0, stop_mode=StopMode.PASSIVE)
    one = np.arange(N) == 3
    given = {"torque": at(3, 300.0), "rate": at(3, 0.1), "unlogged": one, "late": one & late}
    looks = [
        seen(at_ms, replace(said, at_ns=round(at_ms * MS)), **given) for at_ms in (100.0, 105.0)
    ]
    found = judged(config, *looks)[-1]
    assert found is not None
    assert (found.requirement, found.where) == (Requirement.COMMAND_LOGGED, 3)
    assert found.alone is late


# --- a cable that hangs loose --------------------------------------------------------------------


@pytest.mark.parametrize("state", [*CONTROLLED, State.SAFE_STOP])
def test_a_cable_that_hangs_loose(config: Config, state: State) -> None:
    """5 N are the daemon's own bound, for 5 ticks; 5 ms of patience more."""
    judges = state in (State.HOLD, State.ACTIVE)
    for tension, for_ms, found in ((4.9, 10.0, judges), (4.9, 9.9, False), (5.0, 50.0, False)):
        said = np.full(N, 45.0)
        given = {"tension": at(6, tension, 45.0), "torque": at(6, tension, 45.0)}
        looks = [
            seen(at_ms, claim(state, at_ms, tension=given["tension"], reference=said), **given)
            for at_ms in (100.0, 100.0 + for_ms)
        ]
        verdict = judged(config, *looks)[-1]
        assert (verdict is not None) is found
        assert verdict is None or (verdict.requirement, verdict.where) == (Requirement.TENSION, 6)
        off = [replace(look, enabled=np.arange(N) != 6) for look in looks]
        verdict = judged(config, *off)[-1]
        assert verdict is None or verdict.requirement is Requirement.DISARMED


# --- a torque that is missing --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("torque", "tension", "found"),
    [
        (24.9, 45.0, True),
        (25.0, 45.0, False),
        (24.0, 45.5, False),
        (26.0, 46.1, False),
        (24.0, 44.9, True),
        (79.0, 58.9, False),
        (82.1, 62.0, True),
        (81.9, 62.0, False),
        (81.0, 60.9, False),
    ],
)
def test_a_small_torque_against_the_reference_that_lasts(
    config: Config, torque: float, tension: float, found: bool
) -> None:
    """The reference is 53.5 N; 20 N, and 8 N of error, may last for 20 ms. The daemon's loop would
    correct it within a few."""

    def look(at_ms: float, state: State = State.ACTIVE, mode: int = StopMode.NONE) -> Observation:
        measured, sent = at(5, tension, 53.5), at(5, torque, 53.5)
        said = claim(state, at_ms, tension=measured, reference=np.full(N, 53.5), stop_mode=mode)
        return seen(at_ms, said, tension=measured, torque=sent, rate=np.zeros(N))

    stop = State.SAFE_STOP
    for state, mode in (
        (State.HOLD, StopMode.NONE),
        (State.ACTIVE, StopMode.NONE),
        (stop, StopMode.ON_PATH),
    ):
        first, last, beyond = (look(at_ms, state, mode) for at_ms in (100.0, 119.9, 120.0))
        assert judged(config, first, last) == [None, None]
        verdict = judged(config, first, beyond)[1]
        assert (verdict is not None) is found
        assert verdict is None or (verdict.requirement, verdict.where) == (Requirement.OPPOSED, 5)
    others = [replace(look(at_ms), enabled=np.arange(N) != 5) for at_ms in (100.0, 120.0)]
    off = judged(config, *others)[1]
    assert off is not None
    assert off.requirement is Requirement.DISARMED, "one without power opposes nothing"
    for state, mode in (
        (State.PRETENSION, StopMode.NONE),
        (State.ACTIVE, StopMode.PASSIVE),
        (stop, StopMode.DESCENT),
        (stop, StopMode.PASSIVE),
    ):
        looks = [look(at_ms, state, mode) for at_ms in (100.0, 120.0)]
        expected = found if state is State.ACTIVE else False
        assert (judged(config, *looks)[1] is not None) is expected


@pytest.mark.parametrize("way", [1.0, -1.0], ids=["less", "more"])
@pytest.mark.parametrize(
    ("pull", "momentum", "found"),
    [
        *((29.9, 0.2, False), (29.9, 0.19, True), (29.9, 0.0, True), (29.9, -0.2, True)),
        *((29.9, np.nan, True), (19.9, -0.2, False)),
    ],
)
def test_a_torque_that_brakes_a_drum(
    config: Config, way: float, pull: float, momentum: float, found: bool
) -> None:
    """It turns the way that its tension has to go: 30 N beside the torque that would hold it, less
    those 10 N that would stop it in 20 ms, are the 20 N that may last."""
    tension = 53.5 - 9.0 * way
    given = {"tension": at(5, tension, 53.5), "torque": at(5, tension - pull * way, 53.5)}
    for state, mode in ((State.ACTIVE, StopMode.NONE), (State.SAFE_STOP, StopMode.ON_PATH)):
        said = claim(state, tension=given["tension"], reference=np.full(N, 53.5), stop_mode=mode)
        looks = [
            seen(at_ms, replace(said, at_ns=round(at_ms * MS)), momentum=at(5, way * momentum))
            for at_ms in (100.0, 120.0)
        ]
        verdict = judged(config, *(replace(look, **given) for look in looks))[1]
        assert (verdict is not None) is found
        assert verdict is None or verdict.requirement is Requirement.OPPOSED


@pytest.mark.parametrize("state", [*CONTROLLED, State.SAFE_STOP])
@pytest.mark.parametrize("error", [30.5, -30.5, 29.5])
def test_a_tension_that_stays_away_from_its_reference(
    config: Config, state: State, error: float
) -> None:
    """By twice what the daemon takes for a fault, for twice as long, whatever the torque."""
    tension = 70.0
    said = claim(state, reference=np.full(N, tension + error), tension=np.full(N, tension))
    given = {"torque": np.full(N, tension), "tension": np.full(N, tension)}
    for last, late in ((199.0, False), (200.0, True)):
        looks = [
            seen(100.0 + k, replace(said, at_ns=round((100 + k) * MS)), **given)
            for k in (0.0, last)
        ]
        found = judged(config, *looks)[1]
        judges = state in (State.HOLD, State.ACTIVE) and abs(error) > 30.0
        assert (found is not None) is (late and judges)
        assert found is None or (found.requirement, found.value) == (
            Requirement.OPPOSED,
            abs(error),
        )


def test_how_long_a_tension_may_stay_away_is_twice_what_the_daemon_waits() -> None:
    longer = STRICT | {"control.isolation.tension_error_s": 0.6}
    config = load("config/can.yaml", overrides=longer)[0]
    said = claim(reference=np.full(N, 101.0), tension=np.full(N, 70.0))
    given = {"torque": np.full(N, 70.0), "tension": np.full(N, 70.0)}
    for last_ns, found in ((1200 * MS - 1, False), (1200 * MS, True)):
        looks = [
            replace(seen(100.0, said, **given), now_ns=now_ns, claim=replace(said, at_ns=now_ns))
            for now_ns in (100 * MS, 100 * MS + last_ns)
        ]
        assert (judged(config, *looks)[1] is not None) is found


@pytest.mark.parametrize("mode", StopMode)
def test_a_torque_against_the_reference_in_a_stop_along_the_path(
    config: Config, mode: StopMode
) -> None:
    given = {"torque": at(1, -20.0, 45.0), "tension": at(1, 42.0, 45.0)}
    looks = [
        seen(at_ms, claim(State.SAFE_STOP, at_ms, stop_mode=mode), **given)
        for at_ms in (100.0, 104.9, 105.0)
    ]
    found = [each and each.requirement for each in judged(config, *looks)]
    verdict = Requirement.OPPOSED if mode is StopMode.ON_PATH else None
    assert found == [None, None, verdict]


# --- a channel that is gone ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sent_ms", "answered_ms", "found"),
    [(5.1, 5.1, False), (5.1, 5.0, True), (5.0, 5.1, True), (0.0, 15.0, True), (15.0, 0.0, True)],
)
def test_a_torque_of_before_on_a_channel_that_is_gone(
    config: Config, sent_ms: float, answered_ms: float, found: bool
) -> None:
    """It is in no newer record, and no drive of the channel can be reached; the stop of the others
    goes on. Where one is sent anything, or another drive of its channel answers, it is wrong."""
    given = {
        "unlogged": np.arange(N) == 2,
        "torque_age": at(2, sent_ms),
        "measured_age": at(2, 50.0),
        "channel_age": at(2, answered_ms),
    }
    verdict = lasting(config, 5.0, State.SAFE_STOP, **given)
    assert (verdict is not None and verdict.requirement is Requirement.COMMAND_LOGGED) is found


# --- a drive that pulls by itself ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("motion", "torque", "rate", "found"),
    [
        (80.1, 0.0, 0.01, True),
        (80.0, 0.0, 0.01, False),
        (205.1, 100.0, 0.01, True),  # 80 N, and a quarter of what it is sent
        (205.0, 100.0, 0.01, False),
        (5.1, -100.0, 0.01, True),
        (5.0, -100.0, 0.01, False),
        (690.0, 0.0, 0.0, False),
        (690.0, 0.0, -0.01, False),
        (np.nan, 0.0, 0.01, False),
    ],
)
@pytest.mark.parametrize("mode", [StopMode.ON_PATH, StopMode.DESCENT, StopMode.PASSIVE])
def test_a_drum_that_reels_in_by_more_than_its_torque(
    config: Config, motion: float, torque: float, rate: float, found: bool, mode: StopMode
) -> None:
    """In a stop, for longer than an encoder that slips shows it: the window, and two looks."""

    def look(at_ms: float, state: State = State.SAFE_STOP, **given: Any) -> Any:
        turning = {"motion": at(3, motion), "most_torque": at(3, torque), "rate": at(3, rate)}
        said = claim(state, at_ms, stop_mode=mode)
        return seen(at_ms, said, torque=np.zeros(N), **turning, **given)

    verdict = judged(config, look(100.0), look(119.9), look(120.0))
    assert verdict[:2] == [None, None]
    assert (verdict[2] is not None) is found
    if verdict[2] is not None:
        assert (verdict[2].requirement, verdict[2].where) == (Requirement.UNEXPLAINED, 3)
    for given in ({"enabled": np.arange(N) != 3}, {"useless": np.arange(N) == 3}):
        last = judged(config, look(100.0, **given), look(120.0, **given))[1]
        assert last is None or last.requirement is not Requirement.UNEXPLAINED
