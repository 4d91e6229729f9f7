"""A gain of the law changed while the robot runs: what is refused, how fast it goes, and what it
does to the stiffness."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loop import QUICK, ClosedLoop, Trace, configured
from numpy.typing import NDArray
from operated import Operated, told

from tonus.config import ConfigError, load
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.control.tuning import NO_CHANGE, GainChange
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.recording.keyframe import Keyframe, restore
from tonus.runtime.signals import CycleRecord
from tonus.runtime.states import State

VELOCITY = "control.stiffness.velocity_gain"
FORCE = "control.stiffness.force_gain"
CONFIG = load("config/can.yaml")[0]
LAW = CONFIG.control.stiffness
PERIOD = CONFIG.control.rates.period
(TUNABLE,) = (each for each in CONFIG.operation.tunable if each.key == VELOCITY)
PLACE = 1
"""of the velocity gain in /tonus/tuning.gains"""


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Operated]:
    operated = Operated(tmp_path)
    yield operated
    operated.close()


def told_value(reply: dict[str, Any], key: str = VELOCITY) -> dict[str, Any]:
    (found,) = (each for each in reply["tunable"] if each["key"] == key)
    return dict(found)


# --- at the control socket -----------------------------------------------------------------------


def test_an_accepted_change_is_answered_shown_and_recorded_with_who(robot: Operated) -> None:
    robot.bring_to(State.HOLD)
    reply = robot.command("set", key=VELOCITY, value=0.4)
    assert reply["ok"], reply
    assert reply["text"].startswith(f"{VELOCITY} goes from 0.32 to 0.4 in 0.8 s")
    on_its_way = told_value(robot.command("status"))
    assert 0.32 < on_its_way["value"] < on_its_way["target"] == 0.4
    robot.advance(round(0.08 / TUNABLE.rate / PERIOD))
    assert told_value(robot.command("status"))["value"] == 0.4
    (event,) = (each for each in robot.events if each.name == "tuned")
    assert event.where == VELOCITY
    assert event.text.startswith("from 0.32 to 0.4 by ")
    assert "uid" in event.text


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"key": VELOCITY, "value": 0.53}, "0.53 is outside 0 to 0.52"),
        ({"key": VELOCITY, "value": -0.01}, "-0.01 is outside 0 to 0.52"),
        ({"key": VELOCITY, "value": 0.5}, "0.5 is more than 0.1 from 0.32"),
        ({"key": VELOCITY, "value": float("nan")}, "nan is outside"),
        ({"key": VELOCITY, "value": float("inf")}, "inf is outside"),
        ({"key": VELOCITY, "value": 10**400}, "inf is outside"),
        ({"key": VELOCITY, "value": "0.4"}, "'0.4' is no number"),
        ({"key": VELOCITY, "value": True}, "True is no number"),
        ({"key": VELOCITY, "value": [0.4]}, "[0.4] is no number"),
        ({"key": VELOCITY}, "value is missing"),
        ({"key": "control.stiffness.maximum", "value": 1.0}, "cannot be changed"),
        ({"key": [VELOCITY], "value": 0.4}, "cannot be changed"),
        ({"value": 0.4}, "key is missing"),
        ({"key": VELOCITY, "value": 0.4, "name": "x"}, "'name' is not a field of set"),
    ],
)
def test_what_is_refused(robot: Operated, fields: dict[str, Any], reason: str) -> None:
    robot.bring_to(State.HOLD)
    reply = robot.command("set", **fields)
    assert not reply["ok"]
    assert reason in reply["error"]
    assert reply["next"]
    robot.advance(100)
    assert told_value(robot.command("status"))["value"] == LAW.velocity_gain
    assert not told(robot.events, "tuned")
    assert bool(told(robot.events, "refused")) is ("name" not in fields)


@pytest.mark.parametrize("state", [State.FAULT, State.SAFE_STOP, State.REFERENCING])
def test_a_state_in_which_nothing_is_changed(robot: Operated, state: State) -> None:
    robot.bring_to(State.STANDBY if state is State.REFERENCING else State.HOLD)
    robot.command({State.FAULT: "estop", State.SAFE_STOP: "stop", State.REFERENCING: "arm"}[state])
    assert robot.state is state
    reply = robot.command("set", key=VELOCITY, value=0.4)
    assert (reply["ok"], reply["error"]) == (False, f"not while in {state.name}")


def test_a_state_that_changes_in_the_same_tick_refuses_it_too(robot: Operated) -> None:
    robot.bring_to(State.HOLD)
    robot.client.ask(op="set", key=VELOCITY, value=0.4)
    robot.client.ask(op="estop")
    robot.advance(5)
    stopped, refused = robot.client.replies()
    assert (stopped["state"], refused["ok"]) == ("FAULT", False)
    assert not told(robot.events, "tuned")
    assert told_value(robot.command("status"))["target"] == LAW.velocity_gain


@pytest.mark.parametrize(
    ("overrides", "reason"),
    [
        ({"control.controller": "pid"}, "no stiffness law"),
        ({"operation.tunable": []}, "cannot be changed"),
    ],
)
def test_a_daemon_that_has_nothing_to_tune(
    tmp_path: Path, overrides: dict[str, Any], reason: str
) -> None:
    robot = Operated(tmp_path, overrides=overrides)
    robot.bring_to(State.HOLD)
    reply = robot.command("set", key=VELOCITY, value=0.4)
    robot.close()
    assert not reply["ok"]
    assert reason in reply["error"]


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"key": "control.stiffness.maximum"}, "control.stiffness.velocity_gain"),
        ({"key": "control.stiffness.deviation_gain"}, "no effect with control.stiffness.profile"),
        ({"minimum": 0.6}, "minimum < maximum"),
        ({"rate": 0.0}, "greater than 0"),
    ],
)
def test_what_the_list_may_hold(entry: dict[str, Any], said: str) -> None:
    listed = [TUNABLE.model_dump() | entry]
    with pytest.raises(ConfigError, match=said) as refused:
        load("config/can.yaml", overrides={"operation.tunable": listed})
    assert "operation.tunable" in str(refused.value)


# --- in the cycle --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tuned() -> tuple[ClosedLoop, Trace, int, bytes]:
    """A swinging platform, whose velocity gain is raised and, before it has got there, lowered."""
    config, scenario = configured("sine_x", QUICK)
    loop = ClosedLoop(config, scenario)
    loop.keep_inputs = True
    keyframe = Keyframe(loop.cycle)
    loop.until(State.ACTIVE)
    loop.run(0.5)
    loop.tick(change=GainChange(1, 0.40))
    loop.run(0.6)
    at, state = loop.number, keyframe.take()
    loop.tick(change=GainChange(1, 0.30))
    loop.tick(change=GainChange(1, 0.90))
    loop.run(1.0)
    return loop, loop.trace, at, state


def gains(trace: Trace) -> NDArray[np.float64]:
    return np.asarray(trace.cycle["tuning"]["gains"][:, PLACE])


def test_the_gain_goes_where_it_was_told_no_faster_than_its_rate(
    tuned: tuple[ClosedLoop, Trace, int, bytes],
) -> None:
    _, trace, at, _ = tuned
    found = gains(trace)
    assert found[0] == LAW.velocity_gain
    assert found[at - 1] == pytest.approx(LAW.velocity_gain + 0.601 * TUNABLE.rate)
    assert found[-1] == 0.30
    assert np.abs(np.diff(found)).max() <= TUNABLE.rate * PERIOD * (1.0 + 1e-9)
    asked = trace.cycle["tuning"]
    assert asked["parameter"][asked["parameter"] > 0].tolist() == [1, 1, 1]
    assert asked["value"][asked["parameter"] > 0].tolist() == [0.40, 0.30, 0.90]


def test_the_stiffness_keeps_its_own_bound_and_the_law_does_not_jump(
    tuned: tuple[ClosedLoop, Trace, int, bytes],
) -> None:
    _, trace, _, _ = tuned
    cycle = trace.cycle
    armed = np.flatnonzero(np.isin(trace.state, (State.HOLD, State.ACTIVE)))[1:]
    k_eq, bound = cycle["stiffness"]["k_eq"], cycle["energy"]["rise_bound"]
    rise = (k_eq[armed] - k_eq[armed - 1]) / PERIOD
    assert (rise <= bound[armed - 1] * (1.0 + 1e-9)).all()
    # A tick's move of the gain, times K0, is all that tuning adds to the law's own motion.
    term = cycle["stiffness"]["velocity_term"] / gains(trace)
    moved = LAW.base * np.abs(np.diff(gains(trace))) * term[1:]
    assert 0.0 < moved.max() <= LAW.base * TUNABLE.rate * PERIOD


def test_the_law_follows_the_gain(tuned: tuple[ClosedLoop, Trace, int, bytes]) -> None:
    """With the change left out of the same inputs, the term is the configured gain's."""
    loop, trace, at, _ = tuned
    plain = fresh()
    for number in range(at):
        record = step(plain, loop, number, NO_CHANGE)
    share = trace.cycle["stiffness"]["velocity_term"][at - 1] / record.stiffness.velocity_term
    assert share == pytest.approx(gains(trace)[at - 1] / LAW.velocity_gain)
    assert record.state.inputs == trace.cycle["state"]["inputs"][at - 1]
    changed = int(np.flatnonzero(trace.cycle["tuning"]["parameter"])[0])
    other = step(fresh(), loop, changed, NO_CHANGE).state.inputs
    assert other != trace.cycle["state"]["inputs"][changed], "the checksum has the change in it"


@pytest.mark.parametrize("from_a_keyframe", [False, True])
def test_it_replays_bit_for_bit(
    tuned: tuple[ClosedLoop, Trace, int, bytes], from_a_keyframe: bool
) -> None:
    loop, trace, at, state = tuned
    first, cycle = (at, restore(state, fresh())) if from_a_keyframe else (0, fresh())
    for number in range(first, len(trace.cycle)):
        asked = trace.cycle["tuning"][number]
        change = GainChange(int(asked["parameter"]), float(asked["value"]))
        record = step(cycle, loop, number, change)
        assert record.data.tobytes() == trace.cycle[number].tobytes(), number


def test_a_keyframe_of_before_there_was_tuning_is_restored(
    tuned: tuple[ClosedLoop, Trace, int, bytes],
) -> None:
    """Its record ends before /tonus/tuning."""
    loop, trace, at, state = tuned
    head, _, blobs = state.partition(b"\n")
    document = json.loads(head)
    entries = document["state"]
    record = entries[".record"]
    dtype = trace.cycle.dtype
    assert record[3] == dtype.itemsize
    record[3] -= dtype["tuning"].itemsize
    for name in [each for each in entries if "tuning" in each or "gains" in each]:
        del entries[name]
    cycle = restore(json.dumps(document).encode() + b"\n" + blobs, fresh())
    assert cycle.record.pose.position.tolist() == trace.cycle["pose"]["position"][at - 1].tolist()
    assert step(cycle, loop, at, NO_CHANGE).tuning.gains[PLACE] == LAW.velocity_gain


def fresh() -> ControlCycle:
    config, scenario = configured("sine_x", QUICK)
    return ControlCycle(
        config.robot,
        config.control,
        config.tracker,
        scenario.reference,
        tunable=config.operation.tunable,
    )


def step(cycle: ControlCycle, loop: ClosedLoop, number: int, change: GainChange) -> CycleRecord:
    given, image = loop.inputs[number], ProcessImage(CONFIG.robot.cables)
    image.axes[:], image.cells[:] = given.axes, given.cells
    image.tracker[...] = given.tracker
    return cycle.step(image, number, given.operator, 0, change)
