"""The distribution stage: from a wrench and a stiffness to the tension reference of each cable.

Co-contraction raises the tensions about which the least squares are taken; bounds follow the levels
of the state and the tension rate. In a descent the cables that are left are asked for instead.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.control import Control
from tonus.config.schema.robot import Robot
from tonus.runtime.control.controllers import Controller, Motion
from tonus.runtime.control.controllers.base import share
from tonus.runtime.control.distribution import TensionDistribution
from tonus.runtime.control.distribution_kernels import (
    AGONISM,
    CENTRE,
    DELIVERED,
    GRADIENT,
    HIGH,
    delivered,
    distribute_tick,
    prepare,
)
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.safety.descent import Descent
from tonus.runtime.safety.faults import Faults
from tonus.runtime.safety.sequence import Levels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Allocation:
    """Tension references (n,) N, at the pose that ``kinematics`` has been evaluated at."""

    def __init__(
        self, robot: Robot, control: Control, controller: Controller, kinematics: Kinematics
    ) -> None:
        settings = self._settings = control.distribution
        self._controller, self._kinematics = controller, kinematics
        cables = robot.cables
        self._usual = TensionDistribution(settings, robot.geometry.moment_length, cables)
        self.distribution = self._usual
        """that of this tick"""
        self.wrench = np.zeros(6)
        """N and N m that are asked for"""
        self.reference = np.zeros(cables)
        self._cables = np.zeros((5, cables))
        self._gradient, self._low, self._high = self._cables[GRADIENT : HIGH + 1]
        self.centre = self._cables[CENTRE]
        """N (n,), what the references are drawn towards"""
        self.agonism = self._cables[AGONISM]
        """(n,), how much a cable works with the wrench and against its antagonists"""
        self.delivered = self._usual.wrenches[DELIVERED]
        """of ``wrench``, by the references"""
        self.shortfall = np.zeros(3)
        """N of force that measured tensions leave undelivered"""
        self.geometric = 0.0
        """N/m, stiffness that the tensions add by themselves"""
        self._bearing = np.zeros((6, cables))
        self._contraction = 0.0
        """share by which all tensions are raised, on its way to what the stiffness asks for"""
        period = control.rates.period
        self._step = control.distribution.tension_rate * period
        self._prepared: tuple[Any, ...] = (
            settings.least_force,
            self._step,
            self.agonism,
            self._gradient,
            self._low,
            self._high,
            self.centre,
            self._bearing,
        )
        self._kept: tuple[Any, ...] = (
            self._cables,
            self._bearing,
            self._usual.scaled,
            self._usual.normal,
            self._usual.wrenches,
            self.shortfall,
            np.array([settings.least_force, self._step, *self._usual.weights]),
        )
        # Asked once: of most controllers there is nothing to hear between the two kernels.
        self._commands_tensions = type(controller).tensions is not Controller.tensions
        activation = settings.co_contraction_hz
        self._activate = 1.0 if activation is None else share(activation, period)

    def reset(self) -> None:
        self._contraction = 0.0

    def distribute(
        self, motion: Motion, stiffness: float, levels: Levels, present: Mask, tension: Array
    ) -> None:
        """Co-contraction follows the ``stiffness`` (N/m); a cable that is not ``present`` (n,)
        carries nothing; ``tension`` (n,) N is measured, for `deliver`."""
        middle = levels.level * self._controller.tone
        settings, base = self._settings, self._controller.resting_stiffness
        contraction = settings.co_contraction * (stiffness / base - 1.0)
        self._contraction += self._activate * (contraction - self._contraction)
        distribution = self.distribution = self._usual
        asked: tuple[Any, ...] = (
            self._kinematics.matrix,
            self._kinematics.lengths,
            self.wrench,
            self.reference,
            present,
            levels.low,
            levels.high,
            middle,
            self._contraction,
        )
        if self._commands_tensions:
            self._draw(motion, stiffness, present, asked)
        tensions = np.empty(len(self.centre))
        asked = (*asked, tension, tensions, *self._kept)
        inside, finite, deficit, self.geometric = distribute_tick(self._commands_tensions, *asked)
        if inside and finite:
            distribution.found(deficit)
            self.reference = tensions
            return
        self.reference = distribution.bounded(
            tensions, self.centre, self._low, self._high, inside=inside
        )
        self.deliver(tension)

    def _draw(
        self, motion: Motion, stiffness: float, present: Mask, asked: tuple[Any, ...]
    ) -> None:
        """The tensions that a controller commands are what the references are drawn towards."""
        matrix, lengths, wrench, *others = asked
        prepare(matrix, lengths, wrench[:3], *others, *self._prepared)
        wanted = self._controller.tensions(motion, stiffness, self.centre)
        if wanted is not None:
            self.centre[:] = wanted * present
            self.wrench[:] = matrix @ self.centre

    def descend(self, descent: Descent, tension: Array, carrying: Mask, faults: Faults) -> None:
        """What the cables that are left are asked for; ``tension`` (n,) N as far as believed."""
        self.distribution = descent.distribution
        self.reference = descent.plan(
            self._kinematics.matrix, self.wrench, self.reference, tension, carrying, faults
        )
        self.centre[:] = descent.centre

    def rehearse(self, descent: Descent) -> None:
        """What an ordinary tick needs no answer to: a descent's distribution, and bounds that are
        met, which also make `deliver` a call of its own."""
        cables = len(self.centre)
        low, high, matrix = np.zeros(cables), np.ones(cables), np.ones((6, cables))
        for most in (2.0, 0.5):
            descent.distribution(matrix, np.zeros(6), most * high, low, high)
        self.deliver(low)

    def deliver(self, tension: Array) -> None:
        """What the references, and the measured ``tension`` (n,) N, give of the wrench."""
        self.geometric = delivered(
            self._kinematics.matrix,
            self.reference,
            self.wrench,
            self._gradient,
            tension,
            self.delivered,
            self.shortfall,
        )
