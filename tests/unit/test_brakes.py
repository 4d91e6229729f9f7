"""A brake that does not hold is seen by its drum, told once, and nothing is armed with it."""

from __future__ import annotations

from pathlib import Path

import pytest
from operated import TRAVEL, Operated

from tonus.config import ConfigError, load
from tonus.config.loader import load_scenario
from tonus.drivers.process_image import AxisState, ProcessImage
from tonus.runtime.operation.brakes import OFF, BrakeWatch
from tonus.runtime.states import State
from tonus.tools.check.rules import check

BRAKE = {"torque": 0.4, "opening_ms": 40.0, "closing_ms": 20.0}
CONFIG = load("config/can.yaml", overrides={"robot.axes": {2: {"brake": BRAKE}}})[0]
RADIUS = CONFIG.robot.drum.radius
CLOSED = 41
"""ticks after which the brake counts as closed"""


class Drums:
    """All drives off since the first tick."""

    def __init__(self) -> None:
        self.image, self.watch, self.tick = ProcessImage(8), BrakeWatch(CONFIG), 0
        self.image.axes["age"] = 0
        self.image.axes["state"] = AxisState.FAULT

    def turn(self, metres: float, axis: int = 2, ticks: int = 1) -> list[tuple[int, float]]:
        """Let so much cable go; what is found in these ticks."""
        self.image.axes["angle"][axis] -= metres / RADIUS
        found = []
        for _ in range(ticks):
            found += self.watch.look(self.image, self.tick)
            self.tick += 1
        return found


def test_a_drum_that_turns_under_its_closed_brake_is_told_once() -> None:
    drums = Drums()
    assert not drums.turn(0.1, ticks=CLOSED + 1), "it closes meanwhile"
    assert not drums.turn(0.0019, ticks=5)
    ((axis, slip),) = drums.turn(0.0002, ticks=5)
    assert (axis, slip) == (2, pytest.approx(0.0021))
    assert not drums.turn(0.01, ticks=5)
    assert drums.watch.slipped == {2: pytest.approx(0.0121)}
    assert not drums.turn(-0.01, ticks=5)
    assert drums.watch.slipped == {2: pytest.approx(0.0121)}, "the farthest"


def test_cable_that_is_drawn_in_counts_too() -> None:
    drums = Drums()
    drums.turn(0.0, ticks=CLOSED + 1)
    assert drums.turn(-0.003)


@pytest.mark.parametrize("state", sorted(set(AxisState) - OFF))
def test_a_drive_with_power_or_without_an_answer_is_not_judged(state: AxisState) -> None:
    drums = Drums()
    drums.turn(0.0, ticks=CLOSED + 1)
    drums.image.axes["state"] = state
    assert not drums.turn(0.1, ticks=100)
    drums.image.axes["state"] = AxisState.SWITCH_ON_DISABLED
    assert not drums.turn(0.1, ticks=CLOSED)
    assert drums.turn(0.1, ticks=2) == []
    assert drums.turn(0.1)


def test_a_position_that_a_reset_sets_to_zero_is_no_slip() -> None:
    drums = Drums()
    drums.turn(0.5, ticks=CLOSED + 1)
    drums.image.axes["state"] = AxisState.SWITCH_ON_DISABLED
    drums.image.axes["angle"] = 0.0
    assert not drums.turn(0.0, ticks=200)


def test_old_measurements_say_nothing() -> None:
    drums = Drums()
    drums.turn(0.0, ticks=CLOSED + 1)
    drums.image.axes["age"] = CONFIG.control.freshness.measurement_ticks + 1
    assert not drums.turn(0.1, ticks=CLOSED + 1)
    drums.image.axes["age"] = CONFIG.control.freshness.measurement_ticks
    assert not drums.turn(0.0, ticks=CLOSED + 1)
    assert drums.turn(0.1)


def test_an_axis_without_a_brake_may_turn() -> None:
    drums = Drums()
    drums.turn(0.0, ticks=CLOSED + 1)
    assert not drums.turn(0.1, axis=3, ticks=5)
    assert not BrakeWatch(load("config/can.yaml")[0]).fitted


def test_nothing_is_armed_with_a_brake_that_slipped(tmp_path: Path) -> None:
    robot = Operated(tmp_path, overrides=TRAVEL | {"robot.axes": {2: {"brake": BRAKE}}})
    robot.until(State.STANDBY)
    robot.advance(CLOSED + 1)

    def slip(image: ProcessImage) -> None:
        image.axes["angle"][2] += 0.5

    robot.bus.spoils = [slip]
    robot.advance(8)
    robot.bus.spoils = []
    robot.advance(300)
    (told,) = [each for each in robot.events if each.name == "brake_slipped"]
    assert told.where == "can1/3 (axis 2)"
    reply = robot.command("arm")
    assert not reply["ok"]
    assert "the brake of can1/3 (axis 2) let its cable go by 10 mm" in reply["error"]


def test_a_brake_that_cannot_hold_the_tension_is_refused() -> None:
    for torque, ok in ((0.32, False), (0.33, True)):
        config = load("config/direct.yaml", overrides={"robot.brake": BRAKE | {"torque": torque}})[
            0
        ]
        (found,) = [each for each in check(config, load_scenario("hold")) if each.rule == "brakes"]
        assert found.ok is ok
        assert f"holds {torque * 49 / 4 / RADIUS:.0f} N of 200 N" in found.text


@pytest.mark.parametrize("name", ["opening_ms", "closing_ms"])
def test_a_brake_that_takes_longer_than_any_is_refused(name: str) -> None:
    """Meanwhile the supervisor compares no torque of its drive."""
    load("config/can.yaml", overrides={"robot.brake": BRAKE | {name: 200.0}})
    with pytest.raises(ConfigError, match=rf"robot\.brake\.{name}: .*200"):
        load("config/can.yaml", overrides={"robot.brake": BRAKE | {name: 200.1}})
