"""An axis of a robot whose axes differ does what it does in a robot of such axes only: in
control, in the drivers and in the plant, bit for bit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.observed import observe
from tonus.config import load
from tonus.config.schema.axis import DriveTrain
from tonus.config.schema.robot import Robot
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import Exchange
from tonus.drivers.process_image import AxisCommand, AxisState, ProcessImage
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.referencing import Referencing
from tonus.runtime.control.sensing import Sensing
from tonus.runtime.control.tension import TensionLoop, drum_motion, of_axis
from tonus.runtime.safety.drum_observer import DrumObserver
from tonus.runtime.safety.guard import Guard
from tonus.sim.plant import Plant

Array = NDArray[np.float64]
CONFIG, _ = load("config/unlike_axes.yaml")
CABLES = CONFIG.robot.cables
UNLIKE, CONTROL, LAB = CONFIG.robot, CONFIG.control, CONFIG.lab
assert LAB is not None
TRAINS = UNLIKE.drive_trains
PERIOD = CONTROL.rates.period
EVERY = np.ones(CABLES, dtype=bool)
Made = Callable[[Robot, DriveTrain | None], Array]
"""(m, n) of a robot, whose axes all have this drive train; None: they differ"""


def of_such_axes_only(axis: int) -> Robot:
    train, sign = TRAINS[axis], UNLIKE.signs[axis]
    parts = {name: getattr(train, name) for name in DriveTrain.model_fields}
    robot = UNLIKE.model_copy(update=parts | {"axes": {}}).model_dump()
    return Robot.model_validate(robot | {"axes": {each: {"sign": sign} for each in range(CABLES)}})


def drawn(seed: int, *shape: int) -> Array:
    return np.random.default_rng(seed).normal(0.0, 1.0, shape or (CABLES,))


def loop(robot: Robot, train: DriveTrain | None) -> Array:
    settings = CONTROL.tension_loop
    if train is not None:
        settings = of_axis(settings, train, UNLIKE)
    made, rows = TensionLoop(robot, settings, PERIOD), []
    lengths = np.linspace(0.9, 1.3, CABLES)
    for tick in range(20):
        reference = 60.0 + 3.0 * drawn(tick)
        measured, wanted, rate = drawn(tick + 100) + 55.0, drawn(tick + 200), drawn(tick + 300)
        desired = drawn(tick + 400), drawn(tick + 500)
        rows.append(made(reference, measured, wanted, rate, EVERY, lengths, desired).copy())
    rows.append(made(np.full(CABLES, 1e5), measured, wanted, rate, EVERY, lengths, desired).copy())
    return np.array(rows)


def motion(robot: Robot, _: DriveTrain | None) -> Array:
    rates = np.zeros((3, CABLES))
    twist = drawn(1, 3), drawn(2, 3)
    desired = drawn(3, 3), drawn(4, 3), drawn(6, 3), drawn(7, 3)
    tension = 50.0 + drawn(5)
    drum_motion(
        drawn(6, 6, CABLES), np.zeros(6), tension, twist, desired,
        robot.drum_radius, robot.axial_stiffness, *rates,
    )  # fmt: skip
    return rates


def guard(robot: Robot, _: DriveTrain | None) -> Array:
    made, rows = Guard(robot, CONTROL.stop, PERIOD), []
    for tick in range(20):
        rate, torque = 20.0 * drawn(tick), 3.0 * drawn(tick + 100)
        rows.append(made.passive(rate, EVERY).copy())
        made.take_up(torque, rate, drawn(tick + 200), drawn(tick + 300) > 0.0)
        made.bound(torque, rate, EVERY)
        rows += [torque, made.tank.copy()]
    rows.append(1e6 * np.sign(drawn(0)))
    made.bound(rows[-1], np.zeros(CABLES), EVERY)
    return np.array(rows)


def observer(robot: Robot, _: DriveTrain | None) -> Array:
    made, rows = DrumObserver(robot, CONTROL.isolation), []
    angle = np.zeros(CABLES)
    for tick in range(20):
        rate = 0.1 * drawn(tick) + (tick > 15) * 30.0
        angle = angle + PERIOD * rate
        torque, tension = 1.0 + 0.1 * drawn(tick + 100), 50.0 + drawn(tick + 200)
        interval = np.full(CABLES, PERIOD)
        observe(made, angle, rate, torque, tension, drawn(tick + 300), EVERY, interval)
        rows += [*made._drums.copy(), made.misled.copy()]
    return np.array(rows)


def sensing(robot: Robot, _: DriveTrain | None) -> Array:
    made, image, rows = Sensing(robot, CONTROL), ProcessImage(8), []
    image.axes["age"] = 0
    for tick in range(1, 60):
        image.axes["angle"] = 1e-2 * tick**2
        made.step(image, tick)
        rows += [made.rate.copy(), made.implausible_axes.copy()]
    assert np.any(rows[1::2]), "no motor is that fast"
    return np.array(rows, dtype=np.float64)


def referencing(robot: Robot, _: DriveTrain | None) -> Array:
    kinematics = Kinematics(robot.geometry)
    made = Referencing(robot, CONTROL.sequence, kinematics, 2.0, CONTROL.rates.period)
    image = ProcessImage(8)
    image.tracker["fresh"], image.tracker["quaternion"] = 1, (1.0, 0.0, 0.0, 0.0)
    image.tracker["position"] = robot.rest
    for _tick in range(CONTROL.sequence.referencing_poses):
        made.collect(image, drawn(1), np.full(CABLES, 12.0))
    assert not made.conclude(12.0)
    lengths = made.lengths(drawn(2), 50.0 + drawn(3))
    return np.array([made.unstretched, made.wound, made.elastic, lengths])


def exchange(robot: Robot, _: DriveTrain | None) -> Array:
    image, bus = ProcessImage(8), CONFIG.fieldbus
    made = Exchange(
        robot, bus.force_cell, CONTROL.freshness, image, EventLog(), [str(i) for i in range(CABLES)]
    )
    made.positions[:], made.torques[:] = 100_000 * drawn(1), 300 * drawn(2)
    made.axis_tick[:], made.statuswords[:] = 4, 0x1637
    made.fill(5)
    assert (image.axes["state"] == AxisState.OPERATION_ENABLED).all()
    image.commands["command"] = AxisCommand.ENABLE
    rows = [image.axes["angle"].copy(), image.axes["torque"].copy()]
    for torque in (3.0 * drawn(3), np.full(CABLES, 1e6), np.full(CABLES, -1e6)):
        image.commands["torque"] = torque
        rows.append(np.array(made.commands()[1], dtype=np.float64))
    return np.array(rows)


def plant(robot: Robot, _: DriveTrain | None) -> Array:
    """Drums alone, on cables that are loose; and what the drives see of the motors."""
    made = Plant(robot, LAB, seed=3, phantom=None, load=None)
    made.parameters["start_length"] += 10.0
    made.powered[:] = True
    made.current_reference[:] = np.array(robot.signs) * (0.5 + 0.2 * np.arange(CABLES))
    made.advance(20_000_000)
    made.current_reference[:] *= 40.0
    made.advance(30_000_000)
    seen = (made.motor_angle, made.motor_rate, made.motor_current, made.drum_angle, made.drum_rate)
    return np.array([*seen, made.current])


@pytest.mark.parametrize(
    "make",
    [loop, motion, guard, observer, sensing, referencing, exchange, plant],
    ids=lambda make: make.__name__,
)
def test_each_axis_is_as_in_a_robot_of_such_axes_only(make: Made) -> None:
    found = make(UNLIKE, None)
    uniform = make(of_such_axes_only(0), TRAINS[0])
    for axis in range(CABLES):
        only = make(of_such_axes_only(axis), TRAINS[axis])
        assert np.array_equal(found[:, axis], only[:, axis], equal_nan=True), axis
    assert not np.array_equal(found[:, 4], uniform[:, 4], equal_nan=True), "it makes a difference"
