"""The compiled part of pose and motion: geometry, rotations, and the estimator's tick.

Functions that call each other stand in this one file because numba's cache notices a change in a
function's own file only. In plain numpy the geometry alone, which a tick needs three times, takes
some forty times as long (`make bench`).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True)
def geometry(
    position: Array, quaternion: Array, frame: Array, platform: Array, lengths: Array, matrix: Array
) -> None:
    """Fill ``lengths`` (8,) and the structure matrix (6, 8) for a pose (quaternion w x y z)."""
    w, x, y, z = quaternion
    rotation = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    for i in range(frame.shape[0]):
        b0, b1, b2 = platform[i, 0], platform[i, 1], platform[i, 2]
        r0 = rotation[0][0] * b0 + rotation[0][1] * b1 + rotation[0][2] * b2
        r1 = rotation[1][0] * b0 + rotation[1][1] * b1 + rotation[1][2] * b2
        r2 = rotation[2][0] * b0 + rotation[2][1] * b1 + rotation[2][2] * b2
        u0 = frame[i, 0] - position[0] - r0
        u1 = frame[i, 1] - position[1] - r1
        u2 = frame[i, 2] - position[2] - r2
        length = math.sqrt(u0 * u0 + u1 * u1 + u2 * u2)
        lengths[i] = length
        u0, u1, u2 = u0 / length, u1 / length, u2 / length
        matrix[0, i], matrix[1, i], matrix[2, i] = u0, u1, u2
        matrix[3, i] = r1 * u2 - r2 * u1
        matrix[4, i] = r2 * u0 - r0 * u2
        matrix[5, i] = r0 * u1 - r1 * u0


@njit(cache=True)
def rotate(quaternion: Array, rotation: Array) -> Array:
    """Turn an orientation by a rotation vector given in the base frame; unit length is kept."""
    angle = math.sqrt(rotation[0] ** 2 + rotation[1] ** 2 + rotation[2] ** 2)
    half = 0.5 * angle
    scale = 0.5 - angle * angle / 48.0 if angle < 1e-4 else math.sin(half) / angle
    a, b, c, d = math.cos(half), rotation[0] * scale, rotation[1] * scale, rotation[2] * scale
    w, x, y, z = quaternion
    turned = np.array(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
    )
    return turned / math.sqrt((turned**2).sum())


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
def correction(lengths: Array, matrix: Array, measured: Array) -> Array:
    """One Gauss-Newton step (6,) from a pose with these lengths and structure matrix towards the
    pose whose lengths are ``measured``: least squares over the eight cables."""
    step = np.full(6, np.nan)
    normal = matrix @ matrix.T
    right = matrix @ (lengths - measured)
    if np.isfinite(normal).all() and np.isfinite(right).all():
        # Regular at every pose; the ridge, far below the last bit, only keeps a lost estimate from
        # raising out of the tick.
        step[:] = np.linalg.solve(normal + 1e-12 * np.eye(6), right)
    return step


@njit(cache=True)
def _predict(state: Array, period: float, acceleration: Array) -> None:
    """Motion of three axes (3, 3), rows position, velocity, external acceleration, over a period,
    under a known acceleration (3,) besides."""
    for axis in range(3):
        total = acceleration[axis] + state[2, axis]
        state[0, axis] += period * (state[1, axis] + 0.5 * period * total)
        state[1, axis] += period * total


@njit(cache=True)
def _correct(state: Array, gain: Array, innovation: Array) -> None:
    for row in range(3):
        for axis in range(3):
            state[row, axis] += gain[row] * innovation[axis]


@njit(cache=True)
def _fold(rotation: Array, quaternion: Array) -> None:
    """Move the rotation error into the quaternion."""
    quaternion[:] = rotate(quaternion, rotation[0])
    rotation[0] = 0.0


@njit(cache=True)
def motion_tick(
    translation: Array,
    rotation: Array,
    quaternion: Array,
    gains: tuple[Array, Array],
    body: tuple[float, Array, float],
    period: float,
    anchors: tuple[Array, Array],
    measured: tuple[Array, Array, NDArray[np.bool_]],
    lengths: Array,
    matrix: Array,
    cable_position: Array,
) -> float:
    """Predict and correct both motion filters with one tick of cables.

    ``body``: mass, principal inertia (3,), gravity. ``measured``: cable lengths, tensions, and
    which cables may be believed. ``matrix`` comes in as of the last estimate. Writes the states,
    ``quaternion`` and ``cable_position``; returns the RMS disagreement of the lengths (m).
    """
    mass, inertia, gravity = body
    wanted, tensions, usable = measured
    wrench = matrix @ tensions
    linear = wrench[:3] / mass
    linear[2] -= gravity
    _predict(translation, period, linear)
    _predict(rotation, period, wrench[3:] / inertia)
    _fold(rotation, quaternion)
    geometry(translation[0], quaternion, anchors[0], anchors[1], lengths, matrix)
    target = np.where(usable, wanted, lengths)
    step = correction(lengths, matrix, target)
    total = 0.0
    for i in range(lengths.shape[0]):
        remaining = lengths[i] - target[i]
        for row in range(6):
            remaining -= step[row] * matrix[row, i]
        total += remaining * remaining
    cable_position[:] = translation[0] + step[:3]
    _correct(translation, gains[0], step[:3])
    _correct(rotation, gains[1], step[3:])
    _fold(rotation, quaternion)
    return math.sqrt(total / lengths.shape[0])


@njit(cache=True)
def carry_forward(
    translation: Array,
    rotation: Array,
    quaternion: Array,
    biases: tuple[Array, Array],
    body: tuple[float, Array, float],
    period: float,
    anchors: tuple[Array, Array],
    lengths: Array,
    matrix: Array,
    estimate: tuple[Array, Array, Array, Array, Array],
) -> None:
    """The estimate one period on, the biases taken out; geometry is left standing there."""
    mass, inertia, _ = body
    position, oriented, velocity, turning, external = estimate
    position[:] = translation[0] + period * translation[1] - biases[0]
    oriented[:] = rotate(quaternion, period * rotation[1] - biases[1])
    velocity[:] = translation[1]
    turning[:] = rotation[1]
    external[:3] = mass * translation[2]
    external[3:] = inertia * rotation[2]
    geometry(position, oriented, anchors[0], anchors[1], lengths, matrix)
