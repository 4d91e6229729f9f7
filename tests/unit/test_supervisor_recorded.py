"""The supervisor where drives are not on CAN: it judges what the daemon records of them. STO-1 to
STO-3."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.unit.recorded_setup import (
    BEAT,
    DISABLED,
    ENABLED,
    HELD,
    MS,
    QUICK_STOP,
    RELEASED,
    ROBOT,
    Change,
    Held,
    disarmed,
    out_of_bounds,
    record_of,
)
from tonus.config import Config, load
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import State
from tonus.runtime.supervisor.record import CONTROLLED


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/ethercat.yaml", overrides=ROBOT)[0]


@pytest.fixture
def held(config: Config) -> Iterator[Held]:
    made = Held(config)
    yield made
    made.supervisor.close()


# --- what the record shows -----------------------------------------------------------------------


def tense(record: Any) -> None:
    record["force_cells"]["raw"][3] = record["tension"]["measured"][3] = 230.0
    record["tension"]["reference"][3] = 230.0
    record["drives"]["torque_command"][3] = record["drives"]["torque"][3] = 4.6


def pushed(record: Any) -> None:
    record["force_cells"]["raw"][-1] = record["force_cells"]["filtered"][-1] = 28.0


def opposite(record: Any) -> None:
    record["drives"]["torque"][2] *= -1.0


def late(record: Any) -> None:
    record["drives"]["age"][5] = 40


def unmeasured(record: Any) -> None:
    record["force_cells"]["age"][1] = 40


def said_disarmed(record: Any) -> None:
    record["state"]["state"] = State.STANDBY


def infinite(record: Any) -> None:
    record["force_cells"]["raw"][4] = np.inf


@pytest.mark.parametrize(
    ("change", "requirement", "within"),
    [
        (out_of_bounds, Requirement.STIFFNESS, 2),
        (tense, Requirement.TENSION, 10),
        (pushed, Requirement.CONTACT, 10),
        (opposite, Requirement.COMMAND_LOGGED, 10),
        (late, Requirement.STALE, 20),
        (unmeasured, Requirement.STALE, 20),
        (said_disarmed, Requirement.DISARMED, 40),
        (infinite, Requirement.TENSION, 10),
    ],
)
def test_what_the_record_shows(
    held: Held, change: Change, requirement: Requirement, within: int
) -> None:
    assert held.armed().stopped_for(change, within) == requirement


def test_recorded_torques_that_stay_while_the_tensions_change(held: Held) -> None:
    held.armed()
    count = 0

    def frozen(record: Any) -> None:
        nonlocal count
        count += 1
        record["drives"]["torque_command"] = record["drives"]["torque"] = 1.01
        record["force_cells"]["raw"][:-1] = 50.0 + 0.02 * count
        record["tension"]["measured"] = record["tension"]["reference"] = 50.0 + 0.02 * count

    assert held.stopped_for(frozen) == Requirement.FROZEN


def test_drums_that_turn_faster_than_the_platform_may(held: Held) -> None:
    """In a stop, by the wide bound: the platform moves upwards with 3 m/s."""
    geometry = held.config.robot.geometry
    along = np.array(geometry.frame) - np.array(geometry.platform)
    upwards = along[:, 2] / np.linalg.norm(along, axis=1)
    count = 0

    def rising(record: Any) -> None:
        nonlocal count
        count += 1
        record["state"]["state"] = State.SAFE_STOP
        record["drives"]["angle"] = 3.0e-3 * count * upwards / 0.02

    held.armed()
    assert held.stopped_for(rising, within=70) == Requirement.SPEED


def test_a_drive_in_quick_stop_is_enabled_by_its_recorded_statusword(held: Held) -> None:
    def quick_stop(record: Any) -> None:
        disarmed(record)
        record["drives"]["statusword"][1] = QUICK_STOP

    assert all(sent == [] for sent in held.steps(400, quick_stop))


def test_a_cell_that_reports_a_defect_says_nothing_in_a_stop(held: Held) -> None:
    def broken(record: Any) -> None:
        record["state"]["state"] = State.SAFE_STOP
        record["force_cells"]["raw"][3] = 500.0
        record["force_cells"]["status"][3] = 3

    held.armed()
    assert all(sent == [BEAT, HELD] for sent in held.steps(100, broken))


# --- a record that cannot be right ---------------------------------------------------------------


def test_a_controlled_robot_without_drives_releases_the_relay(held: Held) -> None:
    """Whatever statuswords are recorded: it may be that only they are wrong."""

    def undriven(record: Any) -> None:
        record["drives"]["statusword"] = DISABLED

    list(held.steps(160, disarmed))
    assert all(sent == [BEAT, HELD] for sent in held.steps(25, undriven))
    assert held.look(1) == [RELEASED]
    assert all(sent == [] for sent in held.steps(400, undriven))
    assert list(held.steps(2, disarmed))[-1] == [BEAT, HELD]
    assert all(sent == [BEAT, HELD] for sent in held.steps(100))
    assert all(sent == [BEAT, HELD] for sent in held.steps(24, undriven))
    assert [RELEASED] in list(held.steps(3, undriven))


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("torque", [0.0, 0.1])
def test_drives_that_take_long_to_be_enabled(held: Held, state: State, torque: float) -> None:
    """The daemon waits for them while it is referencing, and sends no torque until they are."""

    def waiting(record: Any) -> None:
        disarmed(record)
        record["state"]["state"] = state
        record["drives"]["torque_command"][3] = torque

    list(held.steps(160, disarmed))
    sent = list(held.steps(400, waiting))
    waits = state not in CONTROLLED or (state is State.REFERENCING and torque == 0.0)
    assert (sent == [[BEAT, HELD]] * 400) is waits
    assert waits or sent[:25] == [[BEAT, HELD]] * 25
    assert waits or sent[27:] == [[]] * 373


def test_a_controlled_robot_without_drives_from_the_first_record_on(held: Held) -> None:
    def undriven(record: Any) -> None:
        record["drives"]["statusword"] = DISABLED

    assert all(sent == [] for sent in held.steps(400, undriven))


def test_drives_that_all_stop_answering_while_nothing_is_enabled_release_the_relay(
    held: Held,
) -> None:
    count = 0

    def deaf(record: Any) -> None:
        nonlocal count
        count += 1
        disarmed(record)
        record["drives"]["age"] = count

    def one_deaf(record: Any) -> None:
        deaf(record)
        record["drives"]["age"][3] = 0

    list(held.steps(160, disarmed))
    assert all(sent == [BEAT, HELD] for sent in held.steps(200, one_deaf))
    list(held.steps(1, disarmed))
    count = 0
    assert all(sent == [BEAT, HELD] for sent in held.steps(150, deaf))
    assert held.look(1) == [RELEASED]
    assert list(held.steps(1, disarmed)) == [[BEAT, HELD]]


@pytest.mark.parametrize("quiet_s", [0.3, 2.0])
def test_a_stop_in_which_no_drive_answers_is_let_be_for_a_while(quiet_s: float) -> None:
    """They are sent no torque, and would have none without the relay either: then nothing speaks
    for it any more. It is no mistake of the daemon."""
    held = Held(load("config/ethercat.yaml", overrides={**ROBOT, "supervisor.quiet_s": quiet_s})[0])
    count = 0

    def silent(record: Any) -> None:
        nonlocal count
        count += 1
        record["state"]["state"] = State.SAFE_STOP
        record["drives"]["age"] = count
        record["drives"]["torque_command"] = 0.0

    list(held.steps(round(quiet_s * 500.0), disarmed))
    held.armed()
    assert all(sent == [BEAT, HELD] for sent in held.steps(round(quiet_s * 500.0), silent))
    assert held.step(silent) == [RELEASED]
    assert held.supervisor.violation is None
    assert all(sent == [] for sent in held.steps(100, silent))
    held.supervisor.close()


def test_a_record_that_ends_after_one_drive_has_been_silent_for_long(held: Held) -> None:
    """The others answer: that it ends is the daemon's mistake, and told."""
    count = 0

    def silent(record: Any) -> None:
        nonlocal count
        count += 1
        record["state"]["state"] = State.SAFE_STOP
        record["drives"]["age"][3] = count
        record["drives"]["torque_command"][3] = 0.0

    held.armed()
    assert all(sent == [BEAT, HELD] for sent in held.steps(200, silent))
    held.recorded = False
    assert held.stopped_for(silent) is Requirement.TICK


@pytest.mark.parametrize("had_power", [True, False])
def test_a_silent_drive_of_a_disarmed_robot(held: Held, had_power: bool) -> None:
    """It was pulled, or has no power; or keeps its torque, if it had power: no heartbeat is read,
    and without the relay no other drive loses anything."""
    count = 0

    def pulled(record: Any) -> None:
        nonlocal count
        count += 1
        disarmed(record)
        record["state"]["state"] = State.FAULT
        record["drives"]["age"][1] = count
        record["drives"]["statusword"][1] = ENABLED

    held.armed()
    list(held.steps(0 if had_power else 1, disarmed))
    sent = list(held.steps(100, pulled))
    kept = 9 if had_power else 100  # the look after 20 ms
    assert sent[:kept] == [[BEAT, HELD]] * kept
    assert sent[kept : kept + 1] == [[RELEASED]] * had_power
    assert held.supervisor.violation is None
    assert held.supervisor.beating is not had_power
    list(held.steps(160, disarmed))
    assert held.step(disarmed) == [BEAT, HELD], "it has answered"


def test_the_same_record_again_is_none(held: Held) -> None:
    def again(record: Any) -> None:
        record["timing"]["tick"] = 362

    assert held.armed().stopped_for(again) == Requirement.TICK


def test_a_record_of_the_future_is_none(held: Held) -> None:
    """Else all that is recorded after it would be older than what was measured last."""

    def wild(record: Any) -> None:
        record["stiffness"]["k_eq"] = 1e6

    list(held.steps(160, disarmed))
    record = record_of(held.config.robot.cables, 0)
    disarmed(record)
    record["timing"]["tick"] = 10**6
    held.waiting.append((10**6 * MS, record))
    assert held.step(disarmed) == [BEAT, HELD]
    assert held.stopped_for(wild, within=1) == Requirement.STIFFNESS


@pytest.mark.parametrize(("ahead_ms", "taken"), [(1, True), (2, False)])
def test_how_far_ahead_a_record_may_be(held: Held, ahead_ms: int, taken: bool) -> None:
    held.armed()
    record = record_of(held.config.robot.cables, 0)
    record["stiffness"]["k_eq"] = 1e6
    record["timing"]["tick"] = 10**6
    held.recorded = False
    held.waiting.append(((364 + ahead_ms) * MS, record))
    assert (held.step() != [BEAT, HELD]) is taken


def test_a_record_that_ends_with_one_of_the_future_releases_the_relay(held: Held) -> None:
    list(held.steps(160, disarmed))
    held.recorded = False
    record = record_of(held.config.robot.cables, 0)
    disarmed(record)
    record["timing"]["tick"] = 10**6
    held.waiting.append((10**6 * MS, record))
    assert [RELEASED] in list(held.steps(4, disarmed))


def no_torque_told(record: Any) -> None:
    record["drives"]["torque"][3] = np.nan


def no_angle(record: Any) -> None:
    record["drives"]["angle"][3] = np.nan


def no_command(record: Any) -> None:
    record["drives"]["torque_command"][3] = np.inf


@pytest.mark.parametrize("change", [no_torque_told, no_angle, no_command])
def test_what_is_no_number_is_beyond_every_bound(held: Held, change: Change) -> None:
    held.armed()
    assert all(sent == [BEAT, HELD] for sent in held.steps(20))
    assert held.stopped_for(change, within=4) == Requirement.COMMAND_LOGGED


def test_a_silent_drive_may_have_been_measured_never(held: Held) -> None:
    def unknown(record: Any) -> None:
        disarmed(record)
        record["drives"]["angle"][3] = record["drives"]["torque"][3] = np.nan
        record["drives"]["age"][3] = 0xFFFF

    assert all(sent == [] for sent in held.steps(400, unknown)), "not all of it arrives"


@pytest.mark.parametrize("later_ns", [MS // 2, MS])
def test_a_drive_that_was_silent_in_a_stop_is_not_led_afterwards(later_ns: int) -> None:
    """On a relay a measurement is as old as its record, so never of the look itself. Single
    heartbeats to it would be those of a robot that has power."""
    held = Held(load("config/ethercat.yaml", overrides=ROBOT | {"supervisor.policy": "require"})[0])
    held.later_ns = later_ns
    held.armed()

    def silent(record: Any) -> None:
        record["drives"]["age"][2] = 7

    list(held.steps(4, silent))
    list(held.steps(200, disarmed))
    held.recorded = False
    sent = list(held.steps(200, disarmed))
    assert RELEASED in sent[2]
    assert all(frames == [] for frames in sent[3:])


@pytest.mark.parametrize("tick", [1 << 63, (1 << 64) - 1])
def test_a_tick_that_no_daemon_counts_to_is_no_record(held: Held, tick: int) -> None:
    def far(record: Any) -> None:
        record["timing"]["tick"] = tick

    assert held.armed().stopped_for(far) == Requirement.TICK


def test_a_drives_own_torque_while_it_is_to_be_off(held: Held) -> None:
    """None is recorded: bursts of one look in ten are those of a torque."""
    held.armed()
    list(held.steps(10, lambda record: record["state"].__setitem__("state", State.SAFE_STOP)))
    looks = 0

    def bursts(record: Any) -> None:
        disarmed(record)
        drives = record["drives"]
        if looks % 10 == 0:
            drives["statusword"], drives["torque"] = ENABLED, 30.0

    while RELEASED not in held.step(bursts):
        looks += 1
        assert looks < 50
    assert looks >= 20
    assert held.supervisor.violation is not None
    assert held.supervisor.violation.requirement is Requirement.DISARMED
