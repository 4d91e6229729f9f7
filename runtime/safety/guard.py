"""Bounds of each drum during a stop, from its own encoder alone.

The *passive* stop uses only the drum's own rate v (m/s, reeling in positive):

    F = T_0 - d v,  |F| <= F_max

where d is larger for the part of v beyond ``passive_speed``, and smaller for a drum that reels in
(``passive_damping_in``), so that a slack cable keeps up with a platform that sinks. With the
storage function V = kinetic + strain + weight - T_0 (sum of reeled-in lengths), which has a lower
bound since no cable can be shorter than nothing, V' = -d sum v^2 - friction <= 0 for any subset of
cables, torn, slipped or wrong: no cable's torque depends on another's measurement. The rate is a
period and a half old; d must stay below m_drum / (3 periods) for the sampled loop to remove energy
(`tests/property/test_any_passive_stop.py` verifies both).

A *descent* plans forces, and the guard bounds the effect of a wrong plan: reeling in faster than
``reel_in`` and reeling out faster than ``reel_out`` is braked, and a drum adds no more energy
beyond T_0 than its tank holds; only absorbed energy fills the tank.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.robot import Robot
from tonus.config.schema.safety import Stop

Array = NDArray[np.float64]


@njit(cache=True)
def _passive(
    rate: Array,
    chosen: NDArray[np.bool_],
    share: Array,
    radius: Array,
    law: tuple[float, float, float, float],
    brake: tuple[float, float, float],
    torque: Array,
) -> None:
    """``radius`` (n,) of the drums; ``law``: T_0, d in and out, F_max; ``brake``: speed, and
    what the damping in and out grows by beyond it; ``share`` (n,): of T_0, 0 to 1."""
    tension, inward, outward, largest = law
    fastest, harder_in, harder_out = brake
    for i in range(rate.shape[0]):
        if not chosen[i]:
            continue
        torque[i] = 0.0
        speed = radius[i] * rate[i]
        reeled_in, reeled_out = max(speed, 0.0), min(speed, 0.0)
        force = share[i] * tension - inward * reeled_in - outward * reeled_out
        force -= harder_in * max(reeled_in - fastest, 0.0)
        force -= harder_out * min(reeled_out + fastest, 0.0)
        if math.isfinite(force):
            torque[i] = radius[i] * min(max(force, -largest), largest)


@njit(cache=True)
def _taken_up(
    rate: Array,
    following: Array,
    slack: NDArray[np.bool_],
    radius: Array,
    law: tuple[float, float, float],
    torque: Array,
) -> None:
    """``radius`` (n,) m; ``law``: closing speed (m/s), damping (N s/m), largest speed (m/s)."""
    closing, damping, fastest = law
    for i in range(rate.shape[0]):
        if not slack[i]:
            continue
        ahead = min(max(radius[i] * following[i], -fastest), fastest)
        force = damping * (ahead + closing - radius[i] * rate[i])
        torque[i] = radius[i] * force if math.isfinite(force) else 0.0


@njit(cache=True)
def _bounded(
    rate: Array,
    usable: NDArray[np.bool_],
    radius: Array,
    speeds: tuple[float, float, float],
    passive: float,
    largest: Array,
    period: float,
    capacity: float,
    tank: Array,
    torque: Array,
) -> None:
    """Brake and tank on planned torques. ``speeds``: reel in, reel out (m/s), damping beyond;
    ``passive``: T_0; ``radius`` (m) and ``largest`` torque (N m) of each drum (n,)."""
    inward, outward, damping = speeds
    for i in range(rate.shape[0]):
        if not usable[i]:
            continue
        speed, force = radius[i] * rate[i], torque[i] / radius[i]
        if not math.isfinite(speed):
            torque[i] = 0.0
            continue
        force = min(force, passive + damping * (inward - speed))
        force = max(force, -damping * (speed + outward))
        drawn = period * speed * (force - passive)
        if drawn > tank[i] and speed > 0.0:
            force = passive + tank[i] / (period * speed)
            drawn = tank[i]
        tank[i] = min(max(tank[i] - drawn, 0.0), capacity)
        torque[i] = min(max(radius[i] * force, -largest[i]), largest[i])


class Guard:
    """The bounds of every drum in one tick. Torques in N m at the drum, rates in rad/s."""

    def __init__(self, robot: Robot, settings: Stop, period: float) -> None:
        s = settings
        self._radius = robot.drum_radius
        damping = (s.passive_damping_in or s.passive_damping, s.passive_damping)
        self._law = (s.passive_tension, *damping, s.passive_force)
        harder = [max(s.reel_damping - each, 0.0) for each in damping]
        self._brake = (s.passive_speed, harder[0], harder[1])
        self._speeds = (s.reel_in, s.reel_out, s.reel_damping)
        self._slack = (s.take_up_speed, s.take_up_damping, s.reel_in)
        self._period, self._capacity = period, s.tank
        self._largest = robot.torque_limit
        self.tank = np.full(robot.cables, s.tank)
        """J (n,)"""
        self._torque, self._share = np.zeros(robot.cables), np.zeros(robot.cables)

    def reset(self) -> None:
        self.tank[:] = self._capacity

    def passive(self, rate: Array, trusted: NDArray[np.bool_], share: float | Array = 1.0) -> Array:
        """Torques (n,) of the passive stop; none where a drum's rate is not ``trusted`` (n,);
        ``share`` of the passive tension, of all or of each (n,)."""
        self._torque[:] = 0.0
        self._share[:] = share
        law = (self._law, self._brake)
        _passive(rate, trusted, self._share, self._radius, *law, self._torque)
        return self._torque

    def take_up(
        self, torque: Array, rate: Array, following: Array, slack: NDArray[np.bool_]
    ) -> None:
        """Planned torques (n,) of cables that are ``slack`` (n,) become, in place, those that keep
        the drum at the rate ``following`` the platform (n,) rad/s, a little faster: a cable
        whose drum lags snaps taut later."""
        _taken_up(rate, following, slack, self._radius, self._slack, torque)

    def bound(self, torque: Array, rate: Array, usable: NDArray[np.bool_]) -> None:
        """Planned torques (n,) of ``usable`` cables (n,) within a descent's bounds, in place."""
        _bounded(
            rate,
            usable,
            self._radius,
            self._speeds,
            self._law[0],
            self._largest,
            self._period,
            self._capacity,
            self.tank,
            torque,
        )
