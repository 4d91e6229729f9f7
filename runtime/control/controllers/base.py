"""What a controller sees and what it gives back."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.control import Control, TensionLoop
from tonus.config.schema.robot import Robot
from tonus.runtime.control.compiled import platform_wrench, spring
from tonus.runtime.control.controllers.linear import LinearLaw, NoLinearLawError
from tonus.runtime.control.passivity import damping
from tonus.runtime.control.stiffness import LawTerms

Array = NDArray[np.float64]
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
"""The desired orientation, w x y z."""
NOTHING = np.zeros(3)
_FEEDBACK = ("stiffness", "force", "wrench", "tensions")
"""methods that make a controller's feedback"""


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
    external: Array
    """N, estimated force on the platform that cables and gravity do not explain"""
    contact: float
    """N, at the contact port"""
    shortfall: Array
    """N, the part of the last tick's force that the cables could not deliver"""
    wound: Array
    """(n,) m, unstretched cable lengths"""
    winding: Array
    """(n,) m/s, rate at which they shorten"""
    push: Array
    """N, force the scenario asks for at the contact port"""

    def __post_init__(self) -> None:
        self.error = self.desired_position - self.position
        self.error_rate = self.desired_velocity - self.velocity


class Controller(ABC):
    """Stiffness first, then the wrench at the stiffness that envelope and limiter let through."""

    follows_platform = True
    """whether the drums are damped against the rate of the platform's motion, so that it may be
    pushed, or of the desired one, so that it is held"""

    tone = 1.0
    """share of the pretension that the tensions are drawn towards at rest"""

    def __init__(self, robot: Robot, control: Control, damping_ratio: float | None = None) -> None:
        """``damping_ratio``: the controller's own; None for the one under impedance."""
        self._robot, self._control = robot, control
        self.damping_ratio = damping_ratio or control.impedance.damping_ratio
        self.resting_stiffness = control.stiffness.base
        """N/m, at which cables are not tightened beyond the pretension; a constant stiffness is its
        own, or a stiff baseline would pay for co-contraction that it does not ask for"""
        self.terms = LawTerms()
        """what the law added, where there is a law"""
        impedance = control.impedance
        self._rotational = (impedance.rotational_stiffness, impedance.rotational_damping)
        self._weight = np.array([0.0, 0.0, robot.platform.mass * robot.gravity])

    @property
    def tension_loop(self) -> TensionLoop:
        """The inner loop's settings while ACTIVE."""
        return self._control.tension_loop

    def reset(self) -> None:  # noqa: B027
        """Forget the past, before motion starts."""

    def applied(self, tensions: Array, active: float) -> None:  # noqa: B027
        """The tension references (n,) of a tick, ``active`` s into ACTIVE, negative outside it."""

    def linear_laws(self) -> tuple[LinearLaw, ...]:
        """The feedback at the ends of the controller's range, for its margins: every class that
        changes the feedback says it anew. Empty: it cannot be said."""
        return ()

    def stated_laws(self) -> tuple[LinearLaw, ...]:
        """`linear_laws`, if they are this class' own. Raises `NoLinearLawError`: a class that
        changes the feedback of the one it comes from has not the margins of that one."""
        for kind in type(self).__mro__:
            if "linear_laws" in vars(kind):
                break
            if any(name in vars(kind) for name in _FEEDBACK):
                raise NoLinearLawError(f"{kind.__name__} does not state its linear_laws")
        laws = self.linear_laws()
        if not laws:
            raise NoLinearLawError(f"{type(self).__name__} does not state its linear_laws")
        return laws

    def _spring(self, stiffness: float, integral: float = 0.0) -> LinearLaw:
        """Of a spring with the damper that goes with it."""
        resistance = damping(self.damping_ratio, stiffness, self._robot.platform.mass)
        return LinearLaw(stiffness, resistance, integral)

    @abstractmethod
    def stiffness(self, motion: Motion) -> float:
        """The stiffness (N/m) this controller would like now."""

    def force(self, motion: Motion, stiffness: float) -> Array:
        """Force (3,) without gravity and inertia, at the stiffness allowed: spring and damper,
        F = K e + D de/dt with D = 2 zeta sqrt(K m)."""
        resistance = damping(self.damping_ratio, stiffness, self._robot.platform.mass)
        return np.asarray(spring(motion.error, motion.error_rate, stiffness, resistance))

    def wrench(self, motion: Motion, stiffness: float) -> Array:
        """Wrench (6,) asked of the cables: the controller's force; inertia, weight and the push fed
        forward; and a rotational spring that keeps the platform level."""
        forces = (self.force(motion, stiffness), self._weight, motion.push)
        return self._levelled(motion, forces, motion.desired_acceleration)

    def _levelled(
        self, motion: Motion, forces: tuple[Array, Array, Array], acceleration: Array = NOTHING
    ) -> Array:
        return np.asarray(
            platform_wrench(
                forces,
                acceleration,
                self._robot.platform.mass,
                (motion.quaternion, motion.angular_velocity, LEVEL),
                self._rotational,
            )
        )

    def descent(self, motion: Motion) -> Array:
        """Wrench (6,) of a stop without all cables, the same for every controller: weight, a damper
        of every motion, and down to the cradle by a soft, bounded spring. Sideways there is none:
        it would have the cables that are left fight for a place they cannot keep."""
        stop, weight = self._control.stop, self._weight[2]
        drag = spring(NOTHING, motion.error_rate, 0.0, stop.damping)
        sink = self._control.stiffness.minimum * float(motion.error[2])
        drag[2] += min(max(sink, -stop.sink * weight), 0.0)
        return self._levelled(motion, (drag, self._weight, NOTHING))

    def tensions(self, motion: Motion, stiffness: float, centre: Array) -> Array | None:  # noqa: ARG002
        """Tensions (n,) round ``centre`` for a controller that commands cables; None for one that
        commands a wrench. They pass the same distribution, which gives them their bounds."""
        return None


def norm(vector: Array) -> float:
    """Euclidean, of a vector (3,)."""
    x, y, z = vector.tolist()
    return math.sqrt(x * x + y * y + z * z)


def share(cutoff_hz: float, period: float) -> float:
    """What a first-order low-pass takes over of its input in one tick."""
    return 1.0 - math.exp(-2.0 * math.pi * cutoff_hz * period)
