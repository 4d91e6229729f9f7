"""Daemons whose drives have power while every answer of theirs says that they have none, or whose
torque acts where none is looked for: by what acts on a SYNC, by SDO, and under a stop that was
never controlled. As in `test_wrong_daemons.py`: in virtual time, on CAN.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import can
import numpy as np
import pytest

from tests.relayed import PATH, RelayRun
from tests.supervised import BRIEF, DRIVES, Run, configured
from tests.wired import CHANNEL
from tests.wrong_daemons import after, blind, both, opposite, raises, torque_in_control
from tonus.config.loader import load_scenario
from tonus.config.schema.faults import Loss, Unplug
from tonus.config.schema.supervisor import Requirement
from tonus.drivers.canopen.channels import Channels
from tonus.drivers.ethercat.master import EthercatFieldbus
from tonus.drivers.exchange import Exchange
from tonus.runtime.control.allocation import Allocation
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.states import Operator, State, StopMode
from tonus.tools.campaign.observed import Observed
from tonus.tools.campaign.play import Operated

pytestmark = pytest.mark.wide

TIMEOUT_MS = 17.0
MOST_TENSION = 60.0
"""N until the drives stop: cables that are slack, or at their pretension, when it begins"""


def stopped(run: Run, seen: Observed, requirement: Requirement, longest_ms: float) -> None:
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert {number for number, _ in run.said} == {requirement}
    assert run.slowest_ms <= longest_ms + TIMEOUT_MS
    until = seen.truth_ns <= max(run.stopped_ns.values())
    assert seen.truth["tension"][until].max() < MOST_TENSION


_BEFORE = -1_000_000
"""the change"""


class Ticks:
    """Counts those since the change, from ``first`` on."""

    def __init__(self, first: int = 0) -> None:
        self.count, self._next = _BEFORE, first

    def commands(self, result: tuple[Any, Any], *_: Any) -> tuple[list[int], list[int]]:
        """Up to power in steps, then what `told` says."""
        del result
        self.count, self._next = self._next, self._next + 1
        word, mille = self.told(self.count)
        return [word] * 8, [mille] * 8

    def told(self, tick: int) -> tuple[int, int]:
        return (0x06, 0) if tick < 4 else (0x07, 0) if tick < 10 else (0x0F, 1000 + tick % 3)


def idle(patch: pytest.MonkeyPatch) -> None:
    """No operator, and no fault."""
    blind(patch)
    patch.setattr(Operated, "next", lambda *_: Operator.NONE)


@pytest.mark.parametrize("apart", [12, 100])
def test_power_between_syncs(monkeypatch: pytest.MonkeyPatch, apart: int) -> None:
    """Two SYNCs one behind the other now and then: power acts on the second, and ends with the
    first of the next two. What is sent between them never acts."""

    class Hidden(Ticks):
        def told(self, tick: int) -> tuple[int, int]:
            if tick < 30 or tick % apart != 1:
                return (0x06, 0) if tick < 10 else (0x07, 0)
            return 0x0F, 1000 + tick % 3

    ticks, sync = Hidden(), Channels.sync

    def seldom(self: Channels, tick: int) -> None:
        if ticks.count < 30 or ticks.count % apart in (0, 1):
            sync(self, tick)

    def change() -> None:
        after(Exchange, "commands", ticks.commands)(monkeypatch)
        monkeypatch.setattr(Channels, "sync", seldom)

    idle(monkeypatch)
    run = Run(configured(**BRIEF)[0], load_scenario("hold"), change, state=State.STANDBY, at=0.5)
    stopped(run, run.play(0.5), Requirement.COMMAND_LOGGED, 45.0 + apart)


def test_power_between_frames_on_ethercat(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the record alone, which has another torque, it takes as long as a disarmed robot may have
    power, counted slowly."""

    class Hidden(Ticks):
        def told(self, tick: int) -> tuple[int, int]:
            if tick < 30 or tick % 18 != 3:
                return (0x06, 0) if tick < 10 else (0x07, 0)
            return 0x0F, 1000

    ticks, send = Hidden(), EthercatFieldbus._send

    def seldom(self: EthercatFieldbus, outputs: list[bytes], tick: int | None) -> None:
        if ticks.count < 30 or ticks.count % 18 < 4:
            send(self, outputs, tick)

    def write(record: Any, *_: Any) -> Any:
        acts = ticks.count >= 30 and ticks.count % 18 == 3
        record.drives.torque_command[...] = (1000 if acts else ticks.count % 2) * newton_metre
        return record

    def change() -> None:
        after(Exchange, "commands", ticks.commands)(monkeypatch)
        after(ControlCycle, "write", write)(monkeypatch)
        monkeypatch.setattr(EthercatFieldbus, "_send", seldom)

    idle(monkeypatch)
    config, _ = configured(PATH, **BRIEF, **{"sto_relay.timeout_ms": 7})
    train = config.robot.drive_trains[0]
    newton_metre = 1e-3 * train.motor.rated_torque * train.gearbox.ratio
    run = RelayRun(config, load_scenario("hold"), change, state=State.STANDBY, at=0.7)
    seen = run.play(0.4)
    assert run.off_ms is not None, seen.error
    assert run.off_ms < 150.0


@dataclass
class Commanded(Run):
    """``steps``: by tick after the change, what each node of ``nodes`` is told beside its process
    data: identifier without its number, and data."""

    steps: Callable[[int, int], tuple[int, bytes] | None] = lambda *_: None
    nodes: Sequence[int] = DRIVES
    ticks: int = 0
    powered_ms: int = 0
    """ticks at the begin of which a drive has power"""

    def _before_tick(self, playing: Any) -> None:
        super()._before_tick(playing)
        if not self.changed_ns:
            return
        self.powered_ms += any(drive.enabled for drive in playing.lab.drives)
        self.ticks += 1
        for node in self.nodes:
            told = self.steps(self.ticks, node)
            if told is not None:
                message = can.Message(arbitration_id=told[0], data=told[1], is_extended_id=False)
                self._buses[self._channels().index(CHANNEL[node])].send(message)


def commanded(
    patch: pytest.MonkeyPatch,
    ticks: Ticks,
    steps: Callable[[int, int], tuple[int, bytes] | None],
    nodes: Sequence[int] = DRIVES,
) -> Commanded:
    """In STANDBY, the drives told as ``ticks`` have it besides."""
    idle(patch)
    return Commanded(
        configured(**BRIEF)[0],
        load_scenario("hold"),
        lambda: after(Exchange, "commands", ticks.commands)(patch),
        State.STANDBY,
        steps=steps,
        nodes=nodes,
    )


def written(node: int, index: int, subindex: int, value: int, size: int) -> tuple[int, bytes]:
    """By SDO."""
    head = {1: 0x2F, 2: 0x2B, 4: 0x23}[size], index & 0xFF, index >> 8, subindex
    return 0x600 + node, bytes([*head, *value.to_bytes(4, "little")])


def by_sdo(tick: int, node: int) -> tuple[int, bytes] | None:
    """Power in pre-operational, where drives send no process data."""
    objects = {5: (0x6040, 0x06), 8: (0x6040, 0x07), 11: (0x6071, 800), 14: (0x6040, 0x0F)}
    if tick == 1:
        return 0, bytes([0x80, node])
    return written(node, objects[tick][0], 0, objects[tick][1], 2) if tick in objects else None


def test_drives_that_are_enabled_by_sdo_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever does it."""
    idle(monkeypatch)
    config, scenario = configured(**BRIEF)[0], load_scenario("hold")
    run = Commanded(config, scenario, state=State.STANDBY, at=0.5, steps=by_sdo)
    stopped(run, run.play(0.3), Requirement.COMMANDED, 10.0)


def test_drives_that_are_enabled_by_sdo_before_it_has_begun(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Their watch has not begun either, and nothing that they send shows their power: a single
    heartbeat begins it, 34 ms after the first controlword."""
    idle(monkeypatch)
    config, _ = configured(**BRIEF, **{"supervisor.policy": "require"})
    run = Commanded(config, load_scenario("hold"), state=State.OFF, at=0.02, steps=by_sdo)
    run.play(0.3)
    assert sorted(run.stopped_ns) == list(DRIVES)
    assert {number for number, _ in run.said} == {Requirement.COMMANDED}, (
        "it reports, silent as it is"
    )
    assert run.powered_ms <= 34 + TIMEOUT_MS


WATCHED = (0x1016, 2, 126 << 16 | round(TIMEOUT_MS), 4)
TORQUE_MODE = (0x6060, 0, 10, 1)


def after_a_boot(tick: int, node: int) -> tuple[int, bytes] | None:
    """Reset, watched as before, then power by SDO in pre-operational."""
    objects = {
        40: WATCHED,
        44: TORQUE_MODE,
        50: (0x6040, 0, 0x06, 2),
        54: (0x6040, 0, 0x07, 2),
        58: (0x6071, 0, 800, 2),
        62: (0x6040, 0, 0x0F, 2),
    }
    if tick == 1:
        return 0, bytes([0x82, node])
    return written(node, *objects[tick]) if tick in objects else None


def test_drives_that_boot_and_are_enabled_by_sdo_before_it_has_begun(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What they are told after their boot-up counts as for those that have not booted."""
    idle(monkeypatch)
    config, _ = configured(**BRIEF, **{"supervisor.policy": "require"})
    run = Commanded(config, load_scenario("hold"), state=State.OFF, at=0.02, steps=after_a_boot)
    run.play(0.3)
    assert sorted(run.stopped_ns) == list(DRIVES)
    assert {number for number, _ in run.said} == {Requirement.COMMANDED}, (
        "it reports, silent as it is"
    )
    assert run.powered_ms <= 34 + TIMEOUT_MS


def a_set_up(node: int) -> list[tuple[int, bytes]]:
    """Of a drive, but for its answers: they are switched off."""
    rpdo = 0x200 + node
    objects = [(0x1800, 1, 0xC0000180 + node, 4), (0x1400, 1, 0x80000000 + rpdo, 4)]
    objects += [(0x1600, 0, 0, 1), (0x1600, 1, 0x60400010, 4), (0x1600, 2, 0x60710010, 4)]
    objects += [(0x1600, 0, 2, 1), (0x1400, 2, 1, 1), (0x1400, 1, rpdo, 4), WATCHED, TORQUE_MODE]
    for more in (1, 2, 3):
        objects.append((0x1400 + more, 1, 0x80000000 + rpdo + 0x100 * more, 4))
        objects.append((0x1800 + more, 1, 0xC0000180 + node + 0x100 * more, 4))
    return [written(node, *each) for each in objects] + [(0, bytes([0x01, node]))]


@pytest.mark.parametrize("reset", [0x80, 0x82])
def test_drives_that_are_silent_and_enabled_by_process_data_before_it_has_begun(
    monkeypatch: pytest.MonkeyPatch, reset: int
) -> None:
    """Their answers are switched off by SDO, a few RPDOs give power, and then no more come: what
    they were told last lasts until they answer, also if they have booted before."""

    class Few(Ticks):
        def told(self, tick: int) -> tuple[int, int]:
            words = ((60, 0x00), (70, 0x06), (80, 0x07))
            return next(((word, 0) for end, word in words if tick < end), (0x0F, 1000))

    def steps(tick: int, node: int) -> tuple[int, bytes] | None:
        if tick == 95 and node == 1:
            for drive in DRIVES:
                lost = Loss(channel=CHANNEL[drive], identifier=0x200 + drive, frames=1_000_000)
                run._playing.lab.inject(lost)
        told = dict(zip(range(10, 60, 2), a_set_up(node), strict=False))
        return {1: (0, bytes([reset, node])), **told}.get(tick)

    idle(monkeypatch)
    config, _ = configured(**BRIEF, **{"supervisor.policy": "require"})
    ticks = Few()
    run = Commanded(
        config,
        load_scenario("hold"),
        lambda: after(Exchange, "commands", ticks.commands)(monkeypatch),
        State.OFF,
        at=0.02,
        steps=steps,
    )
    run.play(0.3)
    assert sorted(run.stopped_ns) == list(DRIVES)
    assert {number for number, _ in run.said} == {Requirement.COMMANDED}, (
        "it reports, silent as it is"
    )
    assert run.powered_ms <= 40 + TIMEOUT_MS


class Silent(Ticks):
    """Power and torque for the first drives alone, once they have been silent for a while."""

    def __init__(self, drives: int, mille: int = 1000) -> None:
        super().__init__()
        self._drives, self._mille = drives, mille

    def commands(self, result: tuple[Any, Any], *_: Any) -> tuple[list[int], list[int]]:
        words, milles = super().commands(result, *_)
        off = [0] * (8 - self._drives)
        return words[: self._drives] + off, milles[: self._drives] + off

    def told(self, tick: int) -> tuple[int, int]:
        words = ((60, 0x00), (70, 0x06), (80, 0x07))
        return next(((word, 0) for end, word in words if tick < end), (0x0F, self._mille))


@pytest.mark.parametrize("lost", [(0x180,), (0x180, 0x700)])
@pytest.mark.parametrize("drives", [1, 7, 8])
def test_power_for_drives_that_were_off_and_are_silent(
    monkeypatch: pytest.MonkeyPatch, drives: int, lost: tuple[int, ...]
) -> None:
    """The last that they have said is that they are off; with or without heartbeats."""
    ticks = Silent(drives)

    def change() -> None:
        after(Exchange, "commands", ticks.commands)(monkeypatch)
        lab = run._playing.lab
        assert lab is not None
        for node in DRIVES[:drives]:
            for base in lost:
                channel, identifier = CHANNEL[node], base + node
                lab.inject(Loss(channel=channel, identifier=identifier, frames=1_000_000))

    idle(monkeypatch)
    run = Commanded(configured(**BRIEF)[0], load_scenario("hold"), change, State.STANDBY)
    found = run.play(0.2)
    assert sorted(run.stopped_ns) == list(DRIVES), found.error
    assert {number for number, _ in run.said} == {Requirement.STALE}
    assert run.powered_ms <= TIMEOUT_MS


def test_power_for_drives_that_were_told_to_be_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    """By SDO, as in a bring-up: TPDO and heartbeat are off. They stop before they have power."""
    ticks = Silent(7)

    def steps(tick: int, node: int) -> tuple[int, bytes] | None:
        return {
            1: (0, bytes([0x80, node])),
            5: written(node, 0x1017, 0, 0, 2),
            10: written(node, 0x1800, 1, 0xC0000180 + node, 4),
            20: (0, bytes([0x01, node])),
        }.get(tick)

    run = commanded(monkeypatch, ticks, steps, DRIVES[:7])
    found = run.play(0.2)
    assert sorted(run.stopped_ns) == list(DRIVES), found.error
    assert {number for number, _ in run.said} == {Requirement.COMMANDED}
    assert not run.powered_ms


def test_power_for_a_silent_drive_on_ethercat(monkeypatch: pytest.MonkeyPatch) -> None:
    """The record has the torque, and that the drive has not answered."""
    ticks, statusword = Silent(1), {}

    def write(record: Any, *_: Any) -> Any:
        if ticks.count >= 0:
            drives = record.drives
            drives.statusword[0] = statusword.setdefault(0, int(drives.statusword[0]))
            drives.age[0] = ticks.count + 1
            drives.torque_command[0] = ticks.told(ticks.count)[1] * newton_metre
        return record

    def change() -> None:
        after(Exchange, "commands", ticks.commands)(monkeypatch)
        after(ControlCycle, "write", write)(monkeypatch)

    idle(monkeypatch)
    config, _ = configured(PATH, **BRIEF, **{"sto_relay.timeout_ms": 7})
    train = config.robot.drive_trains[0]
    newton_metre = 1e-3 * train.motor.rated_torque * train.gearbox.ratio * config.robot.signs[0]
    run = RelayRun(config, load_scenario("hold"), change, state=State.STANDBY, at=0.7)
    found = run.play(0.2)
    assert {number for number, _ in run.said} == {Requirement.STALE}, found.error
    assert run.off_ms <= 84.0, "power from tick 80 on"


def _by_turns(tick: int) -> int:
    return 0x0F if tick % 2 else 0x07


def _now_and_then(tick: int) -> int:
    return 0x0F if tick % 18 == 5 else 0x07


def _from_off_to_off(tick: int) -> int:
    phase = (tick - 34) % 18
    return 0x06 if phase == 3 else 0x0F if 4 <= phase <= 14 else 0x00


@pytest.mark.parametrize(
    ("every", "word"), [(2, _by_turns), (18, _now_and_then), (18, _from_off_to_off)]
)
def test_power_between_answers(
    monkeypatch: pytest.MonkeyPatch, every: int, word: Callable[[int], int]
) -> None:
    """Drives that were told to answer every second SYNC, or every eighteenth, and have power only
    where no answer shows it."""

    class Between(Ticks):
        def told(self, tick: int) -> tuple[int, int]:
            if tick < 60:
                return 0, 0
            if tick < 100:
                return (0x06, 0) if tick < 70 else (0x07, 0)
            return word(tick), (1990 + tick % 3) * (word(tick) == 0x0F)

    def steps(tick: int, node: int) -> tuple[int, bytes] | None:
        return {
            1: (0, bytes([0x80, node])),
            5: written(node, 0x1800, 2, every, 1),
            21: (0, bytes([0x01, node])),
        }.get(tick)

    ticks = Between()
    run = commanded(monkeypatch, ticks, steps)
    found = run.play(0.3)
    assert sorted(run.stopped_ns) == list(DRIVES), found.error
    assert run.slowest_ms <= 100.0 + 76.0 + TIMEOUT_MS


@pytest.mark.parametrize("at", [40, 41])
def test_power_behind_a_command_of_the_network(monkeypatch: pytest.MonkeyPatch, at: int) -> None:
    """It acts on one SYNC. Before the next one the drives are sent to pre-operational, so that they
    neither hear nor say anything of what ends it."""

    class Once(Ticks):
        def told(self, tick: int) -> tuple[int, int]:
            if tick == at:
                return 0x0F, 1000
            return (0x06, 0) if tick < 4 else (0x07, 0)

    def steps(tick: int, node: int) -> tuple[int, bytes] | None:
        return (0, bytes([0x80, node])) if tick == at + 3 else None

    ticks = Once()
    run = commanded(monkeypatch, ticks, steps)
    found = run.play(0.2)
    stopped(run, found, Requirement.COMMANDED, at + 6.0)


def test_a_stop_of_what_was_never_controlled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its bounds are those of forces, and no cell of this one was measured since it stood still."""
    ticks = Ticks(-40)

    def write(record: Any, *_: Any) -> Any:
        if ticks.count >= 0:
            record.state.state[...] = State.SAFE_STOP
            record.state.stop_mode[...] = StopMode.DESCENT
            record.drives.torque_command[...] = ticks.told(ticks.count)[1] * newton_metre
        return record

    def change() -> None:
        after(Exchange, "commands", ticks.commands)(monkeypatch)
        after(ControlCycle, "write", write)(monkeypatch)
        lab = run._playing.lab
        assert lab is not None
        for node in range(17, 26):
            lab.inject(Unplug(channel=CHANNEL[node], node=node))

    idle(monkeypatch)
    config, _ = configured(**BRIEF)
    train = config.robot.drive_trains[0]
    newton_metre = (
        1e-3 * train.motor.rated_torque * train.gearbox.ratio * np.array(config.robot.signs)
    )
    run = Run(config, load_scenario("hold"), change, state=State.STANDBY, at=0.5)
    seen = run.play(0.3)
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert {number for number, _ in run.said} == {Requirement.DISARMED}
    assert run.slowest_ms < 150.0


def test_a_torque_that_acts_and_is_not_the_newest(monkeypatch: pytest.MonkeyPatch) -> None:
    """A SYNC in every fifth tick, and before it the wrong torque; right ones after it."""
    ticks, sync = {"now": 0}, Channels.sync

    def seldom(self: Channels, tick: int) -> None:
        ticks["now"] = tick
        if tick % 5 == 0:
            sync(self, tick)

    def wrong(torque: Any) -> Any:
        found: Any = opposite(torque) if ticks["now"] % 5 == 4 else np.array(torque)
        return found

    def change() -> None:
        both(blind, torque_in_control(wrong))(monkeypatch)
        monkeypatch.setattr(Channels, "sync", seldom)

    run = Run(configured(**BRIEF)[0], load_scenario("sine_z"), change)
    stopped(run, run.play(0.4), Requirement.OPPOSED, 25.0)


@pytest.mark.parametrize("second", [0, 1])
def test_a_torque_in_every_second_tick_of_a_disarmed_robot(
    monkeypatch: pytest.MonkeyPatch, second: int
) -> None:
    """Recorded as it is sent. A look comes every second tick: the newest torque may always be 0."""

    class Alternating(Ticks):
        def told(self, tick: int) -> tuple[int, int]:
            word, mille = super().told(tick)
            return word, mille * (tick % 2 == second)

    ticks = Alternating()

    def write(record: Any, *_: Any) -> Any:
        if ticks.count >= 0:
            record.drives.torque_command[...] = ticks.told(ticks.count)[1] * newton_metre
        return record

    def change() -> None:
        after(Exchange, "commands", ticks.commands)(monkeypatch)
        after(ControlCycle, "write", write)(monkeypatch)

    idle(monkeypatch)
    config, _ = configured(**BRIEF)
    train = config.robot.drive_trains[0]
    newton_metre = 1e-3 * train.motor.rated_torque * train.gearbox.ratio
    newton_metre = newton_metre * np.array(config.robot.signs)
    run = Run(config, load_scenario("hold"), change, state=State.STANDBY, at=0.5)
    stopped(run, run.play(0.3), Requirement.DISARMED, 10.0 + 12.0)


@pytest.mark.parametrize("mille", [300, 450])
def test_a_torque_that_acts_where_the_recorded_ones_do_not(
    monkeypatch: pytest.MonkeyPatch, mille: int
) -> None:
    """A passive stop. On two of four channels a SYNC in every 16th tick, and right before it a
    torque that no record has: it acts until the next one, and is the newest in one look of eight.
    """
    ticks = {"now": 0, "acted": 0}
    config, _ = configured(**BRIEF)
    signs, apart, channels, axes = config.robot.signs, 16, (2, 3), (1, 3, 5, 7)
    fill = Exchange.fill

    def commands(result: tuple[Any, Any], *_: Any) -> tuple[list[int], list[int]]:
        words, torques = list(result[0]), list(result[1])
        if (ticks["now"] + 1) % apart == 0:
            for axis in axes:
                torques[axis] = int(signs[axis] * (mille + ticks["acted"] % 7))
            ticks["acted"] += 1
        return words, torques

    def seldom(self: Channels, tick: int) -> None:
        ticks["now"] = tick
        for number, channel in enumerate(self._channels):
            if number not in channels or tick % apart == 0:
                channel.sync(tick)

    def patient(self: Exchange, tick: int) -> None:
        self._freshness = 50
        fill(self, tick)

    def change() -> None:
        monkeypatch.setattr(Exchange, "fill", patient)
        after(Exchange, "commands", commands)(monkeypatch)
        monkeypatch.setattr(Channels, "sync", seldom)
        monkeypatch.setattr(Allocation, "distribute", raises)

    blind(monkeypatch)
    run = Run(config, load_scenario("hold"), change, state=State.ACTIVE, at=0.5)
    seen = run.play(0.4)
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert {number for number, _ in run.said} == {Requirement.COMMAND_LOGGED}
    assert run.slowest_ms <= 2.0 * apart + TIMEOUT_MS
