"""Which wrenches the cables can balance, and where, with every tension inside its bounds.

The tensions that balance a wrench w are T = T_p + N lambda with W T_p = w and N (n, r) the null
space of the structure matrix W, r = n - 6. Each bound makes a strip in the space of lambda, and
convex sets in r dimensions have a common point as soon as every r + 1 of them have one (Helly).
These do if c . T_p lies between the least and the largest value of c . T over the bounds, where c
is the combination in which lambda cancels: the minors of their rows of N, with alternating signs.
For eight cables that is 56 linear inequalities a pose, exact, and the same as the facets of the
available wrench set (Bouchard, Gosselin and Moore 2010), without a solver. With |c| in the 1-norm,
what is left of the tightest inequality is the distance that all tensions together can keep from
their bounds.

With T_p = 0 the same inequalities tell how even a self-stress can be: its least tension over its
largest is at most the smaller of c's positive and negative parts over the larger. Zero is the end
of wrench closure. Six cables have no lambda and no self-stress: each tension is what it is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tonus.config.schema.robot import Geometry, Tension, Workspace
from tonus.runtime.control.compiled import geometry, rotate

Array = NDArray[np.float64]
GRID = 7
"""Points per edge of the box; with the turns a few thousand poses in a fraction of a second."""
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
FREEDOMS = 6
TOLERANCE = 1e-9
"""Relative to the largest: below it a singular value or a combination counts as zero."""


@dataclass(frozen=True)
class Poses:
    """Poses with what the cables look like there."""

    positions: Array
    """m, (n, 3)"""
    rotations: Array
    """rad, rotation vectors in the base frame, (n, 3)"""
    lengths: Array
    """m, (n, cables)"""
    matrices: Array
    """structure matrices, (n, 6, cables)"""
    arms: Array
    """m, platform anchors from the platform's origin, base frame, (n, cables, 3)"""

    def describe(self, index: int) -> str:
        x, y, z = self.positions[index]
        text = f"({x:+.3f}, {y:+.3f}, {z:+.3f}) m"
        tilt = np.degrees(self.rotations[index])
        if np.any(tilt):
            axis = int(np.abs(tilt).argmax())
            text += f" turned {tilt[axis]:+.0f} deg about {'xyz'[axis]}"
        return text

    def without(self, cable: int) -> Poses:
        """The same poses with a cable gone."""
        return Poses(
            self.positions,
            self.rotations,
            np.delete(self.lengths, cable, axis=1),
            np.delete(self.matrices, cable, axis=2),
            np.delete(self.arms, cable, axis=1),
        )


@dataclass(frozen=True)
class Feasibility:
    """The outcome over a set of poses, each asked for every one of some wrenches."""

    share: float
    """of the poses at which all wrenches can be balanced"""
    worst: int
    """index of the pose with the least reserve"""
    wrench: Array
    """(6,) N and N m: what the cables have to exert there, of the wrenches that with it"""
    reserve: float
    """N that all tensions can keep from their bounds there; negative if they cannot be kept"""


def poses(robot_geometry: Geometry, positions: Array, rotations: Array) -> Poses:
    """The geometry at ``positions`` (n, 3) with rotation vectors (n, 3)."""
    frame = np.array(robot_geometry.frame)
    platform = np.array(robot_geometry.platform)
    count, cables = len(positions), len(frame)
    lengths, matrices = np.zeros((count, cables)), np.zeros((count, 6, cables))
    for index in range(count):
        quaternion = rotate(UPRIGHT, rotations[index])
        geometry(positions[index], quaternion, frame, platform, lengths[index], matrices[index])
    turned = Rotation.from_rotvec(np.repeat(rotations, cables, axis=0))
    arms = turned.apply(np.tile(platform, (count, 1))).reshape(count, cables, 3)
    return Poses(positions, rotations, lengths, matrices, arms)


def cable_lengths(at: Poses) -> tuple[float, float, float]:
    """m: the shortest, the mean and the longest cable of any of the poses."""
    return float(at.lengths.min()), float(at.lengths.mean()), float(at.lengths.max())


def workspace_poses(robot_geometry: Geometry, box: Workspace, points: int = GRID) -> Poses:
    """A grid of ``points`` cubed over the box: upright, then turned both ways about each axis."""
    axes = [np.linspace(low, high, points) for low, high in (box.x, box.y, box.z)]
    grid = np.array(list(product(*axes)))
    turns = np.zeros((1, 3))
    if box.tilt_deg > 0.0:
        tilt = np.radians(box.tilt_deg)
        turns = np.vstack([turns, tilt * np.eye(3), -tilt * np.eye(3)])
    rotations = np.repeat(turns, len(grid), axis=0)
    return poses(robot_geometry, np.tile(grid, (len(turns), 1)), rotations)


def reserves(at: Poses, wrenches: Array, tension: Tension, moment_length: float) -> Array:
    """The distance (N) that all tensions can keep from their bounds, (n poses, k wrenches).

    ``wrenches`` (k, 6) or (n, k, 6), N and N m about the platform's origin, are what the cables
    shall exert: W T. Negative where they cannot; minus infinity where W has not rank six.
    """
    if at.matrices.shape[2] < FREEDOMS:
        return np.full((len(at.matrices), wrenches.shape[-2]), -np.inf)
    scale = np.array([1.0, 1.0, 1.0, *(1.0 / moment_length,) * 3])
    left, size, right = np.linalg.svd(at.matrices * scale[:, None])
    full = size[:, -1] > TOLERANCE * size[:, 0]
    size = np.where(full[:, None], size, 1.0)
    wanted = np.broadcast_to(wrenches * scale, (len(size), *wrenches.shape[-2:]))
    # T_p = V S^-1 U^T w, for all poses and wrenches at once: (n, k, cables).
    particular = (wanted @ left / size[:, None, :]) @ right[:, : size.shape[1], :]
    worst = np.full(particular.shape[:2], np.inf)
    for chosen, combination, used in _combinations(right[:, FREEDOMS:, :]):
        value = np.einsum("nkt,nt->nk", particular[:, :, chosen], combination)
        positive = np.maximum(combination, 0.0).sum(axis=1)
        negative = 1.0 - positive
        highest = positive * tension.max - negative * tension.min
        lowest = positive * tension.min - negative * tension.max
        left_over = np.minimum(highest[:, None] - value, value - lowest[:, None])
        worst = np.where(used[:, None], np.minimum(worst, left_over), worst)
    return np.where(full[:, None], worst, -np.inf)


def _combinations(null: Array) -> Iterator[tuple[list[int], Array, NDArray[np.bool_]]]:
    """Of each r + 1 cables, with the null space ``null`` (n, r, cables), the combination (n, r + 1)
    of 1-norm 1 in which the null space cancels, and where there is one."""
    redundancy, cables = null.shape[1:]
    minors = _minors(null)
    for few in combinations(range(cables), redundancy + 1):
        parts = [minors[few[:left] + few[left + 1 :]] * (-1.0) ** left for left in range(len(few))]
        combination = np.stack(parts, axis=1)
        weight = np.abs(combination).sum(axis=1)
        used = weight > TOLERANCE
        yield list(few), combination / np.where(used, weight, 1.0)[:, None], used


def _minors(null: Array) -> dict[tuple[int, ...], Array]:
    """Determinants (n,) of each r columns of ``null`` (n, r, cables), expanded row by row."""
    count, rows, cables = null.shape
    minors: dict[tuple[int, ...], Array] = {(): np.ones(count)}
    for row in range(rows):
        larger: dict[tuple[int, ...], Array] = {}
        for chosen in combinations(range(cables), row + 1):
            larger[chosen] = np.zeros(count)
            for left, column in enumerate(chosen):
                rest = minors[chosen[:left] + chosen[left + 1 :]]
                larger[chosen] += (-1.0) ** (row + left) * null[:, row, column] * rest
        minors = larger
    return minors


def closures(at: Poses, moment_length: float) -> Array:
    """Least over largest tension of the evenest self-stress, (n,): above zero the cables can exert
    any wrench at all (wrench closure), were they strong enough."""
    if at.matrices.shape[2] < FREEDOMS:
        return np.zeros(len(at.matrices))
    scale = np.array([1.0, 1.0, 1.0, *(1.0 / moment_length,) * 3])
    _, size, right = np.linalg.svd(at.matrices * scale[:, None])
    ratio = np.ones(len(size))
    for _, combination, used in _combinations(right[:, FREEDOMS:, :]):
        positive = np.maximum(combination, 0.0).sum(axis=1)
        less = np.clip(np.minimum(positive, 1.0 - positive), 0.0, None)
        ratio = np.where(used, np.minimum(ratio, less / (1.0 - less)), ratio)
    return np.where(size[:, -1] > TOLERANCE * size[:, 0], ratio, 0.0)


def feasibility(at: Poses, wrenches: Array, tension: Tension, moment_length: float) -> Feasibility:
    """Whether all of ``wrenches`` can be balanced at each pose, as `reserves` takes them."""
    return judged(reserves(at, wrenches, tension, moment_length), wrenches)


def judged(each: Array, wrenches: Array) -> Feasibility:
    """The outcome of `reserves` (n, k) for ``wrenches`` (k, 6) or (n, k, 6)."""
    reserve = each.min(axis=1)
    worst = int(reserve.argmin())
    asked = np.broadcast_to(wrenches, (*each.shape, 6))[worst, int(each[worst].argmin())]
    return Feasibility(float(np.mean(reserve >= 0.0)), worst, asked, float(reserve[worst]))


def against(weight: float, forces: Array) -> Array:
    """Wrenches (k, 6) that hold a ``weight`` (N) while each of ``forces`` (k, 3) (N) acts at the
    platform's origin."""
    wrenches = np.zeros((len(forces), 6))
    wrenches[:, :3] = -forces
    wrenches[:, 2] += weight
    return wrenches
