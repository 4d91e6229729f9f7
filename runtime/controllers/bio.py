"""The paper's controller: impedance at the stiffness of the bio-inspired law."""

from __future__ import annotations

import math

import numpy as np

from config.schema.control import Control
from config.schema.robot import Robot
from runtime.controllers.base import Array, Controller, Motion
from runtime.stiffness import Law


class Bio(Controller):
    """F = K_eq e + D(K_eq) de/dt with D = 2 zeta sqrt(K_eq m)."""

    def __init__(self, robot: Robot, control: Control) -> None:
        super().__init__(robot, control)
        self._law = Law(control.stiffness)
        self.terms = self._law.terms

    def reset(self) -> None:
        """The law has no memory."""

    def stiffness(self, motion: Motion) -> float:
        source = self._control.stiffness.velocity_source
        rate = motion.error_rate if source == "error" else motion.velocity
        return self._law(_norm(motion.error), _norm(rate), motion.external_force)

    def force(self, motion: Motion, stiffness: float) -> Array:
        ratio = self._control.impedance.damping_ratio
        damping = 2.0 * ratio * math.sqrt(stiffness * self._robot.platform.mass)
        return np.asarray(stiffness * motion.error + damping * motion.error_rate)


def _norm(vector: Array) -> float:
    return math.sqrt(float(vector @ vector))
