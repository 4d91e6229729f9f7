"""Drives that act on nothing, or answer nothing; and for how long the supervisor remembers."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import can
import numpy as np
import pytest

from tests.unit.supervisor_setup import STRICT, Watchdog, broken, claim, seen
from tonus.config import Config, load
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import State
from tonus.runtime.supervisor.judge import Judge

BEAT = [(0x77E, b"\5")]
BOOT_UP, OPERATIONAL = 0x00, 0x05
MS = 1_000_000


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


@pytest.fixture
def watchdog(config: Config) -> Iterator[Watchdog]:
    made = Watchdog(config)
    yield made
    made.supervisor.close()


def test_torques_that_no_sync_makes_act(watchdog: Watchdog) -> None:
    """They arrive, and each drive keeps the torque that it had."""
    list(watchdog.steps(0, 310, enabled=False))
    syncs = {(axis.channel, axis.sync) for axis in watchdog.wiring.axes}
    assert {identifier for _, identifier in syncs} == {0x080}
    assert watchdog.step(310, enabled=True) == BEAT
    assert all(sent == BEAT for sent in watchdog.steps(312, 316, enabled=True, deaf=syncs))
    assert watchdog.step(316, enabled=True, deaf=syncs) != BEAT
    assert broken(watchdog) is Requirement.TORQUE


@pytest.mark.parametrize(("age_ms", "stopped"), [(20.0, False), (20.1, True)])
def test_no_drive_answers_whatever_it_is_sent(config: Config, age_ms: float, stopped: bool) -> None:
    """Nothing that is measured would contradict the daemon. In a stop an enabled one that answers
    is another matter."""
    assert config.supervisor is not None
    for state in (State.ACTIVE, State.SAFE_STOP):
        silent = {"mille": np.zeros(8, np.int64), "measured_age": np.full(8, age_ms)}
        look = seen(100.0, claim(state), **silent)
        found = Judge(config, config.supervisor)(look)
        assert (found is not None and found.requirement is Requirement.STALE) is stopped
        if state is State.SAFE_STOP:
            look.measured_age[5] = 0.0
            assert Judge(config, config.supervisor)(look) is None
            for disabled, judged in ((5, True), (6, True), (7, True), (4, False)):
                look.enabled[disabled] = False
                found = Judge(config, config.supervisor)(look)
                assert (found is not None) is (stopped and judged), "at the end of a stop most are"


def test_drives_that_are_all_silent_in_a_stop(watchdog: Watchdog) -> None:
    """They are sent no torque any more, and may have their last one."""
    list(watchdog.steps(0, 310, enabled=False))
    deaf = {(axis.channel, axis.received) for axis in watchdog.wiring.axes}
    assert watchdog.step(310, enabled=True) == BEAT
    sent = list(watchdog.steps(312, 340, enabled=True, deaf=deaf))
    assert sent[:10] == [BEAT] * 10
    assert struct.unpack("<HBBf", sent[10][0][1])[:3] == (0xFF0E, 0x81, 0xFF)


def test_one_look_without_power_is_no_excuse(watchdog: Watchdog) -> None:
    """Enabled while disarmed for 46 of every 48 ms: what held is not over with the first of two
    ms, but forgotten four times slower than it was counted."""
    list(watchdog.steps(0, 310, enabled=False))
    watchdog.state = State.FAULT
    stopped = [
        now for now in range(310, 400, 2)
        if watchdog.step(now, enabled=(now - 310) % 48 != 46) not in (BEAT, [])
    ]  # fmt: skip
    assert stopped == [364]
    assert broken(watchdog) is Requirement.DISARMED


@pytest.mark.parametrize(("off_ms", "over"), [(300, False), (302, True)])
def test_what_held_is_over_when_nothing_was_enabled_for_a_while(off_ms: int, over: bool) -> None:
    """198 of 200 ms; a quarter of 0.3 s would leave 123 of them."""
    patient = STRICT | {"supervisor.disarmed_ms": 200}
    watchdog = Watchdog(load("config/can.yaml", overrides=patient)[0])
    list(watchdog.steps(0, 310, enabled=False))
    watchdog.state = State.FAULT
    assert all(sent == BEAT for sent in watchdog.steps(310, 508, enabled=True))
    assert all(sent == BEAT for sent in watchdog.steps(508, 508 + off_ms, enabled=False))
    again = watchdog.steps(508 + off_ms, 706 + off_ms, enabled=True)
    assert all(sent == BEAT for sent in again) is over
    watchdog.supervisor.close()


def test_how_what_held_is_forgotten_while_nothing_is_enabled(config: Config) -> None:
    assert config.supervisor is not None
    judge = Judge(config, config.supervisor)

    def disarmed(at_ms: int) -> object:
        return judge(seen(at_ms, claim(State.FAULT, at_ms)))

    for start, off_ms, found in ((0, 100, False), (300, 100, True)):
        judge.forget()
        assert disarmed(start) is None
        assert disarmed(start + 48) is None
        judge.rest((start + 48 + off_ms) * MS)  # 25 ms less
        assert disarmed(start + 50 + off_ms) is None
        last = disarmed(start + 50 + off_ms + (25 if found else 24))
        assert (last is not None) is found


def test_what_is_forgotten_at_once(config: Config) -> None:
    assert config.supervisor is not None
    judge = Judge(config, config.supervisor)
    assert judge(seen(0.0, claim(State.FAULT, 0.0))) is None
    assert judge(seen(49.0, claim(State.FAULT, 49.0))) is None
    judge.forget()
    assert judge(seen(50.0, claim(State.FAULT, 50.0))) is None


@pytest.mark.parametrize("state", [State.SAFE_STOP, State.FAULT])
@pytest.mark.parametrize("booted", [False, True])
def test_drives_that_boot_and_are_not_heard_again(
    watchdog: Watchdog, state: State, booted: bool
) -> None:
    """All at once: those that have booted are off where the record is disarmed, and what they were
    where it is armed."""
    list(watchdog.steps(0, 310, enabled=False))
    drives = range(len(watchdog.wiring.axes))
    assert watchdog.step(310, enabled=True, beats=[(k, OPERATIONAL) for k in drives]) == BEAT
    watchdog.state = state
    deaf = {(axis.channel, axis.received) for axis in watchdog.wiring.axes}
    boots = [(k, BOOT_UP if booted else OPERATIONAL) for k in drives]
    assert watchdog.step(312, enabled=True, deaf=deaf, beats=boots) == BEAT
    list(watchdog.steps(314, 400, enabled=True, deaf=deaf))
    off = booted and state is State.FAULT
    assert (watchdog.supervisor.violation is None) is off


@pytest.mark.parametrize(
    ("beats", "forgotten"),
    [([], False), ([OPERATIONAL], False), ([BOOT_UP], True), ([BOOT_UP, OPERATIONAL], True)],
)
def test_an_amplifier_that_booted_has_no_error_of_before(
    watchdog: Watchdog, beats: list[int], forgotten: bool
) -> None:
    """It takes nothing back. An error that it reports later counts."""
    cell = watchdog.wiring.cells[0]
    place = [name for _, name, _ in watchdog.wiring.channels].index(cell.channel)

    def send(identifier: int, data: bytes) -> None:
        message = can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
        watchdog.buses[place].waiting.append(message)

    watchdog.step(0, enabled=False)
    errors = watchdog.supervisor._listeners[place].heard[cell.emergency]
    send(cell.emergency, struct.pack("<HB5x", 0x2310, 1))
    watchdog.step(2, enabled=False)
    assert errors.reports_error
    for beat in beats:
        send(cell.heartbeat, bytes([beat]))
    watchdog.step(4, enabled=False)
    assert errors.reports_error is not forgotten
    send(cell.emergency, struct.pack("<HB5x", 0x5010, 1))
    watchdog.step(6, enabled=False)
    assert errors.reports_error


@pytest.mark.parametrize("first", [OPERATIONAL, BOOT_UP])
def test_a_boot_up_is_remembered_until_the_drive_answers(watchdog: Watchdog, first: int) -> None:
    """However many heartbeats come after it; once it answers, it is forgotten."""
    axis = watchdog.wiring.axes[0]
    deaf = {(axis.channel, axis.received)}
    list(watchdog.steps(0, 310, enabled=False, beats=[(0, OPERATIONAL)]))
    assert watchdog.step(310, enabled=True) == BEAT
    watchdog.state = State.FAULT
    given = {"enabled": False, "deaf": deaf}
    assert watchdog.step(311, beats=[(0, first)], **given) == BEAT
    many = [(0, OPERATIONAL)] * 500
    sent = [watchdog.step(now, beats=many, **given) for now in range(312, 400, 2)]
    assert (BEAT in sent[-5:]) is (first == BOOT_UP)
    if first == BOOT_UP:
        assert watchdog.step(400, enabled=True) == BEAT
        sent = list(watchdog.steps(402, 500, beats=many[:1], **given))
        assert sent[-1] == [], "it may have its torque"


@pytest.mark.parametrize(("first_ms", "found_ms"), [(18, 190), (20, 74)])
def test_a_silent_drive_whose_heartbeats_are_far_apart(
    watchdog: Watchdog, first_ms: int, found_ms: int
) -> None:
    """Each 100 ms, as an EPOS4 sends them: one that comes less than 20 ms after the last process
    data may be of a drive that was pulled since. From the last process data to the drives' stop,
    22 ms after the last heartbeat, it is longer by so much."""
    axis = watchdog.wiring.axes[0]
    deaf = {(axis.channel, axis.received)}
    list(watchdog.steps(0, 310, enabled=False))
    assert watchdog.step(310, enabled=True) == BEAT
    watchdog.state = State.FAULT
    found = 0
    for now in range(312, 700, 2):
        beats = [(0, OPERATIONAL)] if (now - 310 - first_ms) % 100 == 0 else []
        if watchdog.step(now, enabled=False, deaf=deaf, beats=beats) != BEAT:
            found = now - 310
            break
    assert found + 22 == found_ms
    assert broken(watchdog) is Requirement.DISARMED


def test_which_records_are_new(watchdog: Watchdog) -> None:
    """The first of all, and each of a later tick, later by more than half of its time, that is not
    of the future: one of the future counts for nothing, also for those that follow."""
    risen = watchdog.supervisor._risen
    first, again = claim(at_ms=0.0, tick=0), claim(at_ms=0.0, tick=0)
    assert risen(0, [first]) == [first]
    assert risen(0, [again]) == []
    beyond = [claim(at_ms=1.000001, tick=7), claim(at_ms=1.0, tick=1)]
    assert [each.tick for each in risen(0, beyond)] == [1]
    later = [
        claim(at_ms=at_ms, tick=tick)
        for at_ms, tick in (
            *((1.0, 2), (1.5, 3), (1.500001, 4), (2.000001, 5), (2.1, 4), (1.6, 6)),
            *((2.000002, 7), (2.500003, 8), (2.6, 9)),
        )
    ]
    assert [each.tick for each in risen(2 * MS, later)] == [4, 7, 8]


def test_a_channel_of_cells_alone_is_no_other_drive(config: Config) -> None:
    """Where no drive answers any more all channels end for it, told, and until a reset."""
    bus = config.fieldbus.model_dump(mode="json")
    contact = bus["channels"][3]["force_cells"].pop()
    bus["channels"].append({"name": "can4", "force_cells": [contact]})
    watchdog = Watchdog(load("config/can.yaml", overrides=STRICT | {"fieldbus": bus})[0])
    watchdog.resets = False
    list(watchdog.steps(0, 320, enabled=False))
    deaf = {(axis.channel, axis.received) for axis in watchdog.wiring.axes}
    list(watchdog.steps(320, 330, enabled=True, everywhere=True))
    list(watchdog.steps(330, 370, enabled=True, everywhere=True, deaf=deaf))
    assert broken(watchdog) is Requirement.STALE
    assert not any(watchdog.steps(370, 1000, enabled=False))
    watchdog.supervisor.close()
