"""Code beside control that raises stops nothing; control that raises ends passively."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from loop import QUICK
from operated import Operated, told

from tonus.drivers.fieldbus import RAW_FRAME
from tonus.drivers.process_image import AxisCommand, AxisState
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.daemon import Outcome
from tonus.runtime.operation.operator import Script
from tonus.runtime.safety.firewall import Firewall, in_one_line
from tonus.runtime.safety.guarded_tap import GuardedTap
from tonus.runtime.states import Fault, State
from tonus.tools.cli.run import run
from tonus.tools.log import open as open_log
from tonus.tools.log.replay import replay

FAILURES = 3
ON = AxisState.OPERATION_ENABLED


def raising(*_: Any, **__: Any) -> Any:
    raise LookupError("a line\nand another")


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Operated]:
    operated = Operated(tmp_path)
    operated.bring_to(State.ACTIVE)
    operated.failing = True
    yield operated
    operated.close()


def break_ring(robot: Operated) -> None:
    robot.publish = raising  # type: ignore[method-assign]


def break_record(robot: Operated) -> None:
    robot.daemon.cycle.write = raising  # type: ignore[method-assign]


def break_timing(robot: Operated) -> None:
    robot.daemon.latencies.write = raising  # type: ignore[method-assign]


def break_reporter(robot: Operated) -> None:
    robot.daemon._reporter.look = raising  # type: ignore[method-assign]


def break_bus_events(robot: Operated) -> None:
    robot.bus.take_events = raising  # type: ignore[method-assign]


def break_tracker(robot: Operated) -> None:
    robot.daemon._tracker.collect = raising  # type: ignore[method-assign]


def break_service(robot: Operated) -> None:
    robot.daemon.serve("viewer", raising)


PARTS = {
    "ring": break_ring,
    "record": break_record,
    "reporter": break_reporter,
    "fieldbus events": break_bus_events,
    "tracker": break_tracker,
    "viewer": break_service,
}


@pytest.mark.parametrize("part", PARTS)
def test_a_part_that_fails_is_an_event_and_control_goes_on(robot: Operated, part: str) -> None:
    PARTS[part](robot)
    robot.advance(20)
    assert robot.outcome is None
    assert robot.state is State.ACTIVE
    assert (robot.bus.image.commands["command"] == AxisCommand.ENABLE).all()
    failed = [event for event in robot.events if event.name == "part_failed"]
    assert failed
    assert {event.where for event in failed} == {part}
    assert failed[0].text.startswith("LookupError: a line and another; failure 1,")
    off = [event for event in robot.events if event.name == "part_off"]
    if part == "tracker":
        assert not off, "an input may come back"
        assert len(failed) == 5, "the first, second, fourth, eighth and sixteenth"
    else:
        assert len(off) == 1
        assert f"{FAILURES} failures in a row" in off[0].text


def test_timing_that_fails_takes_the_record_only(robot: Operated) -> None:
    break_timing(robot)
    robot.advance(10)
    assert robot.state is State.ACTIVE


def test_a_tracker_that_fails_brings_no_fresh_pose_and_an_ever_older_one(robot: Operated) -> None:
    tracker = robot.bus.image.tracker
    robot.bus.spoils = [lambda image: image.tracker.__setitem__("delay", 0.5)]
    break_tracker(robot)
    robot.advance(2)
    assert not tracker["fresh"]
    assert float(tracker["delay"]) == pytest.approx(0.501)


def test_events_that_cannot_be_written_stop_nothing(robot: Operated) -> None:
    robot.daemon._events = raising
    assert robot.command("stop")["state"] == "SAFE_STOP"
    robot.until(State.STANDBY)
    assert "events failed" in robot.daemon.firewall.tracebacks()


def test_a_part_that_fails_now_and_then_stays_on(robot: Operated) -> None:
    calls: list[int] = []

    def now_and_then(due_ns: int) -> None:
        calls.append(due_ns)
        if len(calls) % FAILURES:
            raise LookupError

    robot.daemon.serve("viewer", now_and_then)
    robot.advance(50)
    assert len(calls) >= 50
    assert not told(robot.events, "part_off")


def test_a_self_test_that_fails_arms_nothing(tmp_path: Path) -> None:
    robot = Operated(tmp_path)
    robot.until(State.STANDBY)
    robot.failing = True
    robot.daemon.self_test.look = raising  # type: ignore[method-assign]
    robot.advance(50)
    assert "ticks old" in robot.command("arm")["error"]
    robot.close()


def test_what_commands_the_run_fails_so_it_stops_and_an_emergency_stop_is_heard(
    robot: Operated,
) -> None:
    robot.daemon._overruns.answer = raising  # type: ignore[method-assign]
    usual = robot.console.next

    def failing(sequence: Any) -> Any:
        if robot.console.pending:
            return usual(sequence)
        raise LookupError

    robot.console.next = failing  # type: ignore[method-assign]
    robot.advance(FAILURES + 1)
    assert robot.state is State.SAFE_STOP
    robot.client.ask(op="estop")
    robot.advance(3)
    assert robot.state is State.FAULT
    outcome = robot.outcome
    assert outcome is not None
    assert outcome.fault is Fault.EMERGENCY_STOP


def test_a_traceback_is_written_once_and_after_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = Operated(tmp_path, script=Script(0.05))
    robot.failing = True
    robot.daemon.serve("viewer", raising)
    robot.until(State.ACTIVE)
    assert "Traceback" not in capsys.readouterr().err
    robot.advance(400)
    assert robot.outcome is not None
    assert robot.outcome.state is State.STANDBY
    text = capsys.readouterr().err
    assert text.count("LookupError: a line") == 1
    assert "viewer failed 3 times" in text
    robot.close()


@pytest.mark.parametrize("error", [KeyboardInterrupt, asyncio.CancelledError, SystemExit])
def test_what_is_meant_to_end_the_process_passes(error: type[BaseException]) -> None:
    part = Firewall(FAILURES).part("any")

    def end() -> None:
        raise error

    with pytest.raises(error):
        part.call(end)
    assert part.failures == 0


def test_an_exception_without_a_text_is_told_by_its_type() -> None:
    class MuteError(Exception):
        def __str__(self) -> str:
            raise ValueError

    assert in_one_line(KeyError()) == "KeyError"
    assert in_one_line(MuteError()) == "MuteError: its text is not available"


def test_frames_that_cannot_be_recorded_reach_control_all_the_same() -> None:
    firewall, frames = Firewall(FAILURES), np.zeros(1, RAW_FRAME)
    broken = SimpleNamespace(frame=raising, received=raising)
    tap = GuardedTap(broken, firewall.part("frame tap"))
    tap.frame(0, 0, 0x80, b"", sent=True)
    tap.received(frames, 0, 0)
    tap.received(frames, 0, 0)
    assert [event.name for event in firewall.take_events()] == [
        *("part_failed", "part_failed", "part_off")
    ]


# -- control itself --------------------------------------------------------------------------------


def fail_control(robot: Operated) -> list[int]:
    """Ticks of the fallback."""
    ticks: list[int] = []
    cycle = robot.daemon.cycle
    fall_back = cycle.fall_back

    def counted(image: Any, tick: int) -> None:
        ticks.append(tick)
        fall_back(image, tick)

    cycle.act = raising  # type: ignore[method-assign]
    cycle.fall_back = counted  # type: ignore[method-assign]
    return ticks


def ended(robot: Operated, ticks: int = 3000) -> Outcome:
    for _ in range(ticks):
        robot.advance(1)
        if robot.outcome is not None:
            return robot.outcome
    raise AssertionError("the run did not end")


def test_control_that_raises_falls_back_until_rest_and_disables_only_then(robot: Operated) -> None:
    handled = len(robot.history)
    ticks = fail_control(robot)
    outcome = ended(robot)
    assert (outcome.state, outcome.fault) == (State.FAULT, Fault.CONTROL_FAILED)
    assert "LookupError: a line and another" in outcome.reason
    after = robot.history[handled:]
    assert [moment.tick for moment in after] == ticks, "in every tick, and nothing else"
    enabled = [moment.enabled for moment in after]
    rest_ms = round(1e3 * robot.config.operation.fallback.rest_s)
    assert enabled[:rest_ms] == [True] * rest_ms
    assert enabled[-1] is False
    assert after[0].state is State.SAFE_STOP
    assert after[-1].state is State.FAULT
    (text,) = told(robot.events, "control_failed")
    assert "passive stop, then drives disabled" in text
    assert [event.where for event in robot.events if event.name == "part_failed"] == ["control"]


def test_what_raises_after_the_torques_falls_back_from_the_next_tick_on(robot: Operated) -> None:
    """The torques of its own tick are sent already, and were computed without it."""
    handled = len(robot.history)
    ticks: list[int] = []
    cycle = robot.daemon.cycle
    fall_back = cycle.fall_back

    def counted(image: Any, tick: int) -> None:
        ticks.append(tick)
        fall_back(image, tick)

    cycle.judge = raising  # type: ignore[method-assign]
    cycle.fall_back = counted  # type: ignore[method-assign]
    outcome = ended(robot)
    assert (outcome.state, outcome.fault) == (State.FAULT, Fault.CONTROL_FAILED)
    first, *after = robot.history[handled:]
    assert [moment.tick for moment in after] == ticks
    assert (first.tick, first.state, first.enabled) == (ticks[0] - 1, State.SAFE_STOP, True)
    assert [event.where for event in robot.events if event.name == "part_failed"] == ["control"]


def test_while_drums_turn_the_fallback_goes_on_to_its_limit(robot: Operated) -> None:
    turned = {"angle": 0.0}

    def turn(image: Any) -> None:
        turned["angle"] += 0.001
        image.axes["angle"][3] = turned["angle"]

    robot.bus.spoils = [turn]
    handled = len(robot.history)
    fail_control(robot)
    outcome = ended(robot, 20_000)
    enabled = sum(moment.enabled for moment in robot.history[handled:])
    assert outcome.fault is Fault.CONTROL_FAILED
    assert enabled == round(1e3 * robot.config.operation.fallback.longest_s)


def test_a_fallback_that_raises_too_gives_no_torque(robot: Operated) -> None:
    fail_control(robot)
    robot.daemon.cycle.fall_back = raising  # type: ignore[method-assign]
    robot.bus.image.commands["torque"] = 7.0
    robot.advance(2)
    np.testing.assert_array_equal(robot.bus.image.commands["torque"], 0.0)
    assert (robot.bus.image.commands["command"] == AxisCommand.ENABLE).all()
    assert ended(robot).fault is Fault.CONTROL_FAILED


def test_an_emergency_stop_ends_a_fallback_at_once(robot: Operated) -> None:
    fail_control(robot)
    robot.advance(5)
    assert robot.history[-1].enabled
    robot.client.ask(op="estop")
    robot.advance(2)
    assert not robot.history[-1].enabled
    assert ended(robot, 10).fault is Fault.CONTROL_FAILED


def test_drives_that_never_say_that_they_are_off_do_not_hold_up_the_end(robot: Operated) -> None:
    robot.bus.spoils = [lambda image: image.axes.__setitem__("state", ON)]
    fail_control(robot)
    assert ended(robot).state is State.FAULT


def test_control_that_raises_in_standby_ends_the_run_at_once(tmp_path: Path) -> None:
    robot = Operated(tmp_path)
    robot.until(State.STANDBY)
    robot.failing = True
    fail_control(robot)
    outcome = ended(robot, 10)
    assert (outcome.state, outcome.fault) == (State.FAULT, Fault.CONTROL_FAILED)
    robot.close()


def test_the_command_ends_with_1_and_its_log_is_replayed_up_to_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    act = ControlCycle.act

    def failing(cycle: ControlCycle, image: Any, tick: int, *rest: Any) -> None:
        if cycle.sequence.state is State.ACTIVE and cycle.sequence.elapsed > 0.05:
            raise ZeroDivisionError
        act(cycle, image, tick, *rest)

    arguments = ["config/direct.yaml", "--virtual", "--scenario", "hold", "--duration", "0.2"]
    arguments += [f"--set={key}={value}" for key, value in QUICK.items()]
    with monkeypatch.context() as broken:
        # What compiles the cycle beforehand uses another one, which must not fail.
        broken.setattr("tonus.tools.run.composer.rehearse", lambda *_: True)
        broken.setattr(ControlCycle, "act", failing)
        result = CliRunner().invoke(run, [*arguments, "--out", str(tmp_path)])
    assert result.exit_code == 1, result.output
    assert "FAULT: control raised an exception (ZeroDivisionError)" in result.output
    found = replay(open_log(tmp_path / "run.mcap"))
    assert found.first is None
    assert found.ticks > 1000
    ((first, last),) = found.unchecked
    assert first == found.last_tick + 1 if found.last_tick else False
    assert last > first
