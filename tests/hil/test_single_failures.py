"""Single failures from outside, while a robot holds or moves: each is named at its place, and no
bound is broken; docs/fmea.md has a row for each."""

from __future__ import annotations

from typing import Any

import pytest
from loop import QUICK
from wired import CHANNEL

from tonus.config import load
from tonus.config.loader import load_bounds
from tonus.runtime.states import State, StopMode
from tonus.tools.expect import Run
from tonus.tools.safety.budget import seconds
from tonus.tools.testing.held import Held, HeldFactory
from tonus.tools.testing.player import Player

CONFIG, _ = load("config/can.yaml")
BOUNDS = load_bounds()
LOST, AT_ONCE = "control.freshness.stale_stop_ticks + 1 tick", "2 ticks"
"""the times that docs/fmea.md has for a silent device, and for one that reports by itself"""
REVERSED = "control.isolation.torque_s + 2 ticks"
WEAK = "control.isolation.tension_error_s + 1 tick"
ALL = [(CHANNEL[axis + 1], axis + 1) for axis in range(CONFIG.robot.cables)]
"""channel and node of every drive"""
pytestmark = [pytest.mark.tonus(overrides=QUICK), pytest.mark.tonus_expect("*"), pytest.mark.wide]


def struck(held: Held, kind: str, fields: dict[str, Any], ms: int) -> Run:
    """A fault now, and what is seen of it."""
    held.fault(kind, **fields)
    held.advance(ms)
    return held.end()


def keeps_bounds(run: Run) -> None:
    """Speed and tensions of the truth."""
    run.signal("truth", "velocity").norm().stays(0.0, BOUNDS.speed)
    run.signal("truth", "tension").stays(-1.0, BOUNDS.tension * CONFIG.control.tension.max)


@pytest.mark.parametrize(
    ("kind", "fields", "event", "within"),
    [
        ("drive_error", {"node": 3, "code": 0x3220}, "drive_fault", AT_ONCE),
        ("drive_input", {"node": 3, "input": "sto"}, "drive_fault", AT_ONCE),
        ("drive_input", {"node": 3, "input": "negative_limit"}, "drive_fault", AT_ONCE),
        ("power_cycle", {"node": 3}, "boot_up", AT_ONCE),
        ("power_cycle", {"node": 19}, "cell_lost", LOST),
        ("unplug", {"node": 19}, "cell_lost", LOST),
        ("cell_break", {"channel": "can3", "node": 25}, "cell_bad", AT_ONCE),
        ("disconnect", {}, "drive_lost", LOST),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_failure_on_a_bus_is_named_and_stopped(
    kind: str, fields: dict[str, Any], event: str, within: str, tonus_held: HeldFactory
) -> None:
    fields = {"channel": "can1", **fields}
    run = struck(tonus_held(), kind, fields, 300)
    assert run.state == "SAFE_STOP"
    where = f"{fields['channel']}/{fields.get('node', 3)}"
    run.expect(event, where=where, within=seconds(within))
    run.expect("stop_mode", within=seconds(LOST))
    keeps_bounds(run)


@pytest.mark.parametrize(
    ("kind", "fields", "event", "within"),
    [
        ("motor_weak", {"axis": 2, "gain": -1.0}, "drum_torque", seconds(REVERSED)),
        ("motor_weak", {"axis": 2, "gain": 0.3}, "drum_torque", seconds(WEAK)),
        ("cell_offset", {"cell": 8, "force": 30.0}, "contact_limit", 0.02),
        ("load", {"force": (0.0, 0.0, -60.0), "duration": 0.3}, "speed_limit", 0.05),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_failure_of_the_robot_is_named_and_stopped(
    kind: str, fields: dict[str, Any], event: str, within: float, tonus_held: HeldFactory
) -> None:
    run = struck(tonus_held(), kind, fields, 300)
    assert run.state == "SAFE_STOP"
    run.expect(event, within=within)
    keeps_bounds(run)


@pytest.mark.parametrize("kind", ["encoder_frozen", "drum_jam"])
def test_what_fails_at_rest_is_named_when_the_platform_moves(
    kind: str, tonus_held: HeldFactory
) -> None:
    held = tonus_held("sine_x")
    held.fault(kind, axis=3)
    held.advance(200)
    assert held.state == "HOLD", "at rest nothing contradicts it"
    held.command("start")
    held.advance(1500)
    assert held.state in ("SAFE_STOP", "FAULT")
    named = ("DRUM_TORQUE", "DRUM_STUCK", "TENSION_ERROR", "LENGTH_JUMP", "LENGTH_DRIFT")
    assert held.reason in named
    run = held.end()
    run.expect(held.reason.lower(), where="axis 3", within=1.7)
    keeps_bounds(run)


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("cell_gain", {"cell": 2, "gain": 0.7, "over": 1.0}),
        ("encoder_slip", {"axis": 3, "angle": 0.5, "over": 2.0}),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_slow_drift_is_reported_as_the_trackers_and_keeps_the_bounds(
    kind: str, fields: dict[str, Any], tonus_held: HeldFactory
) -> None:
    """No cable is named: lengths and tracker part slowly, and the estimate follows, as its row
    says."""
    run = struck(tonus_held(), kind, fields, 2500)
    run.expect("tracker_learnt")
    keeps_bounds(run)


@pytest.mark.parametrize(("first", "second"), [(4, 0), (1, 6)])
def test_a_slip_in_a_descent_is_named_and_changes_nothing(
    first: int, second: int, tonus_held: HeldFactory
) -> None:
    held = tonus_held()
    held.fault("drive_input", channel=ALL[first][0], node=ALL[first][1], input="sto")
    held.advance(500)
    before = held.now
    held.fault("drum_slip", axis=second, length=0.015, duration=0.02)
    held.advance(1000)
    run = held.end()
    run.expect("length_drift", where=f"axis {second}", after=before, within=1.0)
    modes = run.log["/tonus/state"]["stop_mode"]
    assert StopMode(int(modes.max())) is StopMode.DESCENT
    assert run.log["/tonus/state"]["failed"][-1].nonzero()[0].tolist() == [first]
    keeps_bounds(run)


def test_without_any_torque_it_comes_to_rest_disabled(tonus_held: HeldFactory) -> None:
    """STO of every drive at once: nothing can be done, and nothing is enabled when it returns."""
    held = tonus_held()
    for channel, node in ALL:
        held.fault("drive_input", channel=channel, node=node, input="sto")
    held.advance(60)
    assert held.reason == "DRIVE_FAULT"
    for channel, node in ALL:
        held.fault("drive_input", channel=channel, node=node, input="sto", active=False)
    held.advance(12_000)
    assert held.state == "FAULT"
    assert not held.record["drives"]["torque_command"].any()
    assert abs(held.truth["velocity"]).max() < 0.01
    held.end()


def test_a_motor_of_the_wrong_sign_never_reaches_hold(tonus_run: Player) -> None:
    """From the first torque on, as with a sign that is wrong in the configuration."""
    run = tonus_run("hold", faults=[{"kind": "motor_weak", "axis": 2, "gain": -1.0, "at": 0.0}])
    assert run.state == "FAULT"
    run.expect("drum_torque", where="can1/3", within=0.5)
    states = set(run.log["/tonus/state"]["state"].tolist())
    assert not states & {State.PRETENSION, State.HOLD, State.ACTIVE}
    keeps_bounds(run)
