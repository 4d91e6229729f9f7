"""Tensions held at what they were: how the paper's first stage measures a passive slope."""

from __future__ import annotations

import numpy as np

from tonus.config.schema.control import Control, TensionLoop
from tonus.config.schema.robot import Robot
from tonus.runtime.control.controllers.base import NOTHING, Array, Controller, Motion
from tonus.runtime.control.controllers.linear import LinearLaw
from tonus.runtime.control.kinematics import Kinematics


class ConstantTension(Controller):
    """A spring of K0 until ``settle_s`` into ACTIVE; from then on every cable is asked for its mean
    tension over the second half of that time, and besides only for the least that keeps the
    platform level,

        T = T_0 + W^T (W W^T)^-1 [0; m],

    which adds no force. Who displaces the platform then feels the geometric stiffness of T_0 alone.
    Roll and pitch would not stand by themselves: of them it is slightly negative.
    """

    def __init__(self, robot: Robot, control: Control) -> None:
        super().__init__(robot, control)
        self._kinematics = Kinematics(robot.geometry)
        self._settle = control.constant_tension.settle_s
        self._sum = np.zeros(len(robot.geometry.frame))
        self.reset()

    @property
    def tension_loop(self) -> TensionLoop:
        integral = self._control.constant_tension.integral
        return self._control.tension_loop.model_copy(update={"integral": integral})

    def linear_laws(self) -> tuple[LinearLaw, ...]:
        """The spring; the tensions that it holds afterwards feed nothing back."""
        return (self._spring(self.resting_stiffness),)

    def stiffness(self, motion: Motion) -> float:  # noqa: ARG002
        return self.resting_stiffness

    def reset(self) -> None:
        self._sum[:] = 0.0
        self._ticks = 0
        self._frozen = False

    def applied(self, tensions: Array, active: float) -> None:
        self._frozen = active >= self._settle and self._ticks > 0
        if active < 0.0:
            self.reset()
        elif not self._frozen and active >= 0.5 * self._settle:
            self._sum += tensions
            self._ticks += 1

    def tensions(self, motion: Motion, stiffness: float, centre: Array) -> Array | None:
        if not self._frozen:
            return super().tensions(motion, stiffness, centre)
        self._kinematics.evaluate(motion.position, motion.quaternion)
        matrix = self._kinematics.matrix
        wrench = self._levelled(motion, (NOTHING, NOTHING, NOTHING))
        correction = matrix.T @ np.linalg.solve(matrix @ matrix.T, wrench)
        return np.asarray(self._sum / self._ticks + correction)
