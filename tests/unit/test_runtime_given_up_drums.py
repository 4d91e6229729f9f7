"""Drums of given-up cables against their torque, by Newton's law and in a passive stop."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from loop import QUICK, ClosedLoop, configured

from tonus.config import load
from tonus.config.errors import ConfigError
from tonus.drivers.process_image import AxisState, ProcessImage
from tonus.runtime.safety.given_up_drums import GivenUpDrums
from tonus.runtime.states import Fault, State, StopMode

CONFIG, _ = load("config/direct.yaml")
TICK = 2.0**-10
"""s"""
RADIUS, MASS = np.array([0.5, 0.25, 0.125]), np.array([2.0, 4.0, 16.0])
N = len(RADIUS)
FORCE, SHARE, TENSION = 16.0, 0.25, 64.0
SMOOTHING = 0.25
"""of the observer: a tick over its time"""
PULL = 32.0
ALLOWED = FORCE + SHARE * PULL
BIT = 2.0**-20


class Drums:
    """Drums with a pull of ``PULL`` N each, that move two ticks later as Newton has it; a test adds
    a force to one of them."""

    def __init__(self, ticks: int) -> None:
        settings = CONFIG.control.isolation.model_copy(
            update={
                "torque_s": TICK / SMOOTHING,
                "torque_error": FORCE,
                "torque_share": SHARE,
                "given_up_tension": TENSION,
                "torque_descent_ticks": ticks,
            }
        )
        robot: Any = SimpleNamespace(cables=N, drum_radius=RADIUS, drum_mass=MASS)
        self.watch = GivenUpDrums(robot, settings)
        self.image = ProcessImage(N)
        self.image.axes["age"] = 0
        self.image.axes["state"] = AxisState.OPERATION_ENABLED
        self.watched, self.speed = np.zeros(N, bool), np.zeros(N)
        self.pull = PULL
        self.pulls = [0.0, 0.0]
        self.tick(4)
        self.watched[:] = True

    def tick(self, count: int = 1, added: float = 0.0, row: int = 1) -> int:
        """The drum that disobeys after ``count`` ticks with a force ``added`` to one."""
        for _ in range(count):
            force = np.where(np.arange(N) == row, added, 0.0) + self.pulls.pop(0)
            self.pulls.append(self.pull)
            self.speed = self.speed + TICK * force / MASS
            sensing: Any = SimpleNamespace(
                drums=np.array([np.zeros(N), self.speed / RADIUS, np.full(N, TICK)])
            )
            self.watch.step(self.image, sensing, self.watched, self.pull * RADIUS)
        return self.watch.disobedient


@pytest.mark.parametrize("row", range(N))
@pytest.mark.parametrize(
    ("added", "found"),
    [
        (ALLOWED / SMOOTHING, False),
        (ALLOWED / SMOOTHING + BIT, True),
        (-(TENSION + ALLOWED) / SMOOTHING, False),
        (-(TENSION + ALLOWED) / SMOOTHING - BIT, True),
    ],
)
def test_a_cable_pulls_no_more_than_it_carries_and_never_pushes(
    row: int, added: float, found: bool
) -> None:
    """Of the force in one tick the observer sees a quarter; the bounds are met to the last bit."""
    assert Drums(1).tick(1, added, row) == (row if found else -1)


@pytest.mark.parametrize("added", [1000.0, -1000.0])
def test_it_has_to_last(added: float) -> None:
    drums = Drums(3)
    assert drums.tick(2, added) == -1
    assert drums.tick(40) == -1
    assert drums.tick(2, added) == -1
    assert drums.tick(1, added) == 1
    drums.tick(40)
    assert drums.watch.disobedient == -1


def test_a_torque_makes_its_motion_two_ticks_later() -> None:
    """As every other tick shows: another order of the same torques would be far off."""
    drums = Drums(1)
    for pull in (500.0, -300.0, 0.0, 700.0, 700.0, -20.0, 32.0, 32.0):
        drums.pull = pull
        assert drums.tick() == -1


@pytest.mark.parametrize("added", [40.0, 60.0, 90.0])
def test_what_is_allowed_of_a_torque_fades_as_that_does(added: float) -> None:
    """A torque of 256 N has ended; the force that is added shows as fast as its share fades."""
    drums = Drums(1)
    drums.pull = 256.0
    drums.tick(80)
    drums.pull = 0.0
    drums.tick(2)
    expected = next(
        ticks
        for ticks in range(1, 100)
        if added * (1.0 - (1.0 - SMOOTHING) ** ticks)
        > FORCE + SHARE * 256.0 * (1.0 - SMOOTHING) ** ticks
    )
    assert expected > 2
    assert drums.tick(expected - 1, added) == -1
    assert drums.tick(1, added) == 1


@pytest.mark.parametrize("left_out", ["watched", "age", "state", "rate"])
def test_what_is_not_known_of_a_drum_is_no_motion(left_out: str) -> None:
    """And once it is, the comparison begins anew."""
    drums = Drums(3)
    assert drums.tick(2, 1000.0) == -1
    speed = drums.speed.copy()
    if left_out == "watched":
        drums.watched[1] = False
    elif left_out == "age":
        drums.image.axes["age"][1] = 1
    elif left_out == "state":
        drums.image.axes["state"][1] = AxisState.FAULT
    else:
        drums.speed[1] = np.nan
    assert drums.tick(1, 1000.0) == -1
    drums.watched[1] = True
    drums.image.axes["age"], drums.image.axes["state"] = 0, AxisState.OPERATION_ENABLED
    if left_out == "rate":
        drums.speed = speed
        assert drums.tick(1, 1000.0) == -1, "there is nothing to compare with"
    assert drums.tick(1, ALLOWED / SMOOTHING) == -1
    assert drums.tick(2, 1000.0) == -1
    assert drums.tick(1, 1000.0) == 1


def test_ticks_on_both_sides_of_one_that_is_not_known_are_not_in_a_row() -> None:
    drums = Drums(3)
    drums.tick(2, 1000.0)
    drums.watched[1] = False
    drums.tick()
    drums.watched[1] = True
    assert drums.tick(2, 1000.0) == -1
    assert drums.tick(1, 1000.0) == 1


@pytest.mark.parametrize(
    ("added", "found"),
    [
        (FORCE / SMOOTHING, False),
        (FORCE / SMOOTHING + BIT, True),
        (-(TENSION + FORCE) / SMOOTHING, False),
        (-(TENSION + FORCE) / SMOOTHING - BIT, True),
    ],
)
def test_a_reset_forgets(added: float, found: bool) -> None:
    """Also torques on their way: what they make counts as unexplained."""
    drums = Drums(1)
    assert drums.tick(2, 1000.0) == 1
    drums.watch.reset()
    assert drums.watch.disobedient == -1
    assert drums.tick(1, 1000.0) == -1, "there is nothing to compare with"
    assert drums.tick(1, added - PULL) == (1 if found else -1)


def test_a_cable_may_carry_what_the_robot_states() -> None:
    """A taut cable would count as a drum that disobeys."""
    load("config/direct.yaml", overrides={"control.tension.max": 240.0})
    with pytest.raises(ConfigError, match=r"choose at least 240\.1"):
        load("config/direct.yaml", overrides={"control.tension.max": 240.1})


@pytest.mark.parametrize(("gain", "axis"), [(-0.6, 0), (-1.0, 6)])
def test_a_reversed_motor_whose_cell_is_lost_is_not_driven_on(gain: float, axis: int) -> None:
    """By its own damping: 4.7 and 5.4 m/s at the drum until 2026-11-29, with 300 N."""
    loop = ClosedLoop(*configured("hold", QUICK))
    loop.until(State.HOLD)
    loop.run(0.2)
    loop.silent_cells |= set(range(CONFIG.robot.cables))
    loop.run(0.15)
    sequence, plant = loop.cycle.sequence, loop.plant
    assert sequence.stop_mode is StopMode.PASSIVE
    plant.defects.weaken_motor(axis, gain)
    rates: list[float] = []
    loop.run(1.0, lambda: rates.append(float(plant.drum_rate[axis])))
    assert sequence.faults.at(Fault.DRUM_TORQUE, axis)
    assert max(map(abs, rates)) * CONFIG.robot.drum_radius[axis] < 1.0
    assert abs(rates[-1]) * CONFIG.robot.drum_radius[axis] < 0.2, "friction has stopped it"
