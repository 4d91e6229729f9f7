"""The classical cable robot: every drum on its own PID, lengths from inverse kinematics."""

from __future__ import annotations

import numpy as np

from tonus.config.schema.control import Control, TensionLoop
from tonus.config.schema.robot import Robot
from tonus.runtime.control.controllers.base import LEVEL, Array, Controller, Motion
from tonus.runtime.control.controllers.linear import LinearLaw
from tonus.runtime.control.distribution import closed_form
from tonus.runtime.control.kinematics import Kinematics


class PidLength(Controller):
    """Unstretched length L0 of every cable follows that of the desired pose,

        T = T_ff + k_p (L0 - L0_d) + k_d (rate_d - rate) + I,    L0_d = l_d / (1 + T_ff / EA),

    with T_ff balancing weight and inertia at the desired pose. The load itself is not measured: a
    cable gives way by its own elasticity. The stiffness it reports is that of drums and cables in
    series at home, averaged over the axes; the envelope's cap scales the feedback.
    """

    follows_platform = False

    def __init__(self, robot: Robot, control: Control) -> None:
        super().__init__(robot, control)
        gains = self._gains = control.pid_length
        self._integral = np.zeros(robot.cables)
        self._step = gains.integral * control.rates.period
        self._kinematics = Kinematics(robot.geometry)
        self._kinematics.evaluate(np.array(robot.home), LEVEL)
        self._axial_stiffness = robot.axial_stiffness
        cable = self._kinematics.lengths / self._axial_stiffness
        series = 1.0 / (1.0 / gains.proportional + cable)
        pull = self._kinematics.matrix[:3]
        self.resting_stiffness = float(np.trace(pull * series @ pull.T)) / 3.0

    @property
    def tension_loop(self) -> TensionLoop:
        """Without the lead: it gives phase to a loop round the tension loop, and here, where every
        tension answers its own drum, it would cost half the stiffness the margins allow."""
        return self._control.tension_loop.model_copy(update={"lead": 0.0})

    def reset(self) -> None:
        self._integral[:] = 0.0

    def linear_laws(self) -> tuple[LinearLaw, ...]:
        gains = self._gains
        return (LinearLaw(cable=(gains.proportional, gains.derivative, gains.integral)),)

    def stiffness(self, motion: Motion) -> float:  # noqa: ARG002
        return self.resting_stiffness

    def tensions(self, motion: Motion, stiffness: float, centre: Array) -> Array:
        kinematics, gains = self._kinematics, self._gains
        kinematics.evaluate(motion.desired_position, motion.desired_quaternion)
        wrench = np.zeros(6)
        wrench[:3] = self._robot.platform.mass * motion.desired_acceleration + self._weight
        wrench[:3] += motion.push
        forward = closed_form(kinematics.matrix, wrench, centre)
        wanted = kinematics.lengths / (1.0 + forward / self._axial_stiffness)
        error = motion.wound - wanted
        rate = kinematics.matrix[:3].T @ motion.desired_velocity - motion.winding
        if stiffness >= self.resting_stiffness:
            limit = gains.integral_limit
            self._integral = np.clip(self._integral + self._step * error, -limit, limit)
        back = gains.proportional * error + gains.derivative * rate + self._integral
        return np.asarray(forward + stiffness / self.resting_stiffness * back)
