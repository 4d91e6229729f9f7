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


@njit(cache=True)
def _fill(level: float, energy: float, efficiency: float, capacity: float) -> float:
    """The tank's ``level`` (J) after ``energy`` (J) has left the loop; the ``efficiency``'s share
    of it is kept, up to the ``capacity``. What is no number fills nothing."""
    if math.isfinite(energy):
        return min(capacity, level + efficiency * energy)
    return level


@njit(cache=True)
def _admit(
    level: float, minimum: float, stiffness: float, wanted: float, stretch: float
) -> tuple[float, float]:
    """The part of a rise (N/m) that the tank can pay, at |e|^2 = ``stretch`` (m2), and its level
    (J) afterwards, never below the ``minimum``."""
    spare = level - minimum
    cost = 0.5 * (wanted - stiffness) * stretch
    if not cost <= spare:
        wanted = stiffness + 2.0 * spare / stretch
        cost = spare
    return wanted, max(level - cost, minimum)


@njit(cache=True)
def _rise_bound(
    stiffness: float, alpha: float, ratio: float, mass: float, rise_rate: float
) -> float:
    """N/m/s at a stiffness, with D' = zeta sqrt(m/K) K'; at most the configured rate."""
    spread = alpha * ratio * math.sqrt(mass / stiffness)
    return min(2.0 * alpha * stiffness / (1.0 + spread), rise_rate)


@njit(cache=True)
def _limit(
    wanted: float,
    cap: float,
    before: float,
    stored: float,
    followed: bool,
    error: Array,
    rate: Array,
    force: Array,
    last: Array,
    resistance: float,
    numbers: Array,
) -> tuple[float, float, bool, float, float, float, float, float]:
    """The stiffness (N/m) after ``before``, the energy ``stored`` in the tank (J), whether the next
    tick is ``followed`` by this one's error, and the account: storage (J), stiffening, dissipated
    and external power (W), and the stiffness's rate (N/m/s). ``numbers``: period (s), mass (kg),
    least and largest stiffness, of the tank efficiency, capacity and minimum; then as `_rise_bound`
    has them."""
    period, mass, minimum, maximum = numbers[0], numbers[1], numbers[2], numbers[3]
    efficiency, capacity, empty = numbers[4], numbers[5], numbers[6]
    target = min(wanted, cap, maximum)
    if not target >= minimum:  # also when it is not a number
        target = minimum
    step, stretch, speed, power = _squares(error, last, rate, force)
    if followed:
        # By Cauchy and Schwarz the damper took at least D |step|^2 / period since last tick.
        stored = _fill(stored, resistance * step / period, efficiency, capacity)
    follows = math.isfinite(stretch)
    if not follows:
        target = min(target, before)
    if target > before:
        bound = _rise_bound(before, numbers[7], numbers[8], numbers[9], numbers[10])
        highest = before + period * bound
        paid, stored = _admit(stored, empty, before, min(target, highest), stretch)
        value = min(max(paid, before), maximum)
    else:
        stored = _fill(stored, 0.5 * (before - target) * stretch, efficiency, capacity)
        value = target
    changed = (value - before) / period
    storage = 0.5 * (mass * speed + value * stretch)
    return (
        value,
        stored,
        follows,
        storage,
        0.5 * changed * stretch,
        resistance * speed,
        -power,
        changed,
    )


class Tank:
    """The energy (J) that a rising stiffness may draw on, never below its minimum."""

    def __init__(self, settings: Passivity) -> None:
        self._settings = settings
        self.level = settings.tank_initial

    def reset(self) -> None:
        self.level = self._settings.tank_initial

    def fill(self, energy: float) -> None:
        """``energy`` (J) that left the loop."""
        s = self._settings
        self.level = _fill(self.level, energy, s.tank_efficiency, s.tank_capacity)

    def admit(self, stiffness: float, wanted: float, stretch: float) -> float:
        """The part of a rise (N/m) that the tank can pay, at |e|^2 = ``stretch`` (m2)."""
        s = self._settings
        paid, self.level = _admit(self.level, s.tank_minimum, stiffness, wanted, stretch)
        return paid


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
        self._law = law
        self._ratio, self._mass = damping_ratio, robot.platform.mass
        self.alpha = damping(damping_ratio, law.minimum, self._mass) / felt_inertia(robot)
        """1/s, of the rate bound"""
        self.tank = Tank(passivity)
        self.account = Account()
        self._last = np.zeros(3)
        self._rising = (self.alpha, damping_ratio, self._mass, law.rise_rate)
        bounds, tank = (law.minimum, law.maximum), passivity
        paid = (tank.tank_efficiency, tank.tank_capacity, tank.tank_minimum)
        self._numbers = np.array([period, self._mass, *bounds, *paid, *self._rising])
        self.reset()

    def reset(self) -> None:
        self.value = self._law.minimum
        self.tank.reset()
        self._followed = False

    def rise_bound(self, stiffness: float) -> float:
        """N/m/s at a stiffness."""
        return float(_rise_bound(stiffness, *self._rising))

    def __call__(self, wanted: float, cap: float, error: Array, rate: Array, force: Array) -> float:
        """Stiffness (N/m) of this tick, from position error and its rate (3,) and the external
        force (3,), which is only accounted for."""
        account, before, tank = self.account, self.value, self.tank
        (
            self.value,
            tank.level,
            self._followed,
            account.storage,
            account.stiffening,
            account.dissipated,
            account.external,
            account.stiffness_rate,
        ) = _limit(
            wanted,
            cap,
            before,
            tank.level,
            self._followed,
            error,
            rate,
            force,
            self._last,
            damping(self._ratio, before, self._mass),
            self._numbers,
        )
        return self.value
