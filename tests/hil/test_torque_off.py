"""Safe torque off of one drive and of all, in every state and phase of a stop, and its return in
the middle of it. docs/sto.md has what the platform does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hil.can_bench import Bench, enabled, on_lab
from loop import QUICK

from tonus.config import load
from tonus.config.loader import load_bounds
from tonus.config.schema.axis import Brake
from tonus.config.schema.robot_faults import SafeTorqueOff
from tonus.drivers.process_image import AxisCommand, AxisState
from tonus.runtime.states import State, StopMode
from tonus.tools.expect import Run
from tonus.tools.testing.held import Held, HeldFactory
from tonus.tools.testing.player import Player

BRAKE = load("config/braked.yaml")[0].robot.brake
assert isinstance(BRAKE, Brake)
BRAKED = QUICK | {"robot.brake": BRAKE.model_dump()}
CONFIG = {bus: f"config/{bus}.yaml" for bus in ("can", "ethercat")}
TORQUE_OFF = "0x8A88"
OFF_S = 0.2
pytestmark = [pytest.mark.tonus(overrides=QUICK), pytest.mark.tonus_expect("*"), pytest.mark.wide]


def axes(axis: int | None) -> list[int]:
    return list(range(8)) if axis is None else [axis]


def never_enabled_again(run: Run, axis: int | None) -> None:
    """Once they have lost it, no drive that lost its torque is enabled, the return of the voltage
    included."""
    states = run.log["/tonus/drives"]["state"][:, axes(axis)]
    first = int(np.argmax((states == AxisState.FAULT).all(axis=1)))
    assert first > 0
    later = states[first:]
    assert len(later) > 1000 * OFF_S + 50
    assert not (later == AxisState.OPERATION_ENABLED).any()


def comes_to_fault(held: Held) -> None:
    """And stays there for longer than the torque was off."""
    for _ in range(75):
        held.advance(200)
        if held.state == "FAULT":
            break
    held.advance(300)
    assert held.state == "FAULT"


def named(run: Run, axis: int | None) -> None:
    """The stop's reason, and of each drive an event with its error."""
    told = [each for each in run.events if TORQUE_OFF in each.text]
    assert len({each.where for each in told}) == len(axes(axis)), told


@pytest.mark.parametrize("axis", [None, 2], ids=["all", "one"])
@pytest.mark.parametrize(
    ("bus", "at"), [("can", "HOLD"), ("can", "ACTIVE"), ("ethercat", "ACTIVE")]
)
def test_torque_that_returns_in_mid_stop_is_not_used(
    bus: str, axis: int | None, at: Any, tonus_held: HeldFactory
) -> None:
    held = tonus_held("sine_z", config=CONFIG[bus], at=at)
    held.fault("sto", axis=axis, duration=OFF_S)
    held.advance(10)
    assert held.state == "SAFE_STOP"
    assert held.reason == "DRIVE_FAULT"
    comes_to_fault(held)
    run = held.end()
    run.expect("drive_fault", within=0.01)
    named(run, axis)
    never_enabled_again(run, axis)
    run.signal("truth", "tension").stays(-1.0, load_bounds().tension * 200.0)


@pytest.mark.parametrize("bus", ["can", pytest.param("ethercat", marks=pytest.mark.long)])
@pytest.mark.parametrize(("at", "state"), [(0.3, "REFERENCING"), (1.1, "PRETENSION")])
@pytest.mark.parametrize("axis", [None, 2], ids=["all", "one"])
def test_torque_lost_while_it_is_brought_up_ends_in_fault(
    bus: str, at: float, state: str, axis: int | None, tonus_run: Player
) -> None:
    fault = {"kind": "sto", "axis": axis, "duration": OFF_S, "at": at}
    run = tonus_run("hold", config=CONFIG[bus], faults=[fault])
    assert run.state == "FAULT"
    run.expect("drive_fault")
    named(run, axis)
    states = run.log["/tonus/state"]["state"]
    before = states[np.flatnonzero(states == State.SAFE_STOP)[0] - 1]
    assert State(before).name == state
    never_enabled_again(run, axis)


@pytest.mark.parametrize(
    ("torn", "mode"),
    [((), StopMode.ON_PATH), ((5,), StopMode.DESCENT), ((0, 4, 5, 6), StopMode.PASSIVE)],
    ids=["on path", "descent", "passive"],
)
@pytest.mark.parametrize("axis", [None, 2], ids=["all", "one"])
def test_torque_lost_in_each_mode_of_a_stop_stays_off(
    torn: tuple[int, ...], mode: StopMode, axis: int | None, tonus_held: HeldFactory
) -> None:
    held = tonus_held("sine_z")
    if not torn:
        held.command("stop")
    for cable in torn:
        held.fault("cable_cut", axis=cable)
    for _ in range(50):
        held.advance(10)
        if held.record["state"]["stop_mode"] == mode:
            break
    assert held.state == "SAFE_STOP"
    assert held.record["state"]["stop_mode"] == mode
    held.fault("sto", axis=axis, duration=OFF_S)
    comes_to_fault(held)
    run = held.end()
    named(run, axis)
    never_enabled_again(run, axis)


def test_a_reset_is_possible_only_with_the_voltage_back() -> None:
    """In STANDBY nothing is said, since nothing has power; enabling is refused by the drive."""

    async def script(bench: Bench) -> None:
        await bench.fieldbus.start(lambda _: None)
        bench.lab.inject(SafeTorqueOff(axis=2))
        await bench.ticks(20)
        assert bench.image.axes["state"][2] == AxisState.SWITCH_ON_DISABLED
        bench.image.commands["command"] = AxisCommand.ENABLE
        await bench.ticks(30)
        assert bench.image.axes["state"][2] == AxisState.FAULT
        assert bench.image.axes["error_code"][2] == 0x8A88
        bench.image.commands["command"] = AxisCommand.RESET_FAULT
        await bench.ticks(60)
        assert bench.image.axes["state"][2] == AxisState.FAULT

    on_lab(script)


def test_two_faults_hold_one_torque_off_until_both_are_over() -> None:
    async def script(bench: Bench) -> None:
        await enabled(bench)
        bench.lab.inject(SafeTorqueOff(axis=None, duration=0.02))
        bench.lab.inject(SafeTorqueOff(axis=2, duration=0.05))
        drives = bench.lab.drives
        seen = []
        for _ in range(7):
            await bench.ticks(10)
            seen.append([drives[axis].objects.number(0x3202, 1) for axis in (1, 2)])
        assert seen[0] == [0, 0]
        assert seen[3] == [3, 0]
        assert seen[6] == [3, 3]

    on_lab(script)


# -- with holding brakes -------------------------------------------------------------------------


def test_brakes_hold_the_platform_where_it_was(tonus_held: HeldFactory) -> None:
    held = tonus_held(overrides=BRAKED)
    before = held.truth["position"].copy()
    held.fault("sto")
    held.advance(3000)
    assert np.linalg.norm(held.truth["position"] - before) < 0.005
    assert np.linalg.norm(held.truth["velocity"]) < 1e-3
    held.end().never("brake_slipped")


def test_a_brake_that_does_not_hold_lets_its_drum_turn(tonus_held: HeldFactory) -> None:
    held = tonus_held(overrides=BRAKED)
    held.fault("brake_weak", axis=1, gain=0.0)
    held.advance(200)
    assert held.state == "HOLD", "a brake that is open holds nothing"
    before = held.record["drives"]["angle"].copy()
    held.fault("sto")
    held.advance(3000)
    turned = np.abs(held.record["drives"]["angle"] - before)
    assert turned.argmax() == 1
    assert turned[1] > 5.0 * np.delete(turned, 1).max()
    (told,) = [each for each in held.events if each.name == "brake_slipped"]
    assert told.where == "can3/2 (axis 1)"
    held.end()


def test_a_run_with_brakes_does_what_one_without_does(tonus_run: Player) -> None:
    run = tonus_run("hold", config="config/braked.yaml", duration=0.5)
    assert run.state == "STANDBY"
    run.undisturbed()


def test_a_robot_without_brakes_has_none_that_fails(tonus_held: HeldFactory) -> None:
    held = tonus_held()
    with pytest.raises(Exception, match="axis 1 has no holding brake"):
        held.fault("brake_weak", axis=1, gain=0.5)
    held.end()
