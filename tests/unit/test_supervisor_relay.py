"""The supervisor where no drive is on CAN: when it holds the relay of the drives' STO inputs, and
when it releases it. STO-2 and STO-3."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import can
import numpy as np
import pytest

from tests.unit.recorded_setup import (
    BEAT,
    HELD,
    MS,
    NODE,
    RELEASED,
    ROBOT,
    Held,
    disarmed,
    failed,
    out_of_bounds,
)
from tonus.config import Config, load
from tonus.config.schema.supervisor import Requirement


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/ethercat.yaml", overrides=ROBOT)[0]


@pytest.fixture
def held(config: Config) -> Iterator[Held]:
    made = Held(config)
    yield made
    made.supervisor.close()


def test_the_relay_is_held_when_nothing_was_enabled_for_a_while(held: Held) -> None:
    assert all(sent == [] for sent in held.steps(150, disarmed))
    assert held.step(disarmed) == [BEAT, HELD]
    assert held.step() == [BEAT, HELD]


def test_a_supervisor_that_finds_the_robot_armed_holds_nothing(held: Held) -> None:
    assert all(sent == [] for sent in held.steps(400))


def test_a_relay_that_does_not_answer_is_not_held(held: Held) -> None:
    held.answers = False
    assert all(sent == [] for sent in held.steps(400, disarmed))
    held.answers = True
    assert held.step(disarmed) == [BEAT, HELD]
    held.answers = False
    sent = list(held.steps(200, disarmed))
    assert sent[148] == [BEAT, HELD], "one that is late is no cause"
    assert RELEASED in sent[150]
    assert sent[151:] == [[]] * 49


def test_a_relay_that_answered_a_moment_ago_is_held(held: Held) -> None:
    list(held.steps(150, disarmed))
    held.answers = False
    assert held.step(disarmed) == [BEAT, HELD]


def test_without_a_record_it_holds_nothing(held: Held) -> None:
    held.recorded = False
    assert all(sent == [] for sent in held.steps(400))


def test_a_record_that_ends_while_nothing_is_enabled_releases_the_relay(held: Held) -> None:
    """It would not see that a drive is enabled. Nobody is told of a violation."""
    list(held.steps(160, disarmed))
    held.recorded = False
    assert held.step(disarmed) == [BEAT, HELD]
    assert held.step(disarmed) == [BEAT, HELD]
    assert held.step(disarmed) == [RELEASED]
    assert all(sent == [] for sent in held.steps(400, disarmed))
    assert held.supervisor.violation is None
    held.recorded = True
    assert held.step(disarmed) == [BEAT, HELD]


def test_a_record_may_be_as_old_as_the_patience_while_nothing_is_enabled(held: Held) -> None:
    list(held.steps(160, disarmed))
    assert held.look(5 * MS) == [BEAT, HELD]
    assert held.look(5 * MS + 1) == [RELEASED]


def test_a_record_that_ends_while_the_robot_is_armed_stops_it(held: Held) -> None:
    held.armed().recorded = False
    assert held.stopped_for(lambda _: None, within=3) == Requirement.TICK


def test_it_holds_the_relay_again_only_when_nothing_was_enabled_for_a_while(held: Held) -> None:
    held.armed()
    held.stopped_for(out_of_bounds)
    assert all(sent == [] for sent in held.steps(400)), "while a drive is enabled"
    assert held.step(failed) == []
    assert all(sent == [] for sent in held.steps(149, disarmed))
    assert held.step(disarmed) == [BEAT, HELD]


def test_a_look_that_lost_its_processor_switches_no_output_on(held: Held) -> None:
    """The node may have been started again meanwhile, and wait for no heartbeat."""
    list(held.steps(160, disarmed))
    held.spent_ns = 2 * MS
    assert held.step(disarmed) == [BEAT, HELD]
    held.spent_ns += 1
    assert held.step(disarmed) == []
    held.spent_ns = 0
    assert held.step(disarmed) == [BEAT, HELD]


@pytest.mark.parametrize(("gap_ms", "goes_on"), [(7, True), (8, False)])
def test_a_look_later_than_the_relays_node_waits(held: Held, gap_ms: int, goes_on: bool) -> None:
    """It has opened by then, whatever the supervisor's own margin is."""
    held.armed().later_ns = (gap_ms - 2) * MS
    sent = held.step()
    assert (BEAT in sent) is goes_on
    if not goes_on:
        assert sent[0][0] == 0x0FE
        assert struct.unpack("<HBBf", sent[0][1])[0] == 0xFF00 + Requirement.LATE


def test_a_bus_of_the_relay_that_is_gone_raises_nothing(held: Held) -> None:
    held.armed().bus.broken = True
    assert held.step() == []
    held.bus.broken = False
    assert held.step() == [BEAT, HELD]


def test_an_output_that_cannot_be_taken_back_is_taken_back_later(held: Held) -> None:
    held.armed().bus.broken = True
    assert held.step(out_of_bounds) == []
    list(held.steps(5, out_of_bounds))
    assert not held.supervisor.beating
    held.bus.broken = False
    assert held.step(out_of_bounds) == [RELEASED]
    assert held.step(out_of_bounds) == []


@pytest.mark.parametrize(
    ("identifier", "data"),
    [
        (0x600 + NODE, b"\x2b\x16\x10\1\0\0\0\0"),
        (0x600 + NODE, b"\x0d\0\0\0\0\0\0\0"),
        (0x000, b"\x80" + bytes([NODE])),
        (0x200 + NODE, b"\1"),
        (0x200 + NODE, b"\1\0"),
        (0x77E, b"\5"),
    ],
)
def test_what_another_sends_to_the_node_of_the_relay(
    held: Held, identifier: int, data: bytes
) -> None:
    """Its settings, its state, its output, or the heartbeat that it waits for. The bus of this test
    tells nothing of what was sent, so as many of a stranger's have to come."""
    held.armed()
    again = 1 if identifier in (0x000, 0x600 + NODE) else 200
    for _ in range(again):
        message = can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
        held.bus.waiting.append(message)
    assert held.stopped_for(lambda _: None, within=1) == Requirement.COMMANDED


@pytest.mark.parametrize("frame", [BEAT, HELD])
def test_its_own_frames_that_come_back_are_no_strangers(
    held: Held, frame: tuple[int, bytes]
) -> None:
    """More than a bus may repeat are."""
    held.bus.echoes = True
    identifier, data = frame
    message = can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
    held.armed().bus.waiting += [message] * 16
    assert held.step() == [BEAT, HELD]
    held.bus.waiting.append(message)
    assert held.stopped_for(lambda _: None, within=1) == Requirement.COMMANDED


def test_a_frame_without_the_output_sets_none(held: Held) -> None:
    empty = can.Message(arbitration_id=0x200 + NODE, is_extended_id=False)
    held.armed().bus.waiting += [empty] * 200
    assert held.step() == [BEAT, HELD]


@pytest.mark.parametrize(("stalled_ms", "goes_on"), [(7, True), (8, False)])
def test_a_stall_in_which_the_relay_has_opened(held: Held, stalled_ms: int, goes_on: bool) -> None:
    """Its node waits for 7 ms, drives on CAN for 22: nothing is held before it begins anew."""
    list(held.steps(160, disarmed))
    held._now += stalled_ms - 2
    sent = list(held.steps(150, disarmed))
    assert [each == [BEAT, HELD] for each in sent] == [goes_on] * 150
    assert [BEAT, HELD] in list(held.steps(3, disarmed))


@pytest.mark.parametrize(("timeout_ms", "relay_ms"), [(5, 20), (22, 7), (22, 60)])
def test_single_heartbeats_are_farther_apart_than_the_relays_node_waits(
    timeout_ms: int, relay_ms: int
) -> None:
    """Its output was not taken back, since that frame was lost: it ends with the node's watch."""
    times = {"supervisor.timeout_ms": timeout_ms, "sto_relay.timeout_ms": relay_ms}
    settings = ROBOT | times | {"supervisor.policy": "require"}
    held = Held(load("config/ethercat.yaml", overrides=settings)[0]).armed()

    def opposed(record: Any) -> None:
        record["drives"]["torque_command"] = record["drives"]["torque"] = -1.0

    beats = [2 * look for look, sent in enumerate(held.steps(400, opposed)) if BEAT in sent]
    singles = np.diff([each for each in beats if each > 100])
    assert len(singles) > 3
    assert singles.min() >= 2 * max(timeout_ms, relay_ms)


@pytest.mark.parametrize("recovered", [False, True])
def test_a_relays_node_that_restarted_at_rest_is_brought_up_before_it_is_used(
    held: Held, recovered: bool
) -> None:
    """It waits for no heartbeat any more, and would hold its output without one."""
    list(held.steps(160, disarmed))
    held.bus.waiting.append(
        can.Message(arbitration_id=0x700 + NODE, is_extended_id=False, data=b"\0")
    )
    list(held.steps(20, disarmed))
    if recovered:
        list(held.steps(2, failed))
        list(held.steps(20, disarmed))
    sent = list(held.steps(20))
    assert all(each == [BEAT, HELD] for each in sent) is recovered
    violation = held.supervisor.violation
    assert recovered or (violation and violation.requirement) is Requirement.COMMANDED


def test_an_output_is_not_set_before_a_heartbeat_was_sent(
    held: Held, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The node, just started, would wait for none."""
    list(held.steps(150, disarmed))
    send = held.bus.send

    def refused(message: can.Message, timeout: float | None = None) -> None:
        if message.arbitration_id == BEAT[0]:
            raise can.CanError("no room")
        send(message, timeout)

    monkeypatch.setattr(held.bus, "send", refused)
    assert all(sent == [] for sent in held.steps(20, disarmed))


def test_the_relays_node_may_be_started_at_rest(held: Held) -> None:
    """By the daemon, after its watch has stopped it. It is not what a reset by NMT makes of it."""
    list(held.steps(160, disarmed))
    for command, goes_on in ((b"\1", True), (b"\x81", False)):
        data = command + bytes([NODE])
        held.bus.waiting.append(can.Message(arbitration_id=0, is_extended_id=False, data=data))
        sent = list(held.steps(20, disarmed))
        assert (sent[-1] == [BEAT, HELD]) is goes_on
