"""A robot brought up once, from which runs start."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from multiprocessing import active_children
from pathlib import Path
from select import select

import pytest
from loop import QUICK
from mcap.reader import make_reader

from tests.composed import configured
from tonus.config.schema.faults import CableCut, Unplug
from tonus.runtime.states import Operator, State
from tonus.tools.errors import ToolError
from tonus.tools.expect import ExpectationError, Run
from tonus.tools.log import open as open_log
from tonus.tools.log.replay import replay
from tonus.tools.run.held import HeldRobot, HeldRun
from tonus.tools.testing.held import HeldFactory
from tonus.tools.testing.player import Player

pytestmark = pytest.mark.wide

BUSES = (
    "config/can.yaml",
    pytest.param("config/ethercat.yaml", marks=pytest.mark.long),
    pytest.param("config/direct.yaml", marks=pytest.mark.long),
)
FAULTS = {
    "config/can.yaml": {"kind": "unplug", "channel": "can1", "node": 3, "at": 3.0},
    "config/ethercat.yaml": {"kind": "cable_cut", "axis": 2, "at": 3.0},
    "config/direct.yaml": {"kind": "cable_cut", "axis": 2, "at": 3.0},
}


@pytest.fixture(scope="module")
def robot() -> Iterator[HeldRobot]:
    config, scenario = configured("config/can.yaml", duration=0.3)
    with closing(HeldRobot(config, scenario)) as held:
        yield held


def messages(path: Path, from_ns: int) -> dict[str, list[tuple[int, bytes]]]:
    """Time and bytes by topic; without keyframes, which two runs take at other times."""
    found: dict[str, list[tuple[int, bytes]]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            if message.log_time >= from_ns and channel.topic != "/tonus/keyframe":
                found.setdefault(channel.topic, []).append((message.log_time, message.data))
    return found


@pytest.mark.tonus(overrides=QUICK)
@pytest.mark.tonus_expect("*")
@pytest.mark.parametrize("path", BUSES)
def test_a_run_from_a_held_robot_is_the_rest_of_one_from_off(
    path: str, tonus_run: Player, tonus_held: HeldFactory
) -> None:
    """Bit for bit, frames, truth and events included, with a fault that a held robot is told of
    only after its bring-up; and it replays."""
    told = {"config": path, "faults": [FAULTS[path]], "duration": 0.3}
    whole, held = tonus_run("hold", **told), tonus_held.play("hold", **told)
    _, first, *_ = held.log.times("/tonus/state")
    rest, expected = messages(held.path, first), messages(whole.path, first)
    assert rest.keys() == expected.keys()
    assert [topic for topic in rest if rest[topic] != expected[topic]] == []
    assert len(held.log["/tonus/timing"]) > 500
    held.replays()


def test_it_is_operated_tick_by_tick(robot: HeldRobot, tmp_path: Path) -> None:
    with robot.operated(tmp_path) as run:
        assert run.seen.state is State.HOLD
        assert run.seen.time == 0.0
        assert run.advance(0.1).state is State.HOLD  # nobody has said START
        run.command(Operator.START)
        assert run.advance(0.1).state is State.ACTIVE
        assert run.seen.time == pytest.approx(0.2)
        run.inject(Unplug(channel="can1", node=3))
        seen = run.advance(0.05)
        assert seen.fault == "DRIVE_LOST"
        assert any(said.where == "can1/3" for said in seen.events)
        assert 0.2 < min(said.time for said in seen.events) <= 0.25
    log = open_log(tmp_path / "run.mcap")
    assert len(log["/tonus/state"]) == 251  # the one before the first too
    assert replay(log).first is None


def test_what_one_run_does_the_next_does_not_see(robot: HeldRobot, tmp_path: Path) -> None:
    records = []
    for number, axis in enumerate((2, None, 2, None)):
        with robot.operated(tmp_path / str(number)) as run:
            if axis is not None:
                run.inject(CableCut(axis=axis))
            records.append(run.advance(0.02))
    torn, whole, again, still = (each.record.tobytes() + each.truth.tobytes() for each in records)
    assert torn == again != whole == still


def test_a_run_comes_to_its_end_by_a_controlled_stop(robot: HeldRobot, tmp_path: Path) -> None:
    with robot.operated(tmp_path) as run:
        result = run.finish()
    assert result.outcome.state is State.STANDBY
    with pytest.raises(ToolError, match="the run is over"):
        run.advance(0.1)


def test_active_is_held_too(tmp_path: Path) -> None:
    config, scenario = configured("config/direct.yaml", "sine_x", duration=0.3)
    with (
        closing(HeldRobot(config, scenario, at="ACTIVE")) as robot,
        robot.operated(tmp_path) as run,
    ):
        assert run.seen.state is State.ACTIVE
        first = run.seen.record["pose"]["desired_position"].copy()
        assert (run.advance(0.2).record["pose"]["desired_position"] != first).any()


def test_what_cannot_be_played_is_refused_and_the_robot_is_still_there(
    robot: HeldRobot, tmp_path: Path
) -> None:
    _, other = configured(scenario="sine_x", duration=0.3)
    with pytest.raises(ToolError, match="only faults, commands and duration may differ"):
        robot.play(tmp_path, other)
    for node, at, words in ((99, 9.0, "no node 99"), (3, 0.0, "are over")):
        fault = {"kind": "unplug", "channel": "can1", "node": node, "at": at}
        _, scenario = configured(duration=0.3, script={"faults": [fault]})
        with pytest.raises(ToolError, match=words):
            robot.play(tmp_path, scenario)
    assert robot.play(tmp_path).outcome.state is State.STANDBY


def test_a_fault_that_cannot_be_injected_is_refused_and_the_run_goes_on(
    robot: HeldRobot, tmp_path: Path
) -> None:
    with robot.operated(tmp_path) as run:
        with pytest.raises(ToolError, match="no node 99"):
            run.inject(Unplug(channel="can1", node=99))
        assert run.advance(0.01).state is State.HOLD


@pytest.fixture
def at_most() -> Iterator[Callable[[int], int]]:
    """Fails a test that waits for an answer which never comes, after so many s of wall time."""

    def late(number: int, frame: object) -> None:
        raise TimeoutError("no answer")

    before = signal.signal(signal.SIGALRM, late)
    yield signal.alarm
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def children(pid: int | None) -> list[int]:
    return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def kill_run() -> None:
    """Kill the process of the run that is open, and wait for its end."""
    (run,) = (run for robot in active_children() for run in children(robot.pid))
    handle = os.pidfd_open(run)
    os.kill(run, signal.SIGKILL)
    select([handle], [], [], 10.0)
    os.close(handle)


@pytest.mark.parametrize("when", ["between requests", "during a request", "before its end"])
def test_a_run_that_crashes_is_over_and_the_next_is_as_if_it_had_not_been(
    robot: HeldRobot, tmp_path: Path, at_most: Callable[[int], int], when: str
) -> None:
    at_most(60)
    with robot.operated(tmp_path / "before") as run:
        undisturbed = run.advance(0.02)

    def crash() -> None:
        with robot.operated(tmp_path / "crashed") as run:
            runs.append(run)
            run.advance(0.01)
            if when == "during a request":
                threading.Timer(0.2, kill_run).start()
            else:
                kill_run()
            if when != "before its end":
                run.advance(60.0)

    runs: list[HeldRun] = []
    words = r"process ended without an answer \(signal SIGKILL\)"
    with pytest.raises(ToolError, match=words) as told:
        crash()
    (run,) = runs
    assert "\n" not in str(told.value)
    assert run.over
    assert run.result is None
    with pytest.raises(ToolError, match="the run is over"):
        run.finish()
    with robot.operated(tmp_path / "after") as run:
        seen = run.advance(0.02)
        with pytest.raises(ToolError, match="no node 99"):
            run.inject(Unplug(channel="can1", node=99))
        run.end()
    for each in ("record", "truth"):
        assert getattr(seen, each).tobytes() == getattr(undisturbed, each).tobytes()
    before, after = (messages(tmp_path / n / "run.mcap", 0) for n in ("before", "after"))
    assert before == after
    assert robot.play(tmp_path / "played").outcome.state is State.STANDBY


def test_a_held_robot_whose_process_is_killed_says_so(
    tmp_path: Path, at_most: Callable[[int], int]
) -> None:
    at_most(60)
    config, scenario = configured("config/direct.yaml", duration=0.3)
    others = active_children()
    with closing(HeldRobot(config, scenario)) as robot:
        assert robot.alive
        (process,) = (each for each in active_children() if each not in others)
        process.kill()
        process.join()
        assert not robot.alive
        for _ in range(2):
            with pytest.raises(ToolError, match="process has ended; bring up another"):
                robot.play(tmp_path)


def test_a_robot_that_does_not_come_up_says_why() -> None:
    config, scenario = configured(
        "config/direct.yaml", overrides={"control.sequence.tare_limit": 1e-6}
    )
    with pytest.raises(ToolError, match="did not reach HOLD: "):
        HeldRobot(config, scenario)


@pytest.mark.tonus(overrides=QUICK)
@pytest.mark.tonus_expect("*")
def test_a_test_holds_the_robot_and_asks_the_run(tonus_held: HeldFactory) -> None:
    held = tonus_held()
    assert (held.state, held.reason, held.now) == ("HOLD", "NONE", 0.0)
    held.command("start")
    held.advance(100)
    assert held.state == "ACTIVE"
    assert held.record["tension"]["measured"].min() > 5.0
    held.fault("cable_cut", axis=2)
    held.advance(50)
    assert held.reason == "CABLE_TORN"
    assert held.truth["tension"][2] == 0.0
    run = held.end()
    assert 0.0 < run.expect("cable_torn", where="axis 2", within=0.02).after <= 0.02
    run.replays()


@pytest.mark.tonus(overrides=QUICK)
@pytest.mark.tonus_expect("*")
def test_runs_share_a_robot_and_nothing_else(tonus_held: HeldFactory) -> None:
    first = tonus_held()
    with pytest.raises(ToolError, match="one run at a time"):
        tonus_held()
    first.fault("cable_cut", axis=1)
    first.advance(10)
    first.end()
    second = tonus_held()
    second.advance(10)
    assert first.truth["tension"][1] == 0.0 < second.truth["tension"][1]
    with pytest.raises(ToolError, match="choose one of arm, start, hold"):
        second.command("jump")


def test_a_run_that_is_left_in_the_middle_is_judged_by_all_but_its_end(
    tonus_held: HeldFactory,
) -> None:
    held = tonus_held()
    held.advance(50)
    run = held.end()
    run.invariants()
    with pytest.raises(ExpectationError, match="it ended in HOLD"):
        Run(run.log).invariants()


@pytest.mark.tonus(overrides=QUICK)
@pytest.mark.tonus_expect("*")
def test_a_scenario_played_from_hold_is_judged_as_one_from_off(tonus_held: HeldFactory) -> None:
    """Its faults count from the moment every drive is enabled, as in the whole run."""
    fault = {"kind": "unplug", "channel": "can1", "node": 3, "at": 3.0}
    run = tonus_held.play("hold", faults=[fault], duration=0.5)
    run.expect("drive_lost", where="can1/3", within=0.05)
    run.invariants(replayed=True)


def test_a_time_that_cannot_pass_is_refused(robot: HeldRobot, tmp_path: Path) -> None:
    with robot.operated(tmp_path) as run:
        for seconds in (-0.005, float("nan"), float("inf")):
            with pytest.raises(ToolError, match="is not possible"):
                run.advance(seconds)
        assert run.advance(0.0).time == 0.0
