"""The fair classical baseline: operational-space PID with a bounded integral."""

from __future__ import annotations

import math

import numpy as np

from config.schema.control import Control
from config.schema.robot import Robot
from runtime.controllers.base import Array, Controller, Motion


class Pid(Controller):
    """F = K e + D de/dt + I, at constant gains. The envelope's cap still applies: it scales all
    three, and the integral stands still while it does."""

    def __init__(self, robot: Robot, control: Control) -> None:
        super().__init__(robot, control)
        self._step = control.pid.integral * control.rates.period
        self._integral = np.zeros(3)

    def reset(self) -> None:
        self._integral[:] = 0.0

    def stiffness(self, motion: Motion) -> float:  # noqa: ARG002
        return self._control.pid.stiffness

    def force(self, motion: Motion, stiffness: float) -> Array:
        gains = self._control.pid
        damping = 2.0 * gains.damping_ratio * math.sqrt(stiffness * self._robot.platform.mass)
        if stiffness >= gains.stiffness:
            self._integral += self._step * motion.error
            size = math.sqrt(float(self._integral @ self._integral))
            if size > gains.integral_limit:
                self._integral *= gains.integral_limit / size
        share = stiffness / gains.stiffness
        return np.asarray(
            stiffness * motion.error + damping * motion.error_rate + share * self._integral
        )
