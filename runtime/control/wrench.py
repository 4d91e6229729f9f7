"""The compiled part of the wrench that a controller asks for: forces of springs, and the rotation
that turns the platform to where it is wanted.

Functions that call each other stand in this one file because numba's cache notices a change in a
function's own file only.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True)
def rotation_between(start: Array, end: Array) -> Array:
    """Rotation vector (3,), base frame, that turns orientation ``start`` into ``end``."""
    a, b, c, d = end
    w, x, y, z = start[0], -start[1], -start[2], -start[3]
    scalar = a * w - b * x - c * y - d * z
    vector = np.array(
        [
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
    )
    if scalar < 0.0:
        scalar, vector = -scalar, -vector
    sine = math.sqrt((vector**2).sum())
    if sine < 1e-9:
        return 2.0 * vector
    return vector * (2.0 * math.atan2(sine, scalar) / sine)


@njit(cache=True)
def spring(error: Array, error_rate: Array, stiffness: float, damping: float, force: Array) -> None:
    """``force`` (3,) of a spring and a damper. Into an array of the caller's: one that compiled
    code makes takes as long to hand out as all the rest."""
    for k in range(3):
        force[k] = stiffness * error[k] + damping * error_rate[k]


@njit(cache=True)
def platform_wrench(
    force: Array,
    weight: Array,
    push: Array,
    acceleration: Array,
    mass: float,
    quaternion: Array,
    turning: Array,
    wanted_turning: Array,
    wanted_quaternion: Array,
    rotational_stiffness: float,
    rotational_damping: float,
    wrench: Array,
) -> None:
    """``wrench`` (6,): the sum of three forces and of inertia; and a rotational spring and damper
    towards the orientation ``wanted_quaternion``. ``quaternion``: the platform's, ``turning`` and
    ``wanted_turning`` (rad/s) its angular velocity and the desired one."""
    turn = rotation_between(quaternion, wanted_quaternion)
    for k in range(3):
        inertia = mass * acceleration[k]
        wrench[k] = force[k] + inertia + (weight[k] + push[k])
        rate = turning[k] - wanted_turning[k]
        wrench[3 + k] = rotational_stiffness * turn[k] - rotational_damping * rate


@njit(cache=True)
def impedance_wrench(
    error: Array,
    error_rate: Array,
    stiffness: float,
    damping: float,
    weight: Array,
    push: Array,
    acceleration: Array,
    mass: float,
    quaternion: Array,
    turning: Array,
    wanted_turning: Array,
    wanted_quaternion: Array,
    rotational_stiffness: float,
    rotational_damping: float,
    wrench: Array,
) -> None:
    """`platform_wrench` with the force of a `spring`."""
    force = np.empty(3)
    spring(error, error_rate, stiffness, damping, force)
    platform_wrench(
        force,
        weight,
        push,
        acceleration,
        mass,
        quaternion,
        turning,
        wanted_turning,
        wanted_quaternion,
        rotational_stiffness,
        rotational_damping,
        wrench,
    )
