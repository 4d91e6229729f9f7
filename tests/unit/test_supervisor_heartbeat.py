"""When the supervisor's heartbeat begins and ends."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
import pytest

from tests.unit.supervisor_setup import (
    MS,
    STRICT,
    FakeBus,
    Watchdog,
    broken,
)
from tonus.config import Config, load
from tonus.config.schema.bus import CanopenBus
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import State
from tonus.runtime.supervisor.judge import Judge, Violation
from tonus.runtime.supervisor.observation import Observation
from tonus.runtime.supervisor.supervisor import Supervisor
from tonus.runtime.supervisor.voice import emergency
from tonus.runtime.supervisor.watched import watched_on
from tonus.runtime.supervisor.wiring import Wiring


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


BEAT = [(0x77E, b"\5")]


@pytest.fixture
def watchdog(config: Config) -> Iterator[Watchdog]:
    made = Watchdog(config)
    yield made
    made.supervisor.close()


def test_the_heartbeat_begins_when_nothing_was_enabled_for_a_while(watchdog: Watchdog) -> None:
    assert all(sent == [] for sent in watchdog.steps(0, 300, enabled=False))
    assert not watchdog.supervisor.beating
    assert watchdog.step(300, enabled=False) == BEAT
    assert watchdog.step(302, enabled=True) == BEAT
    assert watchdog.supervisor.beating
    assert not any(bus.closed for bus in watchdog.buses)
    watchdog.supervisor.close()
    assert all(bus.closed for bus in watchdog.buses)


def test_where_frames_are_read_it_needs_no_record_to_begin(watchdog: Watchdog) -> None:
    assert all(sent == [] for sent in watchdog.steps(0, 300, enabled=False, tick=False))
    assert watchdog.step(300, enabled=False, tick=False) == BEAT


def test_a_channel_whose_torques_come_late_gets_none(
    watchdog: Watchdog, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its drives stop by themselves; the others are judged, and the daemon's stop has them."""
    judged: list[list[int]] = []

    def judge(_: Judge, seen: Observation) -> Violation | None:
        judged.append(np.flatnonzero(seen.enabled).tolist())
        wanted = Violation(Requirement.COMMAND_LOGGED, 5, 1.0, alone=True)
        return wanted if len(judged) == 2 else None

    monkeypatch.setattr(Judge, "__call__", judge)
    list(watchdog.steps(0, 310, enabled=False))
    names = [name for _, name, _ in watchdog.wiring.channels]
    axes = watchdog.wiring.axes
    place = {axis.number: names.index(axis.channel) for axis in axes}
    before = [len(bus.sent) for bus in watchdog.buses]
    for now in range(310, 320, 2):
        watchdog.step(now, enabled=True, everywhere=True)
    sent = [len(bus.sent) - count for bus, count in zip(watchdog.buses, before, strict=True)]
    assert sent == [1 if number == place[5] else 5 for number in range(4)]
    assert {message.arbitration_id for bus in watchdog.buses for message in bus.sent} == {0x77E}
    left = [row for row, axis in enumerate(axes) if place[axis.number] != place[5]]
    assert judged == [list(range(8))] * 2 + [left] * 3
    assert watchdog.supervisor.violation is None
    assert watchdog.supervisor.beating


def test_the_last_channel_does_not_end_alone(
    watchdog: Watchdog, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would begin again without a reset, and nobody would have been told."""

    def judge(_: Judge, seen: Observation) -> Violation | None:
        first = int(seen.axes[seen.enabled][0])
        return Violation(Requirement.COMMAND_LOGGED, first, 1.0, alone=True)

    list(watchdog.steps(0, 310, enabled=False))
    monkeypatch.setattr(Judge, "__call__", judge)
    for now in range(310, 316, 2):
        watchdog.step(now, enabled=True, everywhere=True)
        assert (watchdog.supervisor.beating, broken(watchdog)) == (True, None)
    watchdog.step(316, enabled=True, everywhere=True)
    assert broken(watchdog) is Requirement.COMMAND_LOGGED
    (last,) = [bus for bus in watchdog.buses if bus.sent[-1].arbitration_id == 0x0FE]
    assert last.sent[-1].data[:2] == b"\x0a\xff"
    watchdog.resets = False
    assert not any(watchdog.steps(318, 1000, enabled=False))


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
    assert (violation.requirement, violation.value) == (Requirement.TICK, pytest.approx(6.0))
    assert all(quiet == [] for quiet in watchdog.steps(700, 1000, enabled=False))
    assert watchdog.step(1000, enabled=False) == BEAT
    assert watchdog.supervisor.violation is None


def stopped(watchdog: Watchdog) -> None:
    """For a record that pauses while a drive is enabled; no reset is recorded."""
    watchdog.resets = False
    list(watchdog.steps(0, 310, enabled=False))
    watchdog.step(310, enabled=True)
    list(watchdog.steps(312, 400, enabled=True, tick=False))
    assert watchdog.supervisor.violation is not None


def test_after_a_violation_nothing_begins_before_the_operators_reset(watchdog: Watchdog) -> None:
    """Otherwise whatever enables drives by itself would have the robot again after each stop."""
    stopped(watchdog)
    assert not any(watchdog.steps(400, 3000, enabled=False))
    watchdog.resets = True
    assert watchdog.step(3000, enabled=False) == BEAT


def test_a_reset_that_is_recorded_in_every_tick_is_nobodys(watchdog: Watchdog) -> None:
    """As with a button that is stuck, or an order that is never cleared."""
    stopped(watchdog)
    watchdog.state = State.FAULT
    assert watchdog.step(400, enabled=False) != BEAT
    watchdog.stuck, watchdog.state = True, State.STANDBY
    before = list(watchdog.steps(402, 1200, enabled=False))
    assert BEAT in before, "it was pressed once"
    watchdog.state = State.SAFE_STOP
    watchdog.step(1200, enabled=True)
    list(watchdog.steps(1202, 1300, enabled=True, tick=False))
    assert watchdog.supervisor.violation is not None
    watchdog.state = State.FAULT
    assert not any(watchdog.steps(1300, 3000, enabled=False))


def test_a_reset_that_the_daemon_does_not_take_is_none(watchdog: Watchdog) -> None:
    """It takes one in FAULT alone. The robot would have its power back in the stop."""
    stopped(watchdog)
    watchdog.stuck = True
    assert watchdog.step(400, enabled=False) != BEAT
    watchdog.stuck = False
    assert not any(watchdog.steps(402, 1200, enabled=False))
    watchdog.state = State.FAULT
    assert watchdog.step(1200, enabled=False) != BEAT
    watchdog.stuck = True
    assert watchdog.step(1202, enabled=False) != BEAT, "it stays in FAULT"
    watchdog.stuck = False
    assert watchdog.step(1204, enabled=False) != BEAT
    watchdog.stuck, watchdog.state = True, State.STANDBY
    assert watchdog.step(1206, enabled=False) == BEAT


def test_a_reset_that_is_recorded_from_the_first_tick_on_is_nobodys(watchdog: Watchdog) -> None:
    """It stops the robot before there is a record."""
    list(watchdog.steps(0, 310, enabled=False, tick=False))
    list(watchdog.steps(310, 400, enabled=True, tick=False))
    assert watchdog.supervisor.violation is not None
    watchdog.stuck, watchdog.state = True, State.FAULT
    assert not any(watchdog.steps(400, 2000, enabled=False))


@pytest.mark.parametrize("state", [State.OFF, State.STANDBY])
def test_a_record_that_pauses_is_no_reset(watchdog: Watchdog, state: State) -> None:
    """Whatever it goes on with: another daemon has a supervisor of its own."""
    stopped(watchdog)
    list(watchdog.steps(400, 800, enabled=False))
    list(watchdog.steps(800, 1200, enabled=False, tick=False))
    watchdog.state = state
    assert not any(watchdog.steps(1200, 2000, enabled=False))


def everything(watchdog: Watchdog) -> set[tuple[str, int]]:
    axes, cells = watchdog.wiring.axes, watchdog.wiring.cells
    heard = {(axis.channel, axis.received) for axis in axes}
    heard |= {(axis.channel, number) for axis in axes for number in (axis.sent, axis.sync)}
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


@pytest.mark.parametrize(("enabled", "beats"), [(False, 195), (True, 9)])
def test_load_cells_do_not_answer_for_the_drives_of_their_channel(
    watchdog: Watchdog, enabled: bool, beats: int
) -> None:
    """While a drive is enabled: what those have for a torque nobody sees."""
    list(watchdog.steps(0, 310, enabled=False))
    _, channel, _ = watchdog.wiring.channels[1]
    drives = {(axis.channel, axis.received) for axis in watchdog.wiring.axes}
    before = len(watchdog.buses[1].sent)
    deaf = on(watchdog, channel) & drives
    list(watchdog.steps(310, 700, enabled=enabled, deaf=deaf))
    assert len(watchdog.buses[1].sent) - before == beats
    assert watchdog.supervisor.beating


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
    assert watchdog.supervisor.beating, "on the others"
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


BOOT_UP, OPERATIONAL, PRE_OPERATIONAL = 0x00, 0x05, 0x7F


@pytest.mark.parametrize("state", [OPERATIONAL, PRE_OPERATIONAL])
def test_a_drive_that_sends_heartbeats_and_no_measurements_is_what_it_was(
    watchdog: Watchdog, state: int
) -> None:
    """It may have its last torque still. One of two goes on so after the daemon is disarmed."""
    axis = watchdog.wiring.axes[0]
    watchdog.state = State.FAULT
    list(watchdog.steps(0, 310, enabled=False, beats=[(0, BOOT_UP)]))
    watchdog.state = State.SAFE_STOP
    assert watchdog.step(310, enabled=True) == BEAT
    watchdog.state = State.FAULT
    deaf, beats = {(axis.channel, axis.received)}, [(0, state)]
    sent = list(watchdog.steps(312, 400, enabled=False, deaf=deaf, beats=beats))
    assert sent[:25] == [BEAT] * 25
    code, _, _, _ = struct.unpack("<HBBf", sent[25][0][1])
    assert code == 0xFF0C, "SUP-12, after 50 ms"
    assert sent[26:] == [[]] * 18
    later = watchdog.steps(400, 800, enabled=False, deaf=deaf, beats=beats)
    assert all(sent == [] for sent in later)
    assert list(watchdog.steps(800, 1104, enabled=False, beats=beats))[-1] == BEAT


def test_drives_that_are_all_silent_are_what_they_were_whoever_sends_heartbeats(
    watchdog: Watchdog,
) -> None:
    list(watchdog.steps(0, 310, enabled=False))
    assert watchdog.step(310, enabled=True) == BEAT
    watchdog.state = State.FAULT
    deaf = {(axis.channel, axis.received) for axis in watchdog.wiring.axes}
    sent = list(watchdog.steps(312, 364, enabled=False, deaf=deaf, beats=[(2, OPERATIONAL)]))
    assert sent[:10] == [BEAT] * 10
    assert struct.unpack("<HBBf", sent[10][0][1])[0] == 0xFF0E


@pytest.mark.parametrize(
    ("axis", "last_ms", "first"),
    [(0, 330, OPERATIONAL), (3, 1000, OPERATIONAL), (2, 1000, BOOT_UP)],
    ids=["pulled a little later", "another one's", "booted since"],
)
def test_a_silent_drive_that_is_off(
    watchdog: Watchdog, axis: int, last_ms: int, first: int
) -> None:
    """A heartbeat may still be 18 ms later than the last measurement of a drive that is pulled."""
    silent = watchdog.wiring.axes[0]
    watchdog.state = State.FAULT
    list(watchdog.steps(0, 310, enabled=False, beats=[(0, BOOT_UP), (1, BOOT_UP)]))
    watchdog.state = State.SAFE_STOP
    assert watchdog.step(310, enabled=True, beats=[(0, OPERATIONAL)]) == BEAT
    watchdog.state = State.FAULT
    deaf = {(silent.channel, silent.received)}
    for now in range(312, 1000, 2):
        state = first if now == 312 else PRE_OPERATIONAL
        beats = [(axis, state)] if now < last_ms else []
        assert watchdog.step(now, enabled=False, deaf=deaf, beats=beats) == BEAT


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


def test_looks_that_are_too_slow_for_any_heartbeat(config: Config) -> None:
    """Drives have lost it by then, which is told; it does not go on where one is enabled."""
    late = [0]
    made = Watchdog(config, clock=lambda: round(made.now_ms * MS) + late[0])
    list(made.steps(0, 310, enabled=False))
    list(made.steps(310, 330, enabled=True))
    late[0] = 3 * MS
    sent = [each for each in made.steps(330, 370, enabled=True) if each]
    assert [identifier for ((identifier, _),) in sent] == [0x0FE]
    assert broken(made) is Requirement.LATE
    late[0] = 0
    assert all(sent == [] for sent in made.steps(370, 400, enabled=True))
    assert not made.supervisor.beating
    made.supervisor.close()


@pytest.mark.parametrize(
    ("looks", "last_ms"),
    [
        ([319, 328, 337, 346, 355, 364, 368.999, 377], 58.999),
        ([319, 328, 337, 346, 355, 364, 369], 54.0),
        ([*range(312, 361, 2), 361.999, 363], 51.999),
    ],
)
def test_how_late_the_last_heartbeat_is(
    watchdog: Watchdog, looks: list[float], last_ms: float
) -> None:
    """Of a condition that may hold for 50 ms and begins right after a look: after less than two
    periods, the patience and those 50, with looks that are as late as they may be."""
    list(watchdog.steps(0, 310, enabled=False))
    assert watchdog.step(310, enabled=True) == BEAT
    watchdog.state = State.FAULT
    *before, last = looks
    assert all(watchdog.step(now, enabled=True) == BEAT for now in before)
    assert watchdog.step(last, enabled=True) != BEAT
    violation = watchdog.supervisor.violation
    assert violation is not None
    assert violation.requirement is Requirement.DISARMED
    assert before[-1] - 310 == pytest.approx(last_ms)
    assert last_ms < 2 * 2 + 5 + 50


@pytest.mark.parametrize(("late_ms", "stalled"), [(22.0, False), (22.00001, True)])
@pytest.mark.parametrize("enabled", [False, True])
def test_a_stall_of_its_own_that_drives_notice(
    watchdog: Watchdog, late_ms: float, stalled: bool, enabled: bool
) -> None:
    """When it looks again all are off, for the heartbeat that they missed: it begins again as after
    a restart. Where one is not, that is a violation, however long it was."""
    list(watchdog.steps(0, 310, enabled=False))
    list(watchdog.steps(310, 330, enabled=True))
    end = 328.0 + late_ms
    sent = watchdog.step(end, enabled=enabled)
    if enabled:
        assert [identifier for identifier, _ in sent] == [0x0FE]
        return
    assert (sent == BEAT) is not stalled
    assert watchdog.supervisor.violation is None
    if stalled:
        later = np.arange(end + 2.0, end + 300.0, 2.0)
        assert all(watchdog.step(now, enabled=False) == [] for now in later)
        assert watchdog.step(end + 300.0, enabled=False) == BEAT


def test_a_stall_of_its_own_long_after_anything_was_enabled(watchdog: Watchdog) -> None:
    """A restart would wait as long."""
    list(watchdog.steps(0, 400, enabled=False))
    assert watchdog.supervisor.beating
    assert all(sent == [] for sent in watchdog.steps(422, 722, enabled=False))
    assert watchdog.step(722, enabled=False) == BEAT


@pytest.mark.parametrize(
    ("value", "sent"),
    [(3.0, 3.0), (3.4e38, np.inf), (1e39, np.inf), (-1e39, -np.inf), (np.inf, np.inf)],
)
def test_a_value_that_is_too_large_for_its_frame(value: float, sent: float) -> None:
    frame = emergency(Violation(Requirement.TENSION, 3, value))
    assert struct.unpack("<HBBf", frame) == (0xFF06, 0x81, 3, sent)
    assert np.isinf(
        struct.unpack("<f", emergency(Violation(Requirement.TENSION, 3, np.nan))[4:])[0]
    )


def test_a_violation_at_an_axis_names_it(watchdog: Watchdog) -> None:
    axis = watchdog.wiring.axes[1]
    list(watchdog.steps(0, 310, enabled=False))
    steps = watchdog.steps(310, 600, enabled=True, deaf={(axis.channel, axis.sent)})
    sent = [frame for step in steps for frame in step]
    _, data = next(each for each in sent if each[0] == 0x0FE)
    code, _, place, _ = struct.unpack("<HBBf", data)
    assert (code, place) == (0xFF02, axis.number)


def test_what_lasts_too_long_ends_it(watchdog: Watchdog) -> None:
    """A condition that may hold for 50 ms: a drive is enabled in a state that forbids it. That it
    had no power for less than a look is no rest."""
    list(watchdog.steps(0, 310, enabled=False))
    watchdog.state = State.FAULT
    assert all(sent == BEAT for sent in watchdog.steps(310, 350, enabled=True))
    assert watchdog.step(350, enabled=True, interrupted=True) == BEAT
    assert all(sent == BEAT for sent in watchdog.steps(352, 360, enabled=True))
    assert watchdog.step(360, enabled=True) != BEAT
    violation = watchdog.supervisor.violation
    assert violation is not None
    assert violation.requirement is Requirement.DISARMED


def test_a_silent_drive_is_off_when_its_answer_is_as_old_as_it_may_be(watchdog: Watchdog) -> None:
    """And from then on it is quiet, so that the heartbeat begins 0.3 s later."""
    watchdog.state = State.FAULT
    watchdog.step(0, enabled=True)
    channel = watchdog.wiring.axes[0].channel
    list(watchdog.steps(2, 22, enabled=True, deaf=on(watchdog, channel)))
    assert all(sent == [] for sent in watchdog.steps(22, 320, enabled=False))
    assert watchdog.step(320, enabled=False) == BEAT


def test_what_is_as_old_as_it_may_be_does_not_arrive(watchdog: Watchdog) -> None:
    cell = watchdog.wiring.cells[0]
    list(watchdog.steps(0, 282, enabled=False))
    silent = watchdog.steps(282, 302, enabled=False, deaf={(cell.channel, cell.received)})
    assert all(sent == [] for sent in silent)
    assert watchdog.step(302, enabled=False) == BEAT


@pytest.mark.parametrize(("at_ms", "sent"), [(608.0, BEAT), (608.0001, [])])
def test_how_long_it_may_be_deaf_while_nothing_is_enabled(
    watchdog: Watchdog, at_ms: float, sent: list[tuple[int, bytes]]
) -> None:
    list(watchdog.steps(0, 310, enabled=False))
    deaf = everything(watchdog)
    list(watchdog.steps(310, 608, enabled=False, deaf=deaf))
    assert watchdog.step(at_ms, enabled=False, deaf=deaf) == sent


def test_on_each_channel_it_listens_to_the_devices_of_that_channel(config: Config) -> None:
    """To SYNC, NMT, a drive's PDOs, both ways, what is asked of it and its heartbeat, and a cell's
    PDO, emergency, what is asked of it and its heartbeat."""
    assert isinstance(config.fieldbus, CanopenBus)
    for channel in config.fieldbus.channels:
        drives = [drive.node_id for drive in channel.drives]
        cells = [node.node_id for node in channel.force_cells]
        wanted = [base + node for node in drives for base in (0x180, 0x200, 0x600, 0x700)]
        wanted += [base + node for node in cells for base in (0x080, 0x180, 0x600, 0x700)]
        wanted += [0x000]
        watched = watched_on(Wiring(config), channel.name)
        assert sorted(each.identifier for each in watched) == sorted(wanted)
        syncs = {each.identifier: each.sync for each in watched if each.sync}
        assert syncs == {0x200 + node: 0x080 for node in drives}
        commands = {each.identifier for each in watched if each.command}
        requests = {0x600 + node for node in (*drives, *cells)}
        assert commands == {0x000, *syncs, *requests}, "may be longer"


def test_the_last_channels_do_not_end_alone_though_drives_without_a_heartbeat_answer(
    watchdog: Watchdog,
) -> None:
    """Two adapters of two channels each: one is silent for a while, and then the other. Until
    2026-11-29 the last heartbeats ended untold, and came back without a reset."""
    watchdog.resets = False
    names = [name for _, name, _ in watchdog.wiring.channels]
    first, second = (on(watchdog, a) | on(watchdog, b) for a, b in (names[:2], names[2:]))
    list(watchdog.steps(0, 310, enabled=False))
    list(watchdog.steps(310, 330, enabled=True, everywhere=True))
    list(watchdog.steps(330, 360, enabled=True, everywhere=True, deaf=first))
    list(watchdog.steps(360, 380, enabled=True, everywhere=True))
    assert broken(watchdog) is None
    assert watchdog.supervisor.beating
    list(watchdog.steps(380, 410, enabled=True, everywhere=True, deaf=second))
    assert broken(watchdog) is Requirement.STALE
    for bus in watchdog.buses:
        told = [bytes(each.data) for each in bus.sent if each.arbitration_id == 0x0FE]
        assert [struct.unpack("<HBBf", each)[0] for each in told] == [0xFF0E]
    list(watchdog.steps(410, 2000, enabled=False))
    assert not watchdog.supervisor.beating
