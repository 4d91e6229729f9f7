"""How fast the stiffness may rise without feeding energy into what the platform touches.

At stiffness K(t) the loop's error obeys M e'' + D(K) e' + K(t) e = -F. Along it eq. (12) changes by

    V' = 1/2 K' e^2 - D e'^2 - F e'

and eq. (13) leaves the first term out: it cannot be bounded by the second, since e' may be zero
where e is not. Two limits take its place. The *rate bound* keeps the loop stable for any K(t)
(Kronander and Billard, IEEE T-RO 32, 2016): with alpha = min D / max M,

    K' + alpha D'(K) K' <= 2 alpha K.

The *tank* keeps it passive (Ferraguti, Secchi and Fantuzzi, ICRA 2013): what a rise stores in the
spring is paid from what the damper took out before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.control import Passivity, StiffnessLaw
from tonus.config.schema.robot import Robot
from tonus.runtime.control.kinematics import Kinematics

Array = NDArray[np.float64]


def damping(ratio: float, stiffness: float, mass: float) -> float:
    """N s/m: 2 zeta sqrt(K m), the damper beside every controller's spring."""
    return 2.0 * ratio * math.sqrt(stiffness * mass)


def felt_inertia(robot: Robot) -> float:
    """kg: the largest translational inertia a force may meet, at home or in a corner of the box.

    The drums count in full. The tension loop divides theirs by 1 + K_T within its bandwidth only,
    and the bound must not lean on that.
    """
    kinematics, box = Kinematics(robot.geometry), robot.workspace
    drum = robot.drum_mass
    largest = 0.0
    for place in (robot.home, *product(box.x, box.y, box.z)):
        kinematics.evaluate(np.array(place), np.array([1.0, 0.0, 0.0, 0.0]))
        pull = kinematics.matrix[:3]
        largest = max(largest, float(np.linalg.eigvalsh(drum * pull @ pull.T)[-1]))
    return robot.platform.mass + largest


@njit(cache=True)
def _squares(error: Array, last: Array, rate: Array, force: Array) -> tuple[float, ...]:
    """|error - last|^2, |error|^2, |rate|^2 and force . rate, of vectors (3,); ``last`` becomes the
    error."""
    step = stretch = speed = power = 0.0
    for k in range(3):
        step += (error[k] - last[k]) ** 2
        stretch += error[k] ** 2
        speed += rate[k] ** 2
        power += force[k] * rate[k]
        last[k] = error[k]
    return step, stretch, speed, power


class Tank:
    """The energy (J) that a rising stiffness may draw on, never below its minimum."""

    def __init__(self, settings: Passivity) -> None:
        self._settings = settings
        self.level = settings.tank_initial

    def reset(self) -> None:
        self.level = self._settings.tank_initial

    def fill(self, energy: float) -> None:
        """``energy`` (J) that left the loop; the efficiency's share of it is kept, up to the
        capacity. What is no number fills nothing."""
        s = self._settings
        if math.isfinite(energy):
            self.level = min(s.tank_capacity, self.level + s.tank_efficiency * energy)

    def admit(self, stiffness: float, wanted: float, stretch: float) -> float:
        """The part of a rise (N/m) that the tank can pay, at |e|^2 = ``stretch`` (m2)."""
        spare = self.level - self._settings.tank_minimum
        cost = 0.5 * (wanted - stiffness) * stretch
        if not cost <= spare:
            wanted = stiffness + 2.0 * spare / stretch
            cost = spare
        self.level = max(self.level - cost, self._settings.tank_minimum)
        return wanted


@dataclass
class Account:
    """Energy and powers of one tick as the controller sees them: J and W."""

    storage: float = 0.0
    """V of eq. (12), with the platform's mass"""
    stiffening: float = 0.0
    """1/2 K' e^2, which eq. (13) leaves out"""
    dissipated: float = 0.0
    """D e'^2"""
    external: float = 0.0
    """-F e': what the external force puts in"""
    stiffness_rate: float = 0.0
    """N/m/s"""

    @property
    def storage_rate(self) -> float:
        return self.stiffening - self.dissipated + self.external


class Limiter:
    """Cap, bounds, rate bound, tank, in this order: what reaches the platform is never above the
    cap, never outside its bounds, and rises only as passivity allows. Falling is free.

    The output starts at the lower bound and is inside the bounds, whatever comes in.
    """

    def __init__(
        self,
        law: StiffnessLaw,
        passivity: Passivity,
        robot: Robot,
        damping_ratio: float,
        period: float,
    ) -> None:
        self._law, self._period = law, period
        self._ratio, self._mass = damping_ratio, robot.platform.mass
        self.alpha = damping(damping_ratio, law.minimum, self._mass) / felt_inertia(robot)
        """1/s, of the rate bound"""
        self.tank = Tank(passivity)
        self.account = Account()
        self._last = np.zeros(3)
        self.reset()

    def reset(self) -> None:
        self.value = self._law.minimum
        self.tank.reset()
        self._followed = False

    def rise_bound(self, stiffness: float) -> float:
        """N/m/s at a stiffness, with D' = zeta sqrt(m/K) K'; at most the configured rate."""
        spread = self.alpha * self._ratio * math.sqrt(self._mass / stiffness)
        return min(2.0 * self.alpha * stiffness / (1.0 + spread), self._law.rise_rate)

    def __call__(self, wanted: float, cap: float, error: Array, rate: Array, force: Array) -> float:
        """Stiffness (N/m) of this tick, from position error and its rate (3,) and the external
        force (3,), which is only accounted for."""
        law, before = self._law, self.value
        target = min(wanted, cap, law.maximum)
        if not target >= law.minimum:  # also when it is not a number
            target = law.minimum
        resistance = damping(self._ratio, before, self._mass)
        step, stretch, speed, power = _squares(error, self._last, rate, force)
        if self._followed:
            # By Cauchy and Schwarz the damper took at least D |step|^2 / period since last tick.
            self.tank.fill(resistance * step / self._period)
        self._followed = math.isfinite(stretch)
        if not self._followed:
            target = min(target, before)
        if target > before:
            target = min(target, before + self._period * self.rise_bound(before))
            self.value = min(max(self.tank.admit(before, target, stretch), before), law.maximum)
        else:
            self.tank.fill(0.5 * (before - target) * stretch)
            self.value = target
        self._settle(before, resistance, stretch, speed, power)
        return self.value

    def _settle(
        self, before: float, resistance: float, stretch: float, speed: float, power: float
    ) -> None:
        account = self.account
        account.stiffness_rate = (self.value - before) / self._period
        account.storage = 0.5 * (self._mass * speed + self.value * stretch)
        account.stiffening = 0.5 * account.stiffness_rate * stretch
        account.dissipated = resistance * speed
        account.external = -power
