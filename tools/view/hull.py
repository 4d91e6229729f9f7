"""The convex hull of a few points, such as a platform's anchors. scipy has one, but takes longer to
load than the whole picture takes to be made."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from tonus.tools.view.moment import Array

_SAME = 1e-7
"""of the points' extent: nearer than this to a plane is in it"""


def hull(points: Array) -> NDArray[np.uint32]:
    """Triangles (m, 3) of a hull of points (n, 3), their corners counter-clockwise seen from
    outside; (0, 3) where all points lie in a plane. Tries every plane through three points, so n is
    to be small."""
    extent = float(np.ptp(points, axis=0).max())
    same = _SAME * extent
    corners = np.array(list(combinations(range(len(points)), 3)))
    first = points[corners[:, 0]]
    normals = np.cross(points[corners[:, 1]] - first, points[corners[:, 2]] - first)
    lengths = np.linalg.norm(normals, axis=1)
    proper = lengths > same * extent
    normals = normals[proper] / lengths[proper, None]
    # How far each point lies before each plane, (planes, n).
    away = normals @ points.T - np.sum(normals * first[proper], axis=1)[:, None]
    before, behind = (away > same).any(axis=1), (away < -same).any(axis=1)
    faces: dict[bytes, list[tuple[int, int, int]]] = {}
    for number in np.flatnonzero(before != behind):
        within = np.abs(away[number]) <= same
        outwards = normals[number] if behind[number] else -normals[number]
        if within.tobytes() not in faces:
            ring = _ring(points, np.flatnonzero(within), outwards, extent)
            fan = pairwise(ring[1:])
            faces[within.tobytes()] = [(ring[0], second, third) for second, third in fan]
    found = [triangle for face in faces.values() for triangle in face]
    return np.array(found, np.uint32).reshape(-1, 3)


def _ring(points: Array, numbers: NDArray[np.intp], normal: Array, extent: float) -> list[int]:
    """Of points in one plane the corners of their hull, counter-clockwise about ``normal``: the
    lower and the upper chain of the points in order (Andrew, 1979)."""
    across = points[numbers] - points[numbers[0]]
    along = across[np.argmax(np.linalg.norm(across, axis=1))]
    x = across @ (along / np.linalg.norm(along))
    y = across @ np.cross(normal, along / np.linalg.norm(along))
    order = np.lexsort((y, np.round(x / (_SAME * extent))))
    least = _SAME * extent**2
    ring: list[int] = []
    for way in (order, order[::-1]):
        chain: list[int] = []
        for point in way:
            while len(chain) > 1 and _turn(x, y, (*chain[-2:], point)) <= least:
                chain.pop()
            chain.append(int(point))
        ring += chain[:-1]
    return [int(numbers[point]) for point in ring]


def _turn(x: Array, y: Array, corners: tuple[int, ...]) -> float:
    """Twice the area of a triangle, positive where it turns to the left."""
    a, b, c = corners
    return float((x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a]))
