"""Drives that have power although no heartbeat goes: for how long they count so, and the single
heartbeats that begin their watch; and the looks in which the heartbeat begins."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import can
import numpy as np
import pytest

from tests.unit.supervisor_setup import STRICT, EchoBus, Watchdog
from tonus.config import Config, load
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import State

BEAT = [(0x77E, b"\5")]
BOOT_UP = (0, 0x00)
"""of the first drive"""
GIVE_POWER = struct.pack("<BHBI", 0x2B, 0x6040, 0, 0x0F)
RAMP = struct.pack("<BHBI", 0x23, 0x6085, 0, 1)
"""requests to write the controlword, and an object that a bring-up writes"""
SINGLE_MS = 44
"""from when a channel's drives have power on, and from one single heartbeat to the next"""


@pytest.fixture(scope="module")
def required() -> Config:
    given = STRICT | {"supervisor.policy": "require"}
    return load("config/can.yaml", overrides=given)[0]


@pytest.fixture
def watchdog(required: Config) -> Iterator[Watchdog]:
    made = Watchdog(required)
    yield made
    made.supervisor.close()


def deaf_to_the_first(watchdog: Watchdog) -> set[tuple[str, int]]:
    axis = watchdog.wiring.axes[0]
    return {(axis.channel, axis.received)}


def written(watchdog: Watchdog, data: bytes) -> None:
    """To the first drive, before the next look."""
    request = watchdog.wiring.axes[0].request
    message = can.Message(arbitration_id=request, is_extended_id=False, data=data)
    watchdog.buses[0].waiting.append(message)


def beats(watchdog: Watchdog, start: int, stop: int, **given: Any) -> list[int]:
    """ms of the looks that sent a heartbeat, no drive enabled."""
    steps = watchdog.steps(start, stop, enabled=False, **given)
    return [now for now, sent in zip(range(start, stop, 2), steps, strict=True) if sent == BEAT]


@pytest.mark.parametrize("boots_ms", [0, 30])
def test_a_silent_drive_that_was_given_power_and_boots_has_none(
    watchdog: Watchdog, boots_ms: int
) -> None:
    watchdog.state = State.STANDBY
    silent = deaf_to_the_first(watchdog)
    list(watchdog.steps(2, 20, enabled=False))
    written(watchdog, GIVE_POWER)
    watchdog.step(20, enabled=False, deaf=silent)
    found = []
    for now in range(22, 200, 2):
        booting = [BOOT_UP] if now == boots_ms else []
        if watchdog.step(now, enabled=False, deaf=silent, beats=booting) == BEAT:
            found.append(now)
    assert found == ([] if boots_ms else [20 + k * SINGLE_MS for k in (1, 2, 3, 4)])


def test_one_that_boots_before_it_is_given_power(watchdog: Watchdog) -> None:
    """A boot-up says nothing of what comes after it."""
    watchdog.state = State.STANDBY
    silent = deaf_to_the_first(watchdog)
    list(watchdog.steps(2, 20, enabled=False))
    watchdog.step(20, enabled=False, deaf=silent, beats=[BOOT_UP])
    written(watchdog, GIVE_POWER)
    assert beats(watchdog, 22, 200, deaf=silent)[:2] == [22 + SINGLE_MS, 22 + 2 * SINGLE_MS]


def test_a_silent_drive_whose_process_data_gave_it_power(watchdog: Watchdog) -> None:
    """In one look, and no more of it is heard."""
    silent = deaf_to_the_first(watchdog)
    list(watchdog.steps(2, 20, enabled=False))
    watchdog.step(20, enabled=False, deaf=silent, powered=(0,))
    assert beats(watchdog, 22, 200, deaf=silent)[:2] == [20 + SINGLE_MS, 20 + 2 * SINGLE_MS]


def test_one_that_booted_and_whose_process_data_give_it_power(watchdog: Watchdog) -> None:
    """It counts as enabled while they do, whatever its silence was before."""
    watchdog.state = State.FAULT
    silent = deaf_to_the_first(watchdog)
    assert beats(watchdog, 2, 320, beats=[(0, 5)])[-1:] == [318]
    watchdog.step(320, enabled=False, deaf=silent, beats=[BOOT_UP])
    list(watchdog.steps(322, 350, enabled=False, deaf=silent))
    assert watchdog.supervisor.violation is None
    for now in range(350, 420, 2):
        watchdog.step(now, enabled=False, deaf=silent, powered=(0,))
    found = watchdog.supervisor.violation
    assert found is not None
    assert found.requirement is Requirement.DISARMED


@pytest.mark.parametrize("late_ms", [0.5, 0.9])
def test_an_answer_shortly_before_the_power_is_none_after_it(
    watchdog: Watchdog, late_ms: float
) -> None:
    """Looks that follow each other within a millisecond: it is off by no answer of its own."""
    silent = deaf_to_the_first(watchdog)
    list(watchdog.steps(2, 20, enabled=False))
    written(watchdog, GIVE_POWER)
    watchdog.step(20.0, enabled=False)
    watchdog.step(20.0 + late_ms / 2, enabled=False, deaf=silent)
    watchdog.step(20.0 + late_ms, enabled=False, deaf=silent)
    assert beats(watchdog, 22, 100, deaf=silent)


def test_they_go_on_after_the_pause_in_which_it_would_begin(watchdog: Watchdog) -> None:
    """No drive counts as enabled for 0.3 s; the one that was given power may be."""
    silent = deaf_to_the_first(watchdog)
    list(watchdog.steps(2, 20, enabled=False))
    written(watchdog, GIVE_POWER)
    found = beats(watchdog, 20, 600, deaf=silent)
    assert found == [*range(20 + SINGLE_MS, 600, SINGLE_MS)]


def test_one_that_was_lost_counts_no_more_once_the_next_is_sent(required: Config) -> None:
    """The third comes twice their time after the second, which the interface tells of; the second
    waits eight times it, for one that may wait in a queue still."""
    made = Watchdog(required, EchoBus)
    first = made.buses[0]
    assert isinstance(first, EchoBus)
    for now in range(0, 332, 2):
        made.step(now, enabled=now == 330)
        for bus in made.buses:
            assert isinstance(bus, EchoBus)
            bus.let_out()
    found = []
    for now in range(332, 900, 2):
        if made.step(now, enabled=True, tick=False) == BEAT and now > 340:
            found.append(now)
        if len(found) == 1:
            first.queue.clear()
        first.let_out()
    apart = np.diff(found).tolist()
    assert apart[0] == 4 * SINGLE_MS
    # One that is told of begins their time anew, a look later.
    assert set(apart[1:]) == {SINGLE_MS + 2}
    made.supervisor.close()


def test_a_beginning_that_the_interface_does_not_take(required: Config) -> None:
    """The next look sends it, also if a drive has power by then: it has begun."""
    made = Watchdog(required, EchoBus)
    first = made.buses[0]
    assert isinstance(first, EchoBus)
    first.full = True
    list(made.steps(0, 302, enabled=False))
    assert made.supervisor.beating
    first.full = False
    assert made.step(302, enabled=True) == BEAT
    made.supervisor.close()


def test_a_download_before_the_first_record(watchdog: Watchdog) -> None:
    """It is of the bring-up, whatever the record begins with."""
    watchdog.state = State.STANDBY
    written(watchdog, RAMP)
    watchdog.step(0, enabled=False, tick=False)
    list(watchdog.steps(2, 20, enabled=False))
    assert watchdog.supervisor.violation is None


def test_a_look_that_is_late_and_finds_a_download(watchdog: Watchdog) -> None:
    """It does not begin again before the devices are brought up, as where the look is in time."""
    list(watchdog.steps(0, 310, enabled=False))
    assert watchdog.step(310, enabled=True) == BEAT
    written(watchdog, RAMP)
    assert len(watchdog.step(330, enabled=True)) == 1
    found = watchdog.supervisor.violation
    assert found is not None
    assert found.requirement is Requirement.COMMANDED
    assert beats(watchdog, 332, 800) == []


@pytest.mark.parametrize("code", [0x8110, 0x8210])
def test_an_amplifier_that_reports_an_error_of_the_bus(watchdog: Watchdog, code: int) -> None:
    """What it measures is not wrong for it, nor right again."""
    cell = watchdog.wiring.cells[0]
    place = [name for _, name, _ in watchdog.wiring.channels].index(cell.channel)
    errors = watchdog.supervisor._listeners[place].heard[cell.emergency]
    for now, reported, wrong in ((0, code, False), (2, 0x5010, True), (4, code, True)):
        data = struct.pack("<HB5x", reported, 1)
        message = can.Message(arbitration_id=cell.emergency, is_extended_id=False, data=data)
        watchdog.buses[place].waiting.append(message)
        watchdog.step(now, enabled=False)
        assert errors.reports_error is wrong
