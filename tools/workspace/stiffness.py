"""Stiffness of the platform on its cables, in the convention dw = -K dx with x the position and a
rotation vector about the platform's origin, base frame.

K = K_E + K_G: K_E = W diag(EA / L0) W', what cables of held length resist with, and the geometric
K_G, linear in the tensions, which is all that is left when the drives hold the tensions instead."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.robot import Robot
from tonus.tools.check.feasibility import Poses

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stiffness:
    """Least stiffnesses over all directions, each (n,)."""

    translational: Array
    """N/m, lengths held"""
    rotational: Array
    """N m/rad, lengths held, the platform free to give way sideways"""
    geometric: Array
    """N/m, tensions held"""


def matrices(at: Poses, tensions: Array, axial_stiffness: Array) -> tuple[Array, Array]:
    """K_E and K_G (n, 6, 6) under ``tensions`` (n, cables), of cables of ``axial_stiffness``
    (cables,).

    K_G = sum of T/l [P, -P R; R P, -R P R] + T [0, 0; 0, -U R] over the cables, with
    P = 1 - u u', R = [r]x and U = [u]x.
    """
    unstretched = at.lengths / (1.0 + tensions / axial_stiffness)
    elastic = np.einsum("nac,nc,nbc->nab", at.matrices, axial_stiffness / unstretched, at.matrices)
    units = np.swapaxes(at.matrices[:, :3], 1, 2)
    lateral = np.eye(3) - units[..., :, None] * units[..., None, :]
    arm, along = _cross(at.arms), _cross(units)
    tension = tensions[..., None, None]
    pull = tension / at.lengths[..., None, None]
    geometric = np.zeros_like(elastic)
    geometric[:, :3, :3] = (pull * lateral).sum(axis=1)
    geometric[:, :3, 3:] = -(pull * (lateral @ arm)).sum(axis=1)
    geometric[:, 3:, :3] = (pull * (arm @ lateral)).sum(axis=1)
    geometric[:, 3:, 3:] = -(pull * (arm @ lateral @ arm) + tension * (along @ arm)).sum(axis=1)
    return elastic, geometric


def _cross(vectors: Array) -> Array:
    """[v]x of each of ``vectors`` (..., 3)."""
    result = np.zeros((*vectors.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[..., j, i], result[..., i, j] = vectors[..., k], -vectors[..., k]
    return result


def balanced(at: Poses, robot: Robot, level: float) -> Array:
    """Tensions (n, cables) nearest to ``level`` that carry the platform's weight."""
    weight = np.zeros(6)
    weight[2] = robot.platform.mass * robot.gravity
    even = np.full(at.lengths.shape, level)
    lacking = weight - np.einsum("nac,nc->na", at.matrices, even)
    return np.asarray(even + np.einsum("nca,na->nc", np.linalg.pinv(at.matrices), lacking))


def stiffness(at: Poses, robot: Robot, level: float, missing: int | None = None) -> Stiffness:
    """At the tensions nearest to ``level`` that carry the platform; the geometric one at ``level``
    in every cable. ``missing``: the cable that ``at`` is without."""
    modulus = robot.axial_stiffness
    if missing is not None:
        modulus = np.delete(modulus, missing)
    elastic, geometric = matrices(at, balanced(at, robot, level), modulus)
    total = elastic + geometric
    total = 0.5 * (total + np.swapaxes(total, 1, 2))
    sideways, coupling = total[:, :3, :3], total[:, :3, 3:]
    turning = total[:, 3:, 3:] - np.swapaxes(coupling, 1, 2) @ np.linalg.solve(sideways, coupling)
    _, even = matrices(at, np.full(at.lengths.shape, level), modulus)
    return Stiffness(_least(sideways), _least(turning), _least(even[:, :3, :3]))


def _least(symmetric: Array) -> Array:
    return np.asarray(np.linalg.eigvalsh(symmetric)[:, 0])
