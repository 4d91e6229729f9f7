"""The interface of a controller: its input of one tick, and the base class."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.control import Control, TensionLoop
from tonus.config.schema.robot import Robot
from tonus.runtime.control.controllers.linear import LinearLaw, NoLinearLawError
from tonus.runtime.control.passivity import damping
from tonus.runtime.control.stiffness import Law, LawTerms
from tonus.runtime.control.wrench import impedance_wrench, platform_wrench, spring

Array = NDArray[np.float64]
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
"""The desired orientation where a scenario commands none, w x y z."""
NOTHING = np.zeros(3)
_FEEDBACK = ("stiffness", "force", "wrench", "tensions")
"""methods that make a controller's feedback"""


@dataclass
class Motion:
    """Desired and estimated motion of one tick; vectors (3,) in the base frame, z up.

    Positions in m, velocities in m/s and rad/s, ``desired_acceleration`` in m/s2; ``quaternion``
    (4,), w x y z, turns platform coordinates into base coordinates. ``error`` and ``error_rate``
    (3,) are desired minus estimated position (m) and velocity (m/s).
    """

    desired_position: Array
    desired_velocity: Array
    desired_acceleration: Array
    position: Array
    quaternion: Array
    velocity: Array
    angular_velocity: Array
    external: Array
    """N, estimated external force: neither of the cables nor of gravity"""
    contact: float
    """N, at the contact port"""
    shortfall: Array
    """N, the part of the last tick's force that the cables could not deliver"""
    wound: Array
    """(n,) m, unstretched cable lengths"""
    winding: Array
    """(n,) m/s, rate at which they shorten"""
    push: Array
    """N, desired contact force of the scenario"""
    desired_quaternion: Array = field(default_factory=lambda: LEVEL)
    """(4,) w x y z, desired orientation; level, unless the scenario commands another"""
    desired_angular_velocity: Array = field(default_factory=lambda: NOTHING)
    """rad/s"""

    def __post_init__(self) -> None:
        self.error = self.desired_position - self.position
        self.error_rate = self.desired_velocity - self.velocity


class Controller(ABC):
    """Base class of a controller: in each tick `stiffness`, then `wrench` or `tensions`.

    The envelope and the limiter may reduce the result of `stiffness`; the other methods get the
    reduced value. A subclass has to define `stiffness` (N/m). It may replace `force` (3,) N,
    `wrench` (6,) N and N m, or `tensions` (n,) N; it states `linear_laws` if it changes the
    feedback. The outputs have to be finite: an exception or another shape leads to the fault
    CONTROL_FAILED, a value that is not finite to NOT_FINITE. See docs/control.md.
    """

    follows_platform = True
    """whether the drums are damped against the measured rate of the platform, so that a person may
    push it, or against the desired rate"""

    tone = 1.0
    """share of the pretension that the tensions tend to at rest: baseline co-contraction"""

    def __init__(self, robot: Robot, control: Control, damping_ratio: float | None = None) -> None:
        """``damping_ratio``: the controller's own; None for the one under impedance."""
        self._robot, self._control = robot, control
        self.damping_ratio = damping_ratio or control.impedance.damping_ratio
        self.resting_stiffness = control.stiffness.base
        """N/m, at which cables are not tightened beyond the pretension; for a constant stiffness
        that stiffness, so that it gets no co-contraction that it does not command"""
        self.terms = LawTerms()
        """relative increases of the stiffness by the law; zero without a law"""
        impedance = control.impedance
        self._rotational = (impedance.rotational_stiffness, impedance.rotational_damping)
        # Asked once: the force that a class does not replace needs no call of its own.
        self._own_force = type(self).force is not Controller.force
        self._weight = np.array([0.0, 0.0, robot.platform.mass * robot.gravity])

    @property
    def tunable_law(self) -> Law | None:
        """Whose gains may be changed while the robot runs; None without a stiffness law."""
        return None

    @property
    def tension_loop(self) -> TensionLoop:
        """The inner loop's settings while ACTIVE."""
        return self._control.tension_loop

    def reset(self) -> None:  # noqa: B027
        """Clear all states, before motion starts."""

    def applied(self, tensions: Array, active: float) -> None:  # noqa: B027
        """The tension references (n,) of a tick, ``active`` s into ACTIVE, negative outside it."""

    def linear_laws(self) -> tuple[LinearLaw, ...]:
        """The feedback at the ends of the controller's range, for its margins. A class that
        changes the feedback has to override this. Empty: there is no linear law."""
        return ()

    def stated_laws(self) -> tuple[LinearLaw, ...]:
        """`linear_laws`, if they describe this class. Raises `NoLinearLawError` for a class that
        changes the feedback of its base class and does not override them."""
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
        """The law of a spring with its damper."""
        resistance = damping(self.damping_ratio, stiffness, self._robot.platform.mass)
        return LinearLaw(stiffness, resistance, integral)

    @abstractmethod
    def stiffness(self, motion: Motion) -> float:
        """The stiffness (N/m) for this tick, before envelope and limiter."""

    def force(self, motion: Motion, stiffness: float) -> Array:
        """Force (3,) N without gravity and inertia, at the permitted ``stiffness`` (N/m): spring
        and damper, F = K e + D de/dt with D = 2 zeta sqrt(K m)."""
        resistance = damping(self.damping_ratio, stiffness, self._robot.platform.mass)
        force = np.empty(3)
        spring(motion.error, motion.error_rate, stiffness, resistance, force)
        return force

    def wrench(self, motion: Motion, stiffness: float) -> Array:
        """Wrench (6,) N and N m for the cables, at the permitted ``stiffness`` (N/m): `force`, the
        feed-forward of inertia, weight and desired contact force, and a rotational spring and
        damper that keep the desired orientation."""
        if self._own_force:
            forces = (self.force(motion, stiffness), self._weight, motion.push)
            return self._levelled(motion, forces, motion.desired_acceleration)
        mass, wrench = self._robot.platform.mass, np.empty(6)
        impedance_wrench(
            motion.error,
            motion.error_rate,
            stiffness,
            damping(self.damping_ratio, stiffness, mass),
            self._weight,
            motion.push,
            motion.desired_acceleration,
            mass,
            motion.quaternion,
            motion.angular_velocity,
            motion.desired_angular_velocity,
            motion.desired_quaternion,
            *self._rotational,
            wrench,
        )
        return wrench

    def _levelled(
        self, motion: Motion, forces: tuple[Array, Array, Array], acceleration: Array = NOTHING
    ) -> Array:
        force, weight, push = forces
        wrench = np.empty(6)
        platform_wrench(
            force,
            weight,
            push,
            acceleration,
            self._robot.platform.mass,
            motion.quaternion,
            motion.angular_velocity,
            motion.desired_angular_velocity,
            motion.desired_quaternion,
            *self._rotational,
            wrench,
        )
        return wrench

    def descent(self, motion: Motion) -> Array:
        """Wrench (6,) of a stop without all cables, the same for every controller: weight, a damper
        of every motion, a soft, bounded spring down to the cradle, and one back to level, bounded
        to what turns no faster than `level_speed` against the damper. There is no spring sideways:
        the remaining cables could not hold a position. A load is the descent's own matter."""
        stop, weight = self._control.stop, self._weight[2]
        drag = np.empty(3)
        spring(NOTHING, motion.error_rate, 0.0, stop.damping, drag)
        sink = self._control.stiffness.minimum * float(motion.error[2])
        drag[2] += min(max(sink, -stop.sink * weight), 0.0)
        wrench = self._levelled(motion, (drag, self._weight, NOTHING))
        _, damping = self._rotational
        resisted = damping * (motion.angular_velocity - motion.desired_angular_velocity)
        levelling, most = wrench[3:] + resisted, damping * stop.level_speed
        size = norm(levelling)
        if size > most:
            wrench[3:] = (most / size) * levelling - resisted
        return wrench

    def tensions(self, motion: Motion, stiffness: float, centre: Array) -> Array | None:  # noqa: ARG002
        """Tensions (n,) round ``centre`` for a controller that commands cables; None for one that
        commands a wrench. They pass the same distribution, which gives them their bounds."""
        return None


def rehearse_descent(controller: Controller) -> None:
    """What a ``controller`` is asked in a descent only, as every controller answers it."""
    still = NOTHING
    vectors = (still, still, still, still, LEVEL, still, still, still)
    Controller.descent(controller, Motion(*vectors, 0.0, still, still, still, still))


def norm(vector: Array) -> float:
    """Euclidean, of a vector (3,)."""
    x, y, z = vector.tolist()
    return math.sqrt(x * x + y * y + z * z)


def share(cutoff_hz: float, period: float) -> float:
    """What a first-order low-pass takes over of its input in one tick."""
    return 1.0 - math.exp(-2.0 * math.pi * cutoff_hz * period)
