"""The fair classical baseline: operational-space PID with a bounded integral."""

from __future__ import annotations

import numpy as np

from tonus.config.schema.control import Control
from tonus.config.schema.robot import Robot
from tonus.runtime.control.controllers.base import Array, Controller, Motion
from tonus.runtime.control.controllers.integral import Integral
from tonus.runtime.control.controllers.linear import LinearLaw


class Pid(Controller):
    """F = K e + D de/dt + I, at constant gains. The envelope's cap still applies: it scales all
    three, and the integral stands still while it does."""

    def __init__(self, robot: Robot, control: Control) -> None:
        super().__init__(robot, control, control.pid.damping_ratio)
        self.resting_stiffness = control.pid.stiffness
        self._integral = Integral(control.pid.integral, control.rates.period)

    def reset(self) -> None:
        self._integral.reset()

    def linear_laws(self) -> tuple[LinearLaw, ...]:
        return (self._spring(self.resting_stiffness, self._control.pid.integral.gain),)

    def stiffness(self, motion: Motion) -> float:  # noqa: ARG002
        return self.resting_stiffness

    def force(self, motion: Motion, stiffness: float) -> Array:
        wanted = self.resting_stiffness
        integral = self._integral(motion, stiffness, held=stiffness < wanted)
        return np.asarray(super().force(motion, stiffness) + stiffness / wanted * integral)


class PidAtRest(Pid):
    """`pid` that rests at the lower tensions of `bio_observer`, and has no rule that raises them
    under a load: what of an advantage is the lower baseline alone. For studies, by its module."""

    def __init__(self, robot: Robot, control: Control) -> None:
        super().__init__(robot, control)
        self.tone = control.bio_observer.tone
