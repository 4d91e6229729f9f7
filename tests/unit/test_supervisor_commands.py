"""What devices are commanded beside their process data, and devices that are not as they were
brought up (SUP-27)."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import can
import pytest

from tests.unit.supervisor_setup import STRICT, Watchdog, broken
from tonus.config import Config, load
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import State
from tonus.runtime.supervisor.judge import NOWHERE, Violation

BEAT = [(0x77E, b"\5")]
BOOT_UP, OPERATIONAL = 0x00, 0x05
MS = 1_000_000
RAMP, OFFSET = struct.pack("<BHBI", 0x23, 0x6085, 0, 1), struct.pack("<BHBI", 0x2B, 0x60B2, 0, 1)
BEGUN = struct.pack("<BHBI", 0x21, 0x6040, 0, 2)
BEGUN_OTHER = struct.pack("<BHBI", 0x21, 0x6085, 0, 4)
SEGMENT = b"\x0b\x0f\0\0\0\0\0\0"
RESET_BY_SDO = struct.pack("<BHBI", 0x2B, 0x6040, 0, 0x80)
"""requests to write: at once, with data that come later, those data, and a fault reset"""


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


@pytest.fixture
def watchdog(config: Config) -> Iterator[Watchdog]:
    made = Watchdog(config)
    yield made
    made.supervisor.close()


OBJECTS = {
    (0x23, 0x60B2): True,
    (0x2B, 0x6040): True,
    (0x2F, 0x6060): True,
    (0x20, 0x6071): True,
    (0x21, 0x1016): True,
    (0xC2, 0x1016): True,
    (0x40, 0x6041): False,
    (0x60, 0x603F): False,
    (0x80, 0x603F): False,
    (0xA0, 0x1003): False,
    (0x00, 0x1003): True,
    (0x1D, 0x1016): True,
}


@pytest.mark.parametrize(("request_", "stopped"), OBJECTS.items())
@pytest.mark.parametrize("enabled", [True, False])
def test_what_is_asked_of_a_drive_beside_its_process_data(
    watchdog: Watchdog, request_: tuple[int, int], stopped: bool, enabled: bool
) -> None:
    """To read is allowed, and to write while none is enabled: a bring-up does. What goes on with a
    download names no object."""
    axis = watchdog.wiring.axes[1]
    data = struct.pack("<BHBi", *request_, 0, 1)
    found = commanded(watchdog, axis.request, data, enabled=enabled)
    index = request_[1] if request_[0] & 0xE0 else 0
    stops = stopped and (enabled or index == 0x6040)
    assert found == ((6, index) if stops else None)


@pytest.mark.parametrize(
    ("kind", "word", "stopped"),
    [
        (0x2B, 0x01, True),
        (0x2B, 0x06, True),
        (0x2B, 0x08, True),
        (0x2B, 0x80, False),
        (0x2B, 0x8F, True),
        (0x22, 0x0F, True),
        (0x21, 0x00, True),
        (0xC2, 0x00, True),
        (0x00, 0x0F, False),
    ],
)
def test_a_controlword_beside_the_process_data_where_no_drive_is_enabled(
    watchdog: Watchdog, kind: int, word: int, stopped: bool
) -> None:
    """One that leads to power is never written, nor one of which the word comes later: what it
    leads to no process data may show. A bring-up resets faults."""
    data = struct.pack("<BHBi", kind, 0x6040, 0, word)
    found = commanded(watchdog, watchdog.wiring.axes[1].request, data, enabled=False)
    assert found == ((6, 0x6040) if stopped else None)


def written(watchdog: Watchdog, data: bytes) -> None:
    """To a drive of the first channel, before the next look."""
    request = watchdog.wiring.axes[1].request
    message = can.Message(arbitration_id=request, is_extended_id=False, data=data)
    watchdog.buses[0].waiting.append(message)


@pytest.mark.parametrize("before", [each for each in State if each is not State.FAULT])
@pytest.mark.parametrize("after", [State.OFF, State.STANDBY, State.REFERENCING])
def test_a_download_at_rest(watchdog: Watchdog, before: State, after: State) -> None:
    """No drive is enabled, and the record goes on: nobody brings anything up."""
    watchdog.state = before
    list(watchdog.steps(0, 310, enabled=False))
    written(watchdog, RAMP)
    assert watchdog.step(310, enabled=False) == BEAT, "there is no later record yet"
    watchdog.state = after
    sent = watchdog.step(312, enabled=False)
    assert struct.unpack("<HBBf", sent[0][1]) == (0xFF1B, 0x81, 6, 0x6085)
    assert len(sent) == 1, "and no heartbeat"
    assert broken(watchdog) is Requirement.COMMANDED
    assert watchdog.step(314, enabled=False) == []


def test_a_fault_that_is_reset_beside_the_process_data_at_rest(watchdog: Watchdog) -> None:
    """It changes nothing that a bring-up has made of the drive."""
    watchdog.state = State.STANDBY
    list(watchdog.steps(0, 310, enabled=False))
    written(watchdog, RESET_BY_SDO)
    assert list(watchdog.steps(310, 330, enabled=False)) == [BEAT] * 10


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (State.FAULT, State.FAULT),
        (State.FAULT, State.STANDBY),
        (State.STANDBY, State.FAULT),
    ],
)
def test_a_download_in_which_a_drive_is_brought_back(
    watchdog: Watchdog, before: State, after: State
) -> None:
    watchdog.state = before
    list(watchdog.steps(0, 310, enabled=False))
    written(watchdog, RAMP)
    watchdog.state = after
    assert all(sent == BEAT for sent in watchdog.steps(310, 330, enabled=False))


@pytest.mark.parametrize("pause_ms", [2, 12, 200, 1000])
@pytest.mark.parametrize("into_ms", [0, 2, 8, 180])
def test_a_download_while_the_record_pauses(
    watchdog: Watchdog, pause_ms: int, into_ms: int
) -> None:
    """It counts once that goes on."""
    watchdog.state = State.STANDBY
    list(watchdog.steps(0, 310, enabled=False))
    for now in range(310, 310 + pause_ms, 2):
        if now == 310 + into_ms:
            written(watchdog, RAMP)
        assert watchdog.step(now, enabled=False, tick=False) == BEAT
    stopped = [
        sent != BEAT for sent in watchdog.steps(310 + pause_ms, 330 + pause_ms, enabled=False)
    ]
    assert stopped == [into_ms < pause_ms] * 10


def test_the_first_of_two_downloads_is_told(watchdog: Watchdog) -> None:
    watchdog.state = State.STANDBY
    list(watchdog.steps(0, 310, enabled=False))
    for data, now_ms in ((RAMP, 310), (OFFSET, 312)):
        written(watchdog, data)
        watchdog.step(now_ms, enabled=False, tick=False)
    sent = watchdog.step(313, enabled=False)
    assert struct.unpack("<HBBf", sent[0][1])[3] == 0x6085


@pytest.mark.parametrize("state", [State.REFERENCING, State.HOLD])
@pytest.mark.parametrize("recovered", [False, True])
def test_a_device_that_has_restarted_is_armed_by_no_daemon_in_order(
    watchdog: Watchdog, state: State, recovered: bool
) -> None:
    """It has lost what the bring-up made of it; only FAULT, in which it is brought up again, ends
    that. In a stop, which may last, it does no harm."""
    watchdog.state = State.STANDBY
    list(watchdog.steps(0, 310, enabled=False))
    axis = watchdog.wiring.axes[5]
    watchdog.step(310, enabled=False, beats=[(axis.number, 0)])
    assert all(sent == BEAT for sent in watchdog.steps(312, 320, enabled=False))
    if recovered:
        watchdog.state = State.FAULT
        assert all(sent == BEAT for sent in watchdog.steps(320, 330, enabled=False))
        watchdog.state = State.STANDBY
        assert all(sent == BEAT for sent in watchdog.steps(330, 340, enabled=False))
    watchdog.state = state
    sent = list(watchdog.steps(340, 350, enabled=False))
    assert [each == BEAT for each in sent] == [recovered] * 5
    found = watchdog.supervisor.violation
    assert recovered or found == Violation(Requirement.COMMANDED, NOWHERE, 0.0)


@pytest.mark.parametrize("state", [State.OFF, State.REFERENCING, State.SAFE_STOP])
@pytest.mark.parametrize("armed", [State.REFERENCING, State.ACTIVE])
def test_nor_where_the_record_has_no_standby(
    watchdog: Watchdog, state: State, armed: State
) -> None:
    """Of a state of control, power tells that it is armed: a daemon in order sees the restart as
    soon, and may record that state for some ms more."""
    watchdog.state = state
    list(watchdog.steps(0, 310, enabled=False))
    axis = watchdog.wiring.axes[5]
    watchdog.step(310, enabled=False, beats=[(axis.number, 0)])
    assert all(sent == BEAT for sent in watchdog.steps(312, 320, enabled=False))
    watchdog.state = armed
    sent = list(watchdog.steps(320, 330, enabled=True))
    assert BEAT not in sent
    assert watchdog.supervisor.violation == Violation(Requirement.COMMANDED, NOWHERE, 0.0)


def test_devices_that_boot_before_there_is_a_record(watchdog: Watchdog) -> None:
    """In the bring-up."""
    list(watchdog.steps(0, 100, enabled=False, tick=False))
    watchdog.boot()
    list(watchdog.steps(100, 120, enabled=False, tick=False))
    watchdog.state = State.STANDBY
    list(watchdog.steps(120, 500, enabled=False))
    watchdog.state = State.REFERENCING
    assert all(sent == BEAT for sent in watchdog.steps(500, 510, enabled=False))


def test_a_device_that_restarts_while_the_robot_stops(watchdog: Watchdog) -> None:
    list(watchdog.steps(0, 310, enabled=False))
    assert all(sent == BEAT for sent in watchdog.steps(310, 330, enabled=True))
    number = watchdog.wiring.axes[5].number
    assert watchdog.step(330, enabled=True, beats=[(number, 0)]) == BEAT
    assert all(sent == BEAT for sent in watchdog.steps(332, 400, enabled=True))


def beginnings(watchdog: Watchdog, start: int, stop: int, **given: bool) -> list[int]:
    """ms at which a heartbeat was sent."""
    steps = watchdog.steps(start, stop, enabled=False, **given)
    return [now for now, sent in zip(range(start, stop, 2), steps, strict=True) if sent == BEAT]


def changed(watchdog: Watchdog) -> None:
    """It has stopped at 312 ms for a download in STANDBY."""
    watchdog.state = State.STANDBY
    list(watchdog.steps(0, 310, enabled=False))
    written(watchdog, RAMP)
    watchdog.step(310, enabled=False)
    assert watchdog.step(312, enabled=False) != BEAT


def test_it_does_not_begin_while_a_device_is_not_as_it_was_brought_up(watchdog: Watchdog) -> None:
    """The daemon brings all up again in FAULT, each from its boot-up on."""
    changed(watchdog)
    assert beginnings(watchdog, 314, 1000) == []
    watchdog.state = State.FAULT
    assert beginnings(watchdog, 1000, 1004) == []
    watchdog.state = State.STANDBY
    assert beginnings(watchdog, 1004, 1100) == []
    watchdog.boot()
    assert beginnings(watchdog, 1100, 1200)[:1] == [1100]


@pytest.mark.parametrize("amplifier", [False, True])
def test_nor_while_one_of_them_has_not_booted(watchdog: Watchdog, amplifier: bool) -> None:
    """Those of before what others did do not count; of the last one, by itself, it does."""
    devices = watchdog.wiring.cells if amplifier else watchdog.wiring.axes
    last = (devices[-1].channel, devices[-1].heartbeat)
    watchdog.boot()
    changed(watchdog)
    watchdog.state = State.FAULT
    watchdog.boot(but=last)
    assert beginnings(watchdog, 314, 1000) == []
    beat = can.Message(arbitration_id=last[1], is_extended_id=False, data=b"\0")
    place = [channel for _, channel, _ in watchdog.wiring.channels].index(last[0])
    watchdog.buses[place].waiting.append(beat)
    watchdog.state = State.STANDBY
    assert beginnings(watchdog, 1000, 1100)[:1] == [1000]


@pytest.mark.parametrize("state", [State.STANDBY, State.OFF])
def test_what_others_did_is_told_until_the_daemon_knows(watchdog: Watchdog, state: State) -> None:
    """Every quiet_s, as it was told first."""
    changed(watchdog)
    watchdog.state = state
    told = [bus.sent[-1] for bus in watchdog.buses]
    assert {message.arbitration_id for message in told} == {0x0FE}
    steps = list(watchdog.steps(314, 1000, enabled=False))
    again = [(314 + 2 * place, sent) for place, sent in enumerate(steps) if sent]
    assert [now for now, _ in again] == [610, 910]
    assert all(sent == [(0x0FE, bytes(told[0].data))] for _, sent in again)
    assert all(len(bus.sent) == len(watchdog.buses[0].sent) for bus in watchdog.buses[1:])
    watchdog.state = State.FAULT
    assert not any(watchdog.steps(1000, 2000, enabled=False))


def test_what_others_did_is_told_in_standby_while_a_device_has_not_booted(
    watchdog: Watchdog,
) -> None:
    """The daemon went to FAULT by itself, and the one frame before that was lost. In FAULT nothing
    is told, since it may be bringing the devices up."""
    changed(watchdog)
    told = [(0x0FE, bytes(watchdog.buses[0].sent[-1].data))]
    watchdog.state = State.FAULT
    assert not any(watchdog.steps(314, 800, enabled=False))
    watchdog.state = State.STANDBY
    again = list(watchdog.steps(800, 1500, enabled=False))
    assert [800 + 2 * place for place, sent in enumerate(again) if sent] == [800, 1100, 1400]
    assert all(sent in ([], told) for sent in again)
    watchdog.state = State.FAULT
    assert not any(watchdog.steps(1500, 2000, enabled=False))
    watchdog.boot()
    watchdog.state = State.STANDBY
    assert all(sent == BEAT for sent in watchdog.steps(2000, 2400, enabled=False))


@pytest.mark.parametrize("state", [State.OFF, State.STANDBY])
def test_a_record_that_pauses_is_no_bring_up(watchdog: Watchdog, state: State) -> None:
    """Also one that goes on with OFF, as that of another daemon begins: each has its own
    supervisor."""
    changed(watchdog)
    beats = beginnings(watchdog, 314, 700, tick=False)
    watchdog.state = state
    watchdog.boot()
    beats += beginnings(watchdog, 700, 1400)
    assert beats == []


def test_a_download_while_it_is_silent_is_told_too(watchdog: Watchdog) -> None:
    """By one emergency frame, though no heartbeat goes."""
    watchdog.state = State.STANDBY
    list(watchdog.steps(0, 100, enabled=False))
    written(watchdog, RAMP)
    assert watchdog.step(100, enabled=False) == []
    ((identifier, data),) = watchdog.step(102, enabled=False)
    assert (identifier, data[:2]) == (0x0FE, b"\x1b\xff")
    written(watchdog, OFFSET)
    assert all(sent == [] for sent in watchdog.steps(104, 120, enabled=False))


def test_what_others_do_is_told_once_where_no_heartbeat_goes(watchdog: Watchdog) -> None:
    changed(watchdog)
    written(watchdog, struct.pack("<BHBI", 0x2B, 0x6040, 0, 0x0F))
    assert watchdog.step(314, enabled=False) == []


@pytest.mark.parametrize("size", range(1, 8))
def test_a_request_shorter_than_any_device_should_take(watchdog: Watchdog, size: int) -> None:
    list(watchdog.steps(0, 310, enabled=False))
    watchdog.step(310, enabled=True)
    written(watchdog, RAMP[:size])
    watchdog.step(312, enabled=True)
    assert broken(watchdog) is Requirement.COMMANDED


def test_a_download_that_is_found_at_once_is_told_once(watchdog: Watchdog) -> None:
    list(watchdog.steps(0, 310, enabled=False))
    watchdog.step(310, enabled=True)
    written(watchdog, RAMP)
    assert len(watchdog.step(312, enabled=True)) == 1
    assert all(sent == [] for sent in watchdog.steps(314, 320, enabled=True))


def test_what_else_is_found_does_not_hide_a_download(watchdog: Watchdog) -> None:
    """A look that comes late."""
    watchdog.state = State.STANDBY
    list(watchdog.steps(0, 310, enabled=False))
    written(watchdog, RAMP)
    watchdog.step(310, enabled=False)
    watchdog.step(320, enabled=True)
    assert broken(watchdog) is Requirement.COMMANDED


@pytest.mark.parametrize(
    ("requests", "stopped"),
    [
        ((BEGUN, SEGMENT), True),
        ((BEGUN, SEGMENT, SEGMENT), True),
        ((SEGMENT,), False),
        ((BEGUN_OTHER, SEGMENT), False),
        ((BEGUN, BEGUN_OTHER, SEGMENT), False),
        ((BEGUN, RAMP, SEGMENT), False),
        ((BEGUN, RESET_BY_SDO, SEGMENT), False),
    ],
)
def test_power_by_a_download_in_segments(
    watchdog: Watchdog, requests: tuple[bytes, ...], stopped: bool
) -> None:
    """Its word comes behind its beginning. Before the record there is nothing else to judge by."""
    list(watchdog.steps(0, 310, enabled=False, tick=False))
    *before, last = requests
    commands = watchdog.supervisor._commands
    for data in before:
        written(watchdog, data)
    watchdog.step(310, enabled=False, tick=False)
    written(watchdog, last)
    watchdog.step(312, enabled=False, tick=False)
    assert commands.led == ([6] if stopped else [])


def test_power_that_is_switched_off_beside_the_process_data(watchdog: Watchdog) -> None:
    """With that the daemon ends: 0 to the controlword, and nothing else."""
    request = watchdog.wiring.axes[1].request
    for word, found in ((0, None), (0x0F, (6, 0x6040))):
        data = struct.pack("<BHBi", 0x2B, 0x6040, 0, word)
        assert commanded(watchdog, request, data, enabled=True) == found


@pytest.mark.parametrize("more", [b"", b"\0"])
@pytest.mark.parametrize(
    ("code", "node", "found"),
    [
        (0x02, 7, (6, 0x02)),
        (0x80, 7, (6, 0x80)),
        (0x81, 0, (6, 0x81)),
        (0x82, 1, (0, 0x82)),
        (0x01, 7, (6, 0x01)),
        (0x82, 17, (0xFF, 0x82)),
        (0x82, 3, None),
    ],
)
def test_commands_of_the_network(
    watchdog: Watchdog, code: int, node: int, found: tuple[int, int] | None, more: bytes
) -> None:
    """A drive of another channel has not heard it. To start is one: whether a drive then drops the
    process data that wait for SYNC is its maker's."""
    assert commanded(watchdog, 0x000, bytes((code, node)) + more, enabled=True) == found


@pytest.mark.parametrize("state", [State.OFF, State.STANDBY, State.SAFE_STOP])
@pytest.mark.parametrize("code", [0x01, 0x02, 0x80, 0x81, 0x82])
def test_a_command_of_the_network_at_rest(watchdog: Watchdog, state: State, code: int) -> None:
    """A reset node is not as the bring-up has made it, nor is one that has to be started; its
    boot-up may have been lost."""
    watchdog.state = state
    assert commanded(watchdog, 0x000, bytes([code, 0]), enabled=False) is None
    sent = watchdog.step(312, enabled=False)
    assert sent != BEAT
    assert struct.unpack("<HBBf", sent[0][1]) == (0xFF1B, 0x81, 6, code)
    assert broken(watchdog) is Requirement.COMMANDED


def test_a_command_of_before_is_over(watchdog: Watchdog) -> None:
    watchdog.state = State.FAULT
    assert commanded(watchdog, 0x000, b"\x82\0", enabled=False) is None
    watchdog.state = State.REFERENCING
    assert watchdog.step(312, enabled=True) == BEAT


def commanded(
    watchdog: Watchdog, identifier: int, data: bytes, *, enabled: bool
) -> tuple[int, int] | None:
    """Place and value of the violation when a frame of the first channel is read."""
    list(watchdog.steps(0, 310, enabled=False))
    message = can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
    watchdog.buses[0].waiting.append(message)
    sent = watchdog.step(310, enabled=enabled)
    if sent == BEAT:
        return None
    code, _, place, value = struct.unpack("<HBBf", sent[0][1])
    assert code == 0xFF1B
    return place, int(value)


@pytest.mark.parametrize(("silent_ms", "watched"), [(22, True), (24, True), (26, False)])
def test_an_answer_of_before_power_beside_the_process_data(
    config: Config, silent_ms: int, watched: bool
) -> None:
    """In the look in which a controlword is read, and in the next one: the drive may have answered
    before it acted. Nothing is heard of it afterwards."""
    assert config.supervisor is not None
    settings = config.supervisor.model_copy(update={"policy": "require"})
    made = Watchdog(config.model_copy(update={"supervisor": settings}))
    axis = made.wiring.axes[0]
    list(made.steps(0, 20, enabled=False))
    data = bytes.fromhex("2b4060000f000000")
    frame = can.Message(arbitration_id=axis.request, is_extended_id=False, data=data)
    made.buses[0].waiting.append(frame)
    list(made.steps(20, silent_ms, enabled=False))
    deaf = {(axis.channel, axis.received)}
    sent = list(made.steps(silent_ms, 100, enabled=False, deaf=deaf))
    assert (BEAT in sent) is watched
    made.supervisor.close()


def test_power_in_a_stop_after_a_device_has_restarted(watchdog: Watchdog) -> None:
    """A stop gives none that was gone: the device may have forgotten what ends it."""
    watchdog.resets = False
    watchdog.state = State.STANDBY
    list(watchdog.steps(0, 310, enabled=False))
    watchdog.state = State.SAFE_STOP
    assert all(sent == BEAT for sent in watchdog.steps(310, 330, enabled=True))
    number = watchdog.wiring.axes[5].number
    for now in range(330, 430, 2):
        beats = [(number, 0)] if now == 340 else []
        assert watchdog.step(now, enabled=False, beats=beats) == BEAT
    watchdog._powered = True  # without a record of REFERENCING
    sent = list(watchdog.steps(430, 436, enabled=True))
    assert BEAT not in sent[1:]
    assert watchdog.supervisor.violation == Violation(Requirement.COMMANDED, NOWHERE, 0.0)
