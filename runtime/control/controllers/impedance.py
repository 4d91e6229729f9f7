"""Spring and damper at a constant stiffness: what adaptation is compared with."""

from __future__ import annotations

from tonus.config.schema.control import Control
from tonus.config.schema.robot import Robot
from tonus.runtime.control.controllers.base import Controller, Motion
from tonus.runtime.control.controllers.linear import LinearLaw


class Pd(Controller):
    """Operational-space PD, at the law's base stiffness where none of its own is given."""

    def __init__(self, robot: Robot, control: Control) -> None:
        super().__init__(robot, control, control.pd.damping_ratio)
        self.resting_stiffness = control.pd.stiffness or control.stiffness.base

    def linear_laws(self) -> tuple[LinearLaw, ...]:
        return (self._spring(self.resting_stiffness),)

    def stiffness(self, motion: Motion) -> float:  # noqa: ARG002
        return self.resting_stiffness


class PdMatched(Controller):
    """The same as stiff as `bio` is on average, so that only adaptation is left to compare."""

    def __init__(self, robot: Robot, control: Control) -> None:
        super().__init__(robot, control, control.pd_matched.damping_ratio)
        self.resting_stiffness = control.pd_matched.stiffness

    def linear_laws(self) -> tuple[LinearLaw, ...]:
        return (self._spring(self.resting_stiffness),)

    def stiffness(self, motion: Motion) -> float:  # noqa: ARG002
        return self.resting_stiffness
