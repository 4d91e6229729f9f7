"""A robot of stone: its platform rests where it is, its cables carry what they are asked to, and a
test may say what else the devices report. Brought up in a tenth of a second of its own time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config import load
from tonus.drivers.process_image import AxisCommand, AxisState, ProcessImage
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.operation.operator import Script
from tonus.runtime.signals import CycleRecord
from tonus.runtime.states import Operator, State

Array = NDArray[np.float64]
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
REST = [0.0, 0.0, -0.1]
OVERRIDES: dict[str, Any] = {
    "robot.home": REST,
    # Its drums have wound in what a tension stretches, in the same tick.
    "robot.cable.damping": 0.0,
    "control.sequence.tare_s": 0.003,
    "control.sequence.referencing_settle_s": 0.004,
    "control.sequence.referencing_average_s": 0.03,
    "control.sequence.referencing_poses": 2,
    "control.sequence.slack_s": 0.0,
    "control.sequence.take_up_s": 0.02,
    "control.sequence.pretension_s": 0.02,
    "control.sequence.lift_s": 0.02,
    "control.sequence.stop_s": 0.02,
    "control.sequence.lower_s": 0.02,
    "control.sequence.hold_s": 0.02,
    "control.sequence.enable_timeout_s": 0.02,
    # Stone answers no torque; `test_runtime_isolation` has what a drum's torque tells.
    "control.isolation.torque_error": 1e9,
    "control.isolation.acceleration": 1e9,
}
CONFIG, SCENARIO = load("config/can.yaml", scenario="sine_x", overrides=OVERRIDES)
CABLES, CELLS = CONFIG.robot.cables, CONFIG.robot.cells
CONTROL = CONFIG.control
POSE_TICKS = 8


class Statue:
    """`report` makes the well-behaved inputs of a tick; a test may change them before `step`."""

    def __init__(self, cycle: ControlCycle | None = None) -> None:
        self.cycle = cycle or ControlCycle(
            CONFIG.robot, CONTROL, CONFIG.tracker, SCENARIO.reference
        )
        self.image = ProcessImage(8)
        self.record: CycleRecord = self.cycle.record
        self.number = 0
        kinematics = Kinematics(CONFIG.robot.geometry)
        kinematics.evaluate(np.array(REST), LEVEL)
        self._length = kinematics.lengths
        self._cable = CONFIG.robot.cable.axial_stiffness
        self._radius = CONFIG.robot.drum.radius

    @property
    def state(self) -> State:
        return self.cycle.sequence.state

    def at(self, state: State) -> bool:
        return self.state is state

    def report(self) -> ProcessImage:
        """What obedient devices say."""
        image, tension = self.image, CONTROL.tension
        image.axes["age"], image.cells["age"] = 0, 0
        image.cells["status"] = 0
        enabled = image.commands["command"] == AxisCommand.ENABLE
        image.axes["state"] = np.where(
            enabled, AxisState.OPERATION_ENABLED, AxisState.SWITCH_ON_DISABLED
        )
        carried = np.where(enabled, self.record.tension.reference, 0.0)
        if self.state is State.REFERENCING:
            carried = np.full(CABLES, tension.referencing)
        taut = 1.0 + tension.referencing / self._cable
        # Wound in by just what the cable stretches, so that the platform stays where it is.
        image.axes["angle"] = self._length / taut - self._length / (1.0 + carried / self._cable)
        image.axes["angle"] /= self._radius
        image.cells["force"] = 0.0
        # A cell that repeats its reading to the last bit counts as frozen.
        quiver = 1e-9 * (self.number % 2) * (carried > 0.0)
        image.cells["force"][:CABLES] = carried + quiver
        seen = image.tracker
        seen["fresh"] = self.number % POSE_TICKS == 0
        seen["position"], seen["quaternion"] = REST, LEVEL
        seen["delay"] = POSE_TICKS * CONTROL.rates.period
        return image

    def step(self, operator: Operator = Operator.NONE) -> CycleRecord:
        record = self.cycle.step(self.image, self.number, operator)
        self.number += 1
        return record

    def rest(self, ticks: int) -> None:
        for _ in range(ticks):
            self.report()
            self.step()

    def until(self, state: State) -> Statue:
        """Bring it up to a state; to SAFE_STOP and STANDBY by way of ACTIVE."""
        script = Script(0.01)
        for _ in range(1000):
            if self.state is state:
                return self
            self.report()
            self.step(script.next(self.cycle.sequence))
        raise AssertionError(f"{state.name} was not reached, but {self.state.name}")


__all__ = ["CABLES", "CELLS", "CONFIG", "CONTROL", "LEVEL", "REST", "SCENARIO", "Statue"]
