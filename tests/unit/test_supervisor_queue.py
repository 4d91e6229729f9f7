"""Heartbeats on their way: those that wait in a transmit queue, that another sends in the
supervisor's name, and the one that begins the watch of drives that nobody watches."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import can
import numpy as np
import pytest

from tests.unit.supervisor_setup import STRICT, EchoBus, Watchdog, broken
from tonus.config import Config, load
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import State
from tonus.runtime.supervisor.commands import Own
from tonus.runtime.supervisor.listener import Heard
from tonus.tools.run.supervision import open_bus

BEAT = [(0x77E, b"\5")]
MS = 1_000_000


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


@pytest.fixture(scope="module")
def required(config: Config) -> Config:
    """Nothing is armed without a supervisor."""
    assert config.supervisor is not None
    settings = config.supervisor.model_copy(update={"policy": "require"})
    return config.model_copy(update={"supervisor": settings})


@pytest.fixture
def watchdog(config: Config) -> Iterator[Watchdog]:
    made = Watchdog(config)
    yield made
    made.supervisor.close()


def let_out(watchdog: Watchdog, *, first: bool = True) -> None:
    """What waits in the queue of every channel, or of all but the ``first``."""
    for each in watchdog.buses if first else watchdog.buses[1:]:
        assert isinstance(each, EchoBus)
        each.let_out()


def test_drives_that_nobody_watches_hear_one_heartbeat(config: Config, required: Config) -> None:
    """They were enabled before there was any: one begins their watch, 44 ms later, where nothing
    may be armed without a supervisor; and one more each 44 ms, by when those that heard the last
    one are off. Be it one drive alone; and at once after a pause that is shorter than 0.3 s."""
    often = [*range(144, 400, 44), *range(500, 800, 44)]
    for used, apart_ms, alone, beats in (
        (config, 2, False, []),
        (required, 2, False, often),
        (required, 2, True, often),
        (required, 7, False, [*range(149, 400, 49), *range(506, 800, 49)]),
    ):
        made = Watchdog(used)
        _, other = made.wiring.axes[:2]
        deaf = {(other.channel, other.received)} if alone else ()
        found = []
        for now in range(2, 800, apart_ms):
            enabled = 100 <= now < 400 or now >= 500
            if made.step(now, enabled=enabled, deaf=deaf) == BEAT:
                found.append(now)
        assert found == beats
        assert not made.supervisor.beating
        made.supervisor.close()


def test_drives_that_are_given_power_beside_their_process_data(required: Config) -> None:
    """They do not answer, and nothing has begun: their channel hears single heartbeats until they
    answer that they are off."""
    made, found = Watchdog(required), []
    axis, other = made.wiring.axes[:2]
    deaf = {(each.channel, each.received) for each in (axis, other)}
    data = bytes.fromhex("2b4060000f000000")
    for now in range(2, 400, 2):
        if now == 100:
            frame = can.Message(arbitration_id=axis.request, is_extended_id=False, data=data)
            made.buses[0].waiting.append(frame)
        if made.step(now, enabled=False, deaf=deaf if now <= 200 else ()) == BEAT:
            found.append(now)
    assert found == [144, 188]
    others = [[message.arbitration_id for message in bus.sent] for bus in made.buses[1:]]
    assert others == [[0x0FE] * 2] * 3, "each channel hears why, and once more after quiet_s"
    assert broken(made) is Requirement.COMMANDED
    made.supervisor.close()


def test_a_heartbeat_for_drives_that_nobody_watches_is_tried_again(required: Config) -> None:
    """Where the interface does not take it."""
    made, found = Watchdog(required, EchoBus), []
    first = made.buses[0]
    assert isinstance(first, EchoBus)
    for now in range(2, 300, 2):
        first.full = now < 150
        if made.step(now, enabled=now >= 100) == BEAT:
            found.append(now)
    assert found == [*range(150, 300, 44)]
    made.supervisor.close()


def test_a_heartbeat_for_drives_that_nobody_watches_does_not_follow_one_that_waits(
    required: Config,
) -> None:
    """In a full queue two would hold the drives once more; one that was lost is not waited for."""
    made = Watchdog(required, EchoBus)
    for now in range(0, 332, 2):  # it begins, and the interface tells what it has sent
        made.step(now, enabled=now == 330)
        let_out(made)
    steps = made.steps(332, 1000, enabled=True, tick=False)
    found = [now for now, sent in zip(range(332, 1000, 2), steps, strict=True) if sent == BEAT]
    singles = [now for now in found if now > 400]
    assert len(singles) > 1
    assert np.diff(singles).tolist() == [176] * (len(singles) - 1)
    made.supervisor.close()


def test_drives_that_are_watched_hear_one_heartbeat_a_look(required: Config) -> None:
    """However long they have power. Where they keep it after a decision they were not watched."""
    made = Watchdog(required)
    list(made.steps(0, 310, enabled=False))
    assert all(sent == BEAT for sent in made.steps(310, 500, enabled=True))
    steps = made.steps(500, 700, enabled=True, tick=False)
    sent = {now: each for now, each in zip(range(500, 700, 2), steps, strict=True) if each}
    assert list(sent) == [500, 502, 504, *range(550, 700, 44)]
    beats = [now for now, each in sent.items() if each == BEAT]
    assert beats == [500, 502, *range(550, 700, 44)]
    assert broken(made) is Requirement.TICK
    made.supervisor.close()


def test_drives_of_one_channel_that_nobody_watches(required: Config) -> None:
    """Its heartbeat ended, and its drives may have power still: they hear one more, which is the
    supervisor's own when it comes back. The other channels go on."""
    made, place = Watchdog(required, EchoBus), 1
    _, channel, _ = made.wiring.channels[place]
    deaf = {(axis.channel, axis.received) for axis in made.wiring.axes if axis.channel == channel}
    sent = []
    for now in range(0, 480, 2):
        before = len(made.buses[place].sent)
        silent = now >= 310
        made.step(now, enabled=now >= 306, everywhere=True, deaf=deaf if silent else ())
        let_out(made)
        if silent and len(made.buses[place].sent) > before:
            sent.append(now)
    assert sent == [*range(310, 328, 2), *range(372, 480, 46)]
    assert made.supervisor.violation is None
    frame = can.Message(arbitration_id=0x77E, is_extended_id=False, data=b"\5")
    made.buses[place].waiting += [frame] * 17
    made.step(480, enabled=True, everywhere=True, deaf=deaf)
    assert broken(made) is Requirement.COMMANDED, "that one is another's"
    made.supervisor.close()


def test_heartbeats_of_another_in_its_name(telling: tuple[Watchdog, EchoBus]) -> None:
    """More come back than were sent, of whatever length: somebody else holds the drives. As many as
    a bus may repeat stop nothing."""
    watchdog, bus = telling
    for now, data in zip(range(312, 344, 2), [b"\5", b"", b"\5\0", b"\5"] * 4, strict=True):
        assert watchdog.step(now, enabled=True) == BEAT
        bus.let_out()
        bus.waiting.append(can.Message(arbitration_id=0x77E, is_extended_id=False, data=data))
    assert watchdog.step(344, enabled=True) == BEAT
    bus.let_out()
    bus.waiting.append(can.Message(arbitration_id=0x77E, is_extended_id=False, data=b"\5"))
    ((identifier, data),) = watchdog.step(346, enabled=True)
    assert (identifier, struct.unpack("<HBBf", data)) == (0x0FE, (0xFF1B, 0x81, 0xFF, 0.0))
    assert broken(watchdog) is Requirement.COMMANDED
    assert all(sent == [] for sent in watchdog.steps(348, 366, enabled=True))
    watchdog.boot()
    for now in range(366, 682, 2):
        watchdog.state = State.FAULT if now < 370 else State.STANDBY
        if now >= 670:
            watchdog.state = State.SAFE_STOP
        sent = watchdog.step(now, enabled=now >= 670)
        let_out(watchdog)
    assert sent == BEAT, "once it begins anew that is over"


@pytest.mark.parametrize(("late_ns", "sent"), [(2 * MS, BEAT), (2 * MS + 1, [])])
def test_a_look_that_took_too_long_sends_nothing(
    config: Config, late_ns: int, sent: list[tuple[int, bytes]]
) -> None:
    """What it has seen is as old; the next one sends again."""
    late = [0]
    made = Watchdog(config, clock=lambda: round(made.now_ms * MS) + late[0])
    list(made.steps(0, 310, enabled=False))
    late[0] = late_ns
    assert made.step(310, enabled=True) == sent
    late[0] = 0
    assert made.step(312, enabled=True) == BEAT
    made.supervisor.close()


@pytest.fixture
def telling(config: Config) -> Iterator[tuple[Watchdog, EchoBus]]:
    """A supervisor that has begun, and the first of its buses, which tell what they have sent."""
    made = Watchdog(config, EchoBus)
    first = made.buses[0]
    assert isinstance(first, EchoBus)
    for now in range(0, 312, 2):
        made.step(now, enabled=now == 310)
        let_out(made)
    yield made, first
    made.supervisor.close()


def test_two_heartbeats_at_most_wait(telling: tuple[Watchdog, EchoBus]) -> None:
    """In a full queue: nothing but those goes out once it has decided."""
    watchdog, bus = telling
    assert watchdog.step(312, enabled=True) == watchdog.step(314, enabled=True) == BEAT
    assert all(sent == [] for sent in watchdog.steps(316, 334, enabled=True))
    assert len(bus.queue) == 2
    bus.let_out()
    bus.full = True
    assert watchdog.step(334, enabled=True) == []
    bus.full = False
    assert watchdog.step(336, enabled=True) == BEAT, "one that was not taken is not waited for"


def test_heartbeats_that_wait_from_the_second_on(config: Config) -> None:
    """The first one told that the interface tells what it has sent."""
    watchdog = Watchdog(config, EchoBus)
    list(watchdog.steps(0, 300, enabled=False))
    for now, sent in ((300, BEAT), (302, BEAT), (304, BEAT), (306, [])):
        assert watchdog.step(now, enabled=False) == sent
        if now == 300:
            let_out(watchdog)
    watchdog.supervisor.close()


@pytest.mark.parametrize(
    ("lost", "none_sent"), [(29, [*range(5, 9), *range(25, 29)]), (24, [*range(5, 9), 25])]
)
def test_after_a_heartbeat_that_was_lost_sixteen_have_to_go_out_at_once(
    telling: tuple[Watchdog, EchoBus], lost: int, none_sent: list[int]
) -> None:
    """One is lost in look 3. The next is sent at once, four looks then find nothing that waits, and
    four more once sixteen have gone out at once. Another may be lost from then on, not before."""
    watchdog, bus = telling
    found = []
    for place in range(lost + 2):
        found.append(watchdog.step(312 + 2 * place, enabled=True) == BEAT)
        if place in (3, lost):
            bus.queue.clear()
        bus.let_out()
    assert [place for place, each in enumerate(found) if not each] == none_sent


def test_a_second_heartbeat_that_the_interface_does_not_take(
    telling: tuple[Watchdog, EchoBus],
) -> None:
    """Its queue is full, so that the first one waits: none follows before that has gone out."""
    watchdog, bus = telling
    assert watchdog.step(312, enabled=True) == BEAT
    bus.full = True
    assert watchdog.step(314, enabled=True) == []
    bus.full = False
    assert watchdog.step(316, enabled=True) == []
    bus.let_out()
    assert watchdog.step(318, enabled=True) == BEAT


@pytest.mark.parametrize(("until_ms", "again"), [(336.0, True), (336.000001, False)])
def test_heartbeats_that_wait_until_drives_have_lost_them(
    telling: tuple[Watchdog, EchoBus], until_ms: float, again: bool
) -> None:
    """None follows before everything is off, and those of other channels go on."""
    watchdog, bus = telling
    other = watchdog.buses[1]
    assert isinstance(other, EchoBus)
    for now in [*range(312, 336, 2), until_ms]:
        watchdog.step(now, enabled=True)
        other.let_out()
    bus.let_out()
    assert watchdog.step(337, enabled=True) == (BEAT if again else [])
    assert len(other.queue) == 1
    if not again:
        bus.queue.clear()
        for now in range(340, 640, 2):
            assert watchdog.step(now, enabled=False) == []
            let_out(watchdog)
        assert watchdog.step(640, enabled=False) == BEAT, "whatever became of the last ones"
        bus.let_out()
        assert watchdog.step(642, enabled=False) == BEAT


def test_a_queue_that_is_full_at_rest_gets_no_more_before_it_has_been_quiet(
    telling: tuple[Watchdog, EchoBus],
) -> None:
    """One heartbeat goes out in each 30 ms, which is more seldom than drives wait for."""
    watchdog, bus = telling
    longest = 0
    for now in range(312, 2312, 2):
        watchdog.step(now, enabled=False)
        let_out(watchdog, first=False)
        if now % 30 == 0 and bus.queue:
            bus.waiting.append(bus.queue.pop(0))
        longest = max(longest, len(bus.queue))
    assert longest <= 2


def test_heartbeats_that_never_went_out(telling: tuple[Watchdog, EchoBus]) -> None:
    """The interface dropped them: it begins again once everything is off."""
    watchdog, bus = telling
    other = watchdog.buses[1]
    assert isinstance(other, EchoBus)
    for now in range(312, 340, 2):
        watchdog.step(now, enabled=True)
        other.let_out()
    bus.queue.clear()
    for now in range(340, 640, 2):
        assert watchdog.step(now, enabled=False) == []
        let_out(watchdog)
    assert watchdog.step(640, enabled=False) == BEAT


def test_heartbeats_that_the_interface_refuses_until_drives_have_lost_them(
    telling: tuple[Watchdog, EchoBus],
) -> None:
    """None follows before everything is off, as of those that wait."""
    watchdog, bus = telling
    for now in range(312, 440, 2):
        bus.full = 314 <= now < (334 if now < 336 else 400)
        sent = watchdog.step(now, enabled=True)
        let_out(watchdog)
        if bus.full:
            assert sent == []
        elif now < 400:
            assert sent == BEAT, "22 ms after the last one"
        else:
            assert sent == []


def test_a_single_heartbeat_comes_after_what_has_waited(required: Config) -> None:
    """Twice their time after the last one that went out, and not after the decision."""
    made = Watchdog(required, EchoBus)
    first = made.buses[0]
    assert isinstance(first, EchoBus)
    for now in range(0, 332, 2):
        made.step(now, enabled=now == 330)
        let_out(made)
    singles = []
    for now in range(332, 460, 2):
        found = made.step(now, enabled=True, tick=False)
        if found == BEAT and now > 340:
            singles.append(now)
        if now in (360, 374):
            first.waiting.append(first.queue.pop(0))
        for other in made.buses[1:]:
            assert isinstance(other, EchoBus)
            other.let_out()
    assert not first.queue or singles
    assert singles[:1] == [376 + 44]
    made.supervisor.close()


def test_a_heartbeat_of_its_number_before_it_begins(watchdog: Watchdog) -> None:
    frame = can.Message(arbitration_id=0x77E, is_extended_id=False, data=b"\5")
    watchdog.buses[0].waiting.append(frame)
    assert all(sent == [] for sent in watchdog.steps(0, 300, enabled=False))
    assert watchdog.step(300, enabled=False) == BEAT


def test_the_heartbeats_of_another_interface_are_not_waited_for(watchdog: Watchdog) -> None:
    """One that does not tell what it has sent."""
    assert all(sent == BEAT for sent in [*watchdog.steps(0, 400, enabled=False)][151:])


def test_its_own_bus_tells_what_it_has_sent() -> None:
    bus = open_bus("virtual", "of the supervisor", 1_000_000)
    try:
        bus.send(can.Message(arbitration_id=0x77E, is_extended_id=False, data=b"\5"))
        echo = bus.recv(timeout=0)
        assert echo is not None
        assert (echo.arbitration_id, bytes(echo.data)) == BEAT[0]
    finally:
        bus.shutdown()


def test_copies_of_its_own_are_forgiven_one_in_sixty_four() -> None:
    """Sixteen at most before; a heartbeat that has not come back takes none of them."""
    heard = Heard(())
    own = Own(0x77E, heard)

    def beat(count: int) -> None:
        for _ in range(count):
            own.send()
            heard.take([5], 1)

    heard.take([5] * 16, 1)
    beat(63)
    assert not own.foreign
    heard.take([5], 1)
    assert own.foreign
    beat(1)
    assert not own.foreign, "of the 64th"
    beat(63)
    heard.take([5], 1)
    assert own.foreign, "not of the next ones"
    beat(1)
    assert not own.foreign
    own.begin()
    beat(128)
    heard.take([5] * 16, 1)
    assert not own.foreign
    heard.take([5], 1)
    assert own.foreign, "there was none to forgive"


def test_a_single_copy_is_forgiven_too() -> None:
    """After the 64th heartbeat sixteen more may come, although that one has not come back yet."""
    heard = Heard(())
    own = Own(0x77E, heard)
    heard.take([5], 1)
    for _ in range(64):
        own.send()
        heard.take([5], 1)
    heard.take([5] * 16, 1)
    assert not own.foreign
    heard.take([5], 1)
    assert own.foreign


def test_a_controlword_beside_the_process_data_is_over_in_the_next_look(required: Config) -> None:
    """It begins anew after a silence of its own, since no drive is enabled, and the daemon has
    brought the devices up again."""
    made = Watchdog(required)
    axis = made.wiring.axes[0]
    list(made.steps(0, 310, enabled=False))
    data = bytes.fromhex("2b4060000f000000")
    frame = can.Message(arbitration_id=axis.request, is_extended_id=False, data=data)
    made.buses[0].waiting.append(frame)
    assert made.step(310, enabled=False) != BEAT
    assert broken(made) is Requirement.COMMANDED
    made.state = State.FAULT
    made.boot()
    assert not any(each == BEAT for each in made.steps(312, 340, enabled=False))
    made.state = State.STANDBY
    sent = list(made.steps(340, 700, enabled=False))
    assert sent.index(BEAT) >= (610 - 340) // 2
    assert made.supervisor.violation is None
    made.supervisor.close()


@pytest.mark.parametrize(("pause_ms", "watched"), [(10, True), (300, True), (304, False)])
def test_power_in_bursts_before_it_has_begun(
    required: Config, pause_ms: int, watched: bool
) -> None:
    """Each shorter than what the single heartbeat waits for. It cannot begin in the pauses; after
    one that is as long as that takes their time begins anew."""
    made = Watchdog(required)
    deaf = {(made.wiring.cells[0].channel, made.wiring.cells[0].received)}
    every = 20 + pause_ms
    sent = [made.step(now, enabled=now % every < 20, deaf=deaf) for now in range(0, 1000, 2)]
    assert (BEAT in sent) is watched
    made.supervisor.close()


@pytest.mark.parametrize("armed", [True, False])
def test_heartbeats_that_go_out_nowhere(config: Config, armed: bool) -> None:
    """The drives have lost them, and no channel is another's: they come back after a reset only."""
    watchdog = Watchdog(config, EchoBus)
    watchdog.resets = False
    for now in range(0, 400, 2):
        watchdog.step(now, enabled=False)
        let_out(watchdog)
    list(watchdog.steps(400, 440, enabled=armed, everywhere=True))
    assert not watchdog.supervisor.beating
    assert broken(watchdog) is (Requirement.LATE if armed else None)
    told = [[m.arbitration_id for m in bus.sent].count(0x0FE) for bus in watchdog.buses]
    assert told == [int(armed)] * len(watchdog.buses)
    let_out(watchdog)
    sent = list(watchdog.steps(440, 900, enabled=False))
    assert (BEAT in sent) is not armed
    watchdog.supervisor.close()
