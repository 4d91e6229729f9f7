"""Direct force control, for scenarios that ask for a force."""

from __future__ import annotations

import math

import numpy as np

from tonus.config.schema.control import Control
from tonus.config.schema.robot import Robot
from tonus.runtime.control.controllers.base import Array, Motion, norm
from tonus.runtime.control.controllers.impedance import Pd
from tonus.runtime.control.controllers.linear import LinearLaw


class ContactForce(Pd):
    """PI on the contact cell along the direction n of the force asked for,

        F = k_p (F_d - F_c) + I + d (v_d - v) n,

    besides F_d itself, which every controller feeds forward; `pd` across it, without contact, and
    where no force is asked for. What the position is off when contact ends is forgotten over
    ``release_s`` and not at once. The envelope's cap scales the feedback.
    """

    def __init__(self, robot: Robot, control: Control) -> None:
        super().__init__(robot, control)
        gains, period = control.force, control.rates.period
        self._gains = gains
        self._step = gains.integral * period
        self._fading = math.exp(-period / gains.release_s)
        self._off = np.zeros(3)
        self._integral = 0.0

    def reset(self) -> None:
        self._off[:] = 0.0
        self._integral = 0.0

    def linear_laws(self) -> tuple[LinearLaw, ...]:
        """Free, and touching a body."""
        gains = self._gains
        contact = (gains.proportional, gains.integral)
        touching = LinearLaw(damping=gains.damping, contact=contact, body=gains.body_stiffness)
        return (*super().linear_laws(), touching)

    def force(self, motion: Motion, stiffness: float) -> Array:
        gains, impedance = self._gains, super().force(motion, stiffness)
        asked = norm(motion.push)
        if asked == 0.0 or motion.contact < gains.threshold:
            self._integral = 0.0
            self._off *= self._fading
            return np.asarray(impedance - stiffness * self._off)
        along = motion.push / asked
        self._off = float(motion.error @ along) * along
        missing = asked - motion.contact
        wanted = self.stiffness(motion)
        if stiffness >= wanted:
            grown = self._integral + self._step * missing
            self._integral = min(max(grown, -gains.integral_limit), gains.integral_limit)
        feedback = stiffness / wanted * (gains.proportional * missing + self._integral)
        feedback += gains.damping * float(motion.error_rate @ along)
        return np.asarray(impedance + (feedback - float(impedance @ along)) * along)
