"""The reaction to an exception in control, tick by tick: how long it lasts, and what ends it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tonus.config import load
from tonus.drivers.process_image import AxisCommand, AxisState, ProcessImage
from tonus.runtime.safety.fallback import Fallback
from tonus.runtime.safety.firewall import Part
from tonus.runtime.states import State

CONFIG, _ = load(
    "config/can.yaml",
    overrides={
        "operation.fallback.rest_travel": 0.002,
        "operation.fallback.rest_s": 0.01,
        "operation.fallback.longest_s": 0.05,
        "operation.fallback.off_s": 0.004,
    },
)
N = CONFIG.robot.cables
STALE = CONFIG.control.freshness.stale_stop_ticks
TURN = float(0.002 / CONFIG.robot.drum_radius[0])
"""rad within which a drum rests"""
BEGIN = 100
"""tick"""


class Robot:
    """Drives that are enabled, and a cycle whose own fallback gives a torque of 2 N m each."""

    def __init__(self) -> None:
        self.image = ProcessImage(N)
        self.image.axes["state"] = AxisState.OPERATION_ENABLED
        self.image.axes["age"] = 0
        self.image.commands["command"] = AxisCommand.ENABLE
        self.torque: Any = 2.0
        self.told: list[tuple[str, int]] = []
        self.sequence = SimpleNamespace(abandon=self._abandon, state=State.SAFE_STOP)
        cycle: Any = SimpleNamespace(fall_back=self._fall_back, sequence=self.sequence)
        self.fallback = Fallback(CONFIG, cycle, Part("fallback", 3, lasting=True))
        self.tick = BEGIN

    def _abandon(self, reason: str, tick: int) -> None:
        self.told.append((reason, tick))

    def _fall_back(self, image: ProcessImage, tick: int) -> None:
        assert tick == self.tick
        if self.torque is None:
            raise RuntimeError("no torque")
        image.commands["torque"] = self.torque

    def begin(self) -> Robot:
        self.fallback.begin("because", BEGIN)
        return self

    def step(self, *, disable: bool = False) -> bool:
        """Whether the drives are asked for a torque still."""
        self.fallback.step(self.image, self.tick, disable=disable)
        self.tick += 1
        commands = self.image.commands
        wanted = (commands["command"] == AxisCommand.ENABLE).all()
        if not wanted:
            assert (commands["command"] == AxisCommand.DISABLE).all()
            assert not commands["torque"].any()
        return bool(wanted)

    def ticks(self, most: int = 200) -> int:
        """Until the drives are disabled."""
        return next(count for count in range(most) if not self.step())


def test_it_begins_with_the_reason_and_the_tick() -> None:
    robot = Robot()
    assert not robot.fallback.active
    assert not robot.fallback.over
    robot.begin()
    assert robot.fallback.active
    assert robot.told == [("because", BEGIN)]
    assert robot.step()
    assert robot.image.commands["torque"].tolist() == [2.0] * N
    assert not robot.fallback.over


def test_drums_at_rest_are_disabled_after_a_while() -> None:
    """Ten ticks after the first one, which tells where they are."""
    assert Robot().begin().ticks() == 10


def test_a_drum_that_turns_has_to_come_to_rest_first() -> None:
    """Whichever it is, and to both sides; at 2 mm it rests."""
    for drum, way in ((0, 1.001), (N - 1, -1.001)):
        robot = Robot().begin()
        for _ in range(6):
            assert robot.step()
        robot.image.axes["angle"][drum] = way * TURN
        assert robot.ticks() == 10
    robot = Robot().begin()
    for _ in range(6):
        assert robot.step()
    robot.image.axes["angle"][3] = TURN
    assert robot.ticks() == 4


def test_a_drum_that_creeps_does_not_rest() -> None:
    """It is disabled when it has taken too long: 50 ticks."""
    robot = Robot().begin()
    count = 0
    while robot.step():
        count += 1
        robot.image.axes["angle"][2] += 0.3 * TURN
    assert count == 50


def test_a_drum_that_does_not_answer_is_not_waited_for() -> None:
    """Nor is its angle believed; one that is as old as may be is."""
    for age, ticks in ((STALE + 1, 10), (STALE, 50)):
        robot = Robot().begin()
        robot.image.axes["age"][1] = age
        count = 0
        while robot.step():
            count += 1
            robot.image.axes["angle"][1] += 2.0 * TURN
        assert count == ticks


def test_a_drum_that_answers_again_counts_from_where_it_was() -> None:
    robot = Robot().begin()
    assert robot.step()
    robot.image.axes["age"][1] = STALE + 1
    robot.image.axes["angle"][1] = 5.0 * TURN
    for _ in range(5):
        assert robot.step()
    robot.image.axes["age"][1] = 0
    assert robot.ticks() == 10, "it has turned meanwhile"


def test_where_no_drive_is_enabled_nothing_is_waited_for() -> None:
    robot = Robot().begin()
    robot.image.axes["state"] = AxisState.FAULT
    assert not robot.step()
    robot = Robot().begin()
    robot.image.axes["state"][1:] = AxisState.FAULT
    assert robot.step(), "one is"


def test_an_emergency_stop_disables_at_once_and_for_good() -> None:
    robot = Robot().begin()
    assert robot.step()
    assert not robot.step(disable=True)
    assert not robot.step(disable=False)
    assert not robot.fallback.over


def test_it_is_over_once_every_drive_says_that_it_is_off() -> None:
    """In a later tick than that of the command; a drive that is silent is not waited for."""
    robot = Robot().begin()
    robot.image.axes["state"] = AxisState.SWITCHED_ON
    assert not robot.step(disable=True)
    assert not robot.fallback.over, "what it says is of before"
    assert not robot.step()
    assert robot.fallback.over
    assert robot.sequence.state is State.FAULT
    for age, over in ((STALE + 1, True), (STALE, False)):
        robot = Robot().begin()
        robot.image.axes["state"][1:] = AxisState.SWITCHED_ON
        robot.image.axes["age"][0] = age
        robot.step(disable=True)
        robot.step()
        assert robot.fallback.over is over
        assert robot.sequence.state is (State.FAULT if over else State.SAFE_STOP)


def test_drives_that_stay_enabled_are_not_waited_for_longer_than_allowed() -> None:
    robot = Robot().begin()
    robot.step(disable=True)
    over = []
    for _ in range(4):
        robot.step()
        over.append(robot.fallback.over)
    assert over == [False, False, False, True]


@pytest.mark.parametrize("torque", [None, float("nan"), float("inf")])
def test_a_fallback_that_raises_too_gives_no_torque(torque: float | None) -> None:
    """In any tick, also in one after another that was good; nor does a torque that is no number."""
    robot = Robot().begin()
    assert robot.step()
    robot.torque = torque
    for _ in range(5):
        assert robot.step()
        assert not robot.image.commands["torque"].any()
    robot.torque = 2.0
    assert robot.step()
    assert robot.image.commands["torque"].tolist() == [2.0] * N
    robot.torque = np.where(np.arange(N) == 3, np.nan, 2.0)
    assert robot.step()
    assert not robot.image.commands["torque"].any()


@pytest.mark.parametrize(("rest_s", "ticks"), [(0.0001, 1), (0.001, 1), (0.002, 2)])
def test_it_waits_for_a_tick_at_least(rest_s: float, ticks: int) -> None:
    fallback = CONFIG.operation.fallback.model_copy(update={"rest_s": rest_s, "off_s": 0.0001})
    operation = CONFIG.operation.model_copy(update={"fallback": fallback})
    robot = Robot()
    cycle: Any = SimpleNamespace(fall_back=robot._fall_back, sequence=robot.sequence)
    config = CONFIG.model_copy(update={"operation": operation})
    robot.fallback = Fallback(config, cycle, Part("fallback", 3, lasting=True))
    assert robot.begin().ticks() == ticks
    assert not robot.fallback.over
    robot.step()
    assert robot.fallback.over, "a tick later"
