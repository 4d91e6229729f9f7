"""Requirements of the supervisor that no daemon of `test_wrong_daemons.py` breaks, each broken over
the bus: SUP-8, 11, 12, 13, 14, 24, 25 and 27.

As there: in virtual time, on CAN, until the last drive reports the end of the heartbeat; the daemon
finds no fault by itself where it could.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import can
import numpy as np
import pytest

from tests.mutated_daemons import ignoring
from tests.supervised import BRIEF, DRIVES, Run, configured
from tests.wrong_daemons import Change, after, blind, both, instead
from tonus.config.loader import load_scenario
from tonus.config.schema.faults import Loss
from tonus.config.schema.robot_faults import CellOffset
from tonus.config.schema.supervisor import Requirement
from tonus.drivers.exchange import Exchange
from tonus.drivers.process_image import AxisState
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.safety.envelope import Envelope
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.states import Event, State
from tonus.runtime.supervisor.supervisor import Supervisor
from tonus.tools.campaign.observed import Observed

pytestmark = pytest.mark.wide

TIMEOUT_MS, LOOK_MS, PATIENCE_MS = 17.0, 2.0, 5.0
"""of `tests.supervised.STRICT`"""
DRIVE, CELL, CONTACT_CELL = 0x183, 0x193, 0x199
"""what they send"""
SLACK_MS = 3.0
"""a tick until it is on the bus, one of frames, one to report"""


def played(
    change: Change,
    patch: pytest.MonkeyPatch,
    besides: Callable[[Run], None] = lambda _: None,
    seconds: float = 0.3,
    **overrides: Any,
) -> tuple[Run, Observed]:
    """``besides``: what else happens at the instant of the change."""

    def both_of_them() -> None:
        change(patch)
        besides(run)

    run = Run(configured(**BRIEF, **overrides)[0], load_scenario("sine_z"), both_of_them)
    with patch.context():
        seen = run.play(seconds)
    patch.undo()
    return run, seen


def stopped_for(run: Run, seen: Observed, requirement: Requirement, longest_ms: float) -> None:
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert {number for number, _ in run.said} == {requirement}
    assert run.slowest_ms <= longest_ms + LOOK_MS + TIMEOUT_MS + SLACK_MS


def losing(channel: str, identifier: int) -> Callable[[Run], None]:
    def lost(run: Run) -> None:
        assert run._playing.lab is not None
        run._playing.lab.inject(Loss(channel=channel, identifier=identifier, frames=5000))

    return lost


def told_to_stop(run: Run) -> None:
    run._playing.script.stop()


def filled(change: Callable[[Exchange], None]) -> Change:
    """Of what the daemon reads from the bus."""
    return after(Exchange, "fill", lambda _, exchange, *__: change(exchange))


def test_a_platform_that_is_faster_than_it_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scenario runs four times as fast, and no bound slows it. What the drums show is three
    quarters of its speed at least: from there on."""

    def hurried(_: None, envelope: Envelope, *__: Any) -> None:
        envelope.progress = 4.0

    change = both(blind, after(Envelope, "__call__", hurried))
    run, seen = played(change, monkeypatch, seconds=1.5)
    speed = np.linalg.norm(seen.truth["velocity"], axis=1)
    limit = seen.config.supervisor.margin * seen.config.control.envelope.speed_limit  # type: ignore[union-attr]
    run.changed_ns = int(seen.truth_ns[speed > limit / 0.75][0])
    stopped_for(run, seen, Requirement.SPEED, PATIENCE_MS)
    until = seen.truth_ns <= max(run.stopped_ns.values())
    assert speed[until].max() <= 0.8


@pytest.mark.parametrize(("cell", "filter_ms"), [(3, 0.0), (8, 5.0)])
def test_forces_that_are_not_those_on_the_bus(
    cell: int, filter_ms: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a cable, and of the contact, which is recorded as it is used: low-passed."""

    def misread(exchange: Exchange) -> None:
        exchange._cell_table["force"][cell] += 20.0

    run, seen = played(both(blind, filled(misread)), monkeypatch)
    stopped_for(run, seen, Requirement.MEASURED_LOGGED, PATIENCE_MS + filter_ms)


def test_a_daemon_that_says_that_it_is_disarmed(monkeypatch: pytest.MonkeyPatch) -> None:
    """And goes on."""

    def says(record: Any, *_: Any) -> Any:
        record.state.state[...] = State.FAULT
        return record

    run, seen = played(after(ControlCycle, "write", says), monkeypatch)
    allowed_ms = seen.config.supervisor.disarmed_ms  # type: ignore[union-attr]
    stopped_for(run, seen, Requirement.DISARMED, allowed_ms)


def test_a_stop_that_does_not_end(monkeypatch: pytest.MonkeyPatch) -> None:
    change = instead(Sequence, "_given_up", property(lambda _: False))
    run, seen = played(change, monkeypatch, told_to_stop, seconds=4.0, **{"supervisor.stop_s": 3.0})
    assert (seen.state == State.SAFE_STOP).sum() >= 3000
    stopped_for(run, seen, Requirement.STOP_ENDS, 3000.0)
    assert run.slowest_ms > 3000.0


def test_a_stop_that_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a tenth of a second, though nothing has been switched off."""

    def taken_back(changed: bool, sequence: Sequence, *_: Any, **__: Any) -> bool:
        if sequence.state is State.SAFE_STOP and sequence.elapsed > 0.1:
            sequence.state = State.HOLD
        return changed

    original = Sequence.step

    def step(sequence: Sequence, *arguments: Any, **named: Any) -> bool:
        return taken_back(original(sequence, *arguments, **named), sequence)

    run, seen = played(instead(Sequence, "step", step), monkeypatch, told_to_stop)
    assert State.SAFE_STOP in seen.state
    stopped_for(run, seen, Requirement.STOP_ENDS, 101.0)


@pytest.mark.parametrize(
    ("channel", "identifier"),
    [("can1", DRIVE), ("can1", CELL), ("can3", CONTACT_CELL)],
    ids=["drive", "cell", "contact cell"],
)
def test_measurements_that_are_repeated(
    channel: str, identifier: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The daemon takes the last one for a new one; it does not come any more."""

    def fresh(exchange: Exchange) -> None:
        exchange._axis_table["age"] = exchange._cell_table["age"] = 0
        exchange._axis_table["state"] = AxisState.OPERATION_ENABLED

    run, seen = played(both(blind, filled(fresh)), monkeypatch, losing(channel, identifier))
    stale_ms = seen.config.supervisor.stale_ms  # type: ignore[union-attr]
    stopped_for(run, seen, Requirement.STALE, stale_ms)


def test_a_supervisor_that_looks_late(monkeypatch: pytest.MonkeyPatch) -> None:
    """By less than the drives wait for its heartbeat, of which they get no other."""
    original, began = Supervisor.step, []

    def late(supervisor: Supervisor, now_ns: int) -> None:
        began.append(now_ns)
        if now_ns - began[0] >= 12_000_000:
            original(supervisor, now_ns)

    run, seen = played(instead(Supervisor, "step", late), monkeypatch)
    stopped_for(run, seen, Requirement.LATE, 0.0)


def test_an_order_to_stop_that_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    run, seen = played(ignoring(Event.STOP), monkeypatch, told_to_stop)
    stopped_for(run, seen, Requirement.ORDERS, PATIENCE_MS)
    assert State.SAFE_STOP not in seen.state[seen.cycle_ns < run.said[0][1] * 1e9]


def test_frames_that_are_longer_than_a_drive_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another node sends them after the daemon's own, and the drive acts by them (CiA 301)."""
    data = b"\x0f\0" + (330).to_bytes(2, "little") + bytes(4)

    async def sent(bus: can.BusABC) -> None:
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(1e-3 - loop.time() % 1e-3 + 7e-4)
            bus.send(can.Message(arbitration_id=0x203, is_extended_id=False, data=data))

    def foreign(_: Run) -> None:
        bus = can.Bus(interface="tonus", channel="can1")
        asyncio.get_running_loop().create_task(sent(bus))

    run, seen = played(lambda _: None, monkeypatch, foreign)
    stopped_for(run, seen, Requirement.COMMAND_LOGGED, PATIENCE_MS)


@pytest.mark.parametrize(
    ("identifier", "data", "kept"),
    [
        (0x000, b"\x82\x03", 3),
        (0x603, b"\x23\xb2\x60\0\x64\0\0\0", None),
        (0x603, b"\x23\x16\x10\x02\0\0\0\0", 3),
        (0x000, b"\x01\0", None),
    ],
    ids=["reset communication", "torque offset", "the watch itself", "start"],
)
def test_another_node_commands_a_drive(
    monkeypatch: pytest.MonkeyPatch, identifier: int, data: bytes, kept: int | None
) -> None:
    """A drive whose watch it takes away no silence stops any more: the seven others do."""

    buses: list[can.BusABC] = []

    def foreign(_: Run) -> None:
        buses.append(bus := can.Bus(interface="tonus", channel="can1"))
        bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))

    run, seen = played(lambda _: None, monkeypatch, foreign)
    assert sorted(run.stopped_ns) == [each for each in DRIVES if each != kept], seen.error
    assert {number for number, _ in run.said} == {Requirement.COMMANDED}
    last_ms = (max(run.stopped_ns.values()) - run.changed_ns) * 1e-6
    assert last_ms <= LOOK_MS + TIMEOUT_MS + SLACK_MS


def test_a_contact_while_the_robot_is_referenced_is_no_mistake_of_the_daemon() -> None:
    """It records the force that its control has use for only where that is on."""

    def pushed() -> None:
        assert run._playing.lab is not None
        run._playing.lab.inject(CellOffset(kind="cell_offset", cell=8, force=20.0))

    config, _ = configured(**BRIEF)
    run = Run(config, load_scenario("hold"), pushed, state=State.REFERENCING, at=0.1)
    run.play(0.1)
    assert (run.said, run.stopped_ns) == ([], {})


class SwitchedOff:
    """Every drive, in each tick but ``on`` of ``cycle``; with torques of its own that change."""

    def __init__(self, on: int, cycle: int, first: int) -> None:
        self._on, self._cycle, self._count = on, cycle, first

    def __call__(self, result: tuple[Any, Any], *_: Any) -> tuple[Any, Any]:
        self._count += 1
        words, torques = result
        enabled = self._count % self._cycle < self._on
        wild = [round(1.5 * each) + self._count % 7 for each in torques]
        return [0x0F if enabled else 0x07] * len(words), wild


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize(("on", "cycle"), [(1, 2), (2, 4)])
def test_drives_that_are_switched_off_and_on_tick_by_tick(
    on: int, cycle: int, first: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whichever of the two a look finds as the newest: a drive has power that had it at any time
    since the look before."""
    change = both(blind, after(Exchange, "commands", SwitchedOff(on, cycle, first)))
    run, seen = played(change, monkeypatch, seconds=0.3)
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    until = seen.truth_ns <= max(run.stopped_ns.values())
    assert np.linalg.norm(seen.truth["velocity"][until], axis=1).max() <= 0.8
    assert seen.truth["tension"][until].max() <= 240.0
    assert run.slowest_ms <= 2 * PATIENCE_MS + LOOK_MS + TIMEOUT_MS + SLACK_MS
