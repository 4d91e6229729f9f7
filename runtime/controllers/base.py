"""What a controller sees and what it gives back."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from config.schema.control import Control
from config.schema.robot import Robot
from runtime.compiled import rotation_between
from runtime.stiffness import LawTerms

Array = NDArray[np.float64]
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
"""The desired orientation, w x y z."""


@dataclass
class Motion:
    """Desired against estimated motion of one tick; vectors (3,), base frame."""

    desired_position: Array
    desired_velocity: Array
    desired_acceleration: Array
    position: Array
    quaternion: Array
    velocity: Array
    angular_velocity: Array
    external_force: float
    """N, norm of the estimated external force"""

    @property
    def error(self) -> Array:
        return self.desired_position - self.position

    @property
    def error_rate(self) -> Array:
        return self.desired_velocity - self.velocity


class Controller(ABC):
    """Stiffness first, then the wrench at the stiffness that envelope and limiter let through."""

    def __init__(self, robot: Robot, control: Control) -> None:
        self._robot, self._control = robot, control
        self.terms = LawTerms()
        """what the law added, where there is a law"""
        self._weight = np.array([0.0, 0.0, robot.platform.mass * robot.gravity])

    @abstractmethod
    def reset(self) -> None:
        """Forget the past, before motion starts."""

    @abstractmethod
    def stiffness(self, motion: Motion) -> float:
        """The stiffness (N/m) this controller would like now."""

    @abstractmethod
    def force(self, motion: Motion, stiffness: float) -> Array:
        """Force (3,) without gravity, at the stiffness allowed."""

    def wrench(self, motion: Motion, stiffness: float) -> Array:
        """Wrench (6,) asked of the cables: the controller's force, inertia and weight fed forward,
        and a rotational spring that keeps the platform level."""
        impedance = self._control.impedance
        tilt = rotation_between(motion.quaternion, LEVEL)
        mass = self._robot.platform.mass
        result = np.empty(6)
        result[:3] = (
            self.force(motion, stiffness) + mass * motion.desired_acceleration + self._weight
        )
        result[3:] = (
            impedance.rotational_stiffness * tilt
            - impedance.rotational_damping * motion.angular_velocity
        )
        return result
