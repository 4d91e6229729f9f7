"""Which stops are solved, and which follow from them by the robot's mirror planes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tests.bench.least_stop.hold import POSITIONS
from tonus.config.schema.robot import Geometry

Array = NDArray[np.float64]
Point = tuple[float, float, float]
MOTIONS = {"rest": 0.0, "towards": 1.0, "away": -1.0}
"""of the platform at the break, as a share of the speed limit, along the way from the platform's
origin to the torn cable's frame anchor"""
_SOLVED = (0, 4)
"""torn cables that are solved for: an upper and a lower one"""


@dataclass(frozen=True)
class Tear:
    cable: int
    position: Point
    motion: str

    @property
    def name(self) -> str:
        return f"{self.cable}_{POSITIONS.index(self.position)}_{self.motion}"

    def velocity(self, geometry: Geometry, speed: float) -> Array:
        """m/s (3,)."""
        way = np.array(geometry.frame[self.cable]) - self.position
        return np.asarray(MOTIONS[self.motion] * speed * way / np.linalg.norm(way))


def solved() -> Iterator[Tear]:
    """Every stop that is computed: at rest first; moving, the centre and the corners first."""
    for cable, position in product(_SOLVED, sorted(POSITIONS, key=_distance)):
        yield Tear(cable, position, "rest")
    moving = sorted(POSITIONS, key=lambda place: (0 < _sides(place) < 3, _distance(place)))
    for position, motion, cable in product(moving, ("towards", "away"), _SOLVED):
        yield Tear(cable, position, motion)


def _distance(position: Point) -> float:
    return float(np.linalg.norm(position))


def _sides(position: Point) -> int:
    return sum(value != 0.0 for value in position)


def solved_as(tear: Tear, geometry: Geometry) -> Tear:
    """The computed stop that this one is the mirror image of, in the planes x = 0 and y = 0."""
    frame, platform = np.array(geometry.frame), np.array(geometry.platform)
    for signs in product((1.0, -1.0), repeat=2):
        mirror = np.array([*signs, 1.0])
        image = [_at(frame * mirror, anchor) for anchor in frame]
        if not np.allclose((platform * mirror)[image], platform):
            raise ValueError("the platform's anchors are not symmetric; solve every cable")
        cable = image.index(tear.cable)
        if cable in _SOLVED:
            x, y, z = (float(value) + 0.0 for value in mirror * tear.position)
            return Tear(cable, (x, y, z), tear.motion)
    raise ValueError(f"cable {tear.cable} is no mirror image of a solved one")


def _at(points: Array, point: Array) -> int:
    distance = np.linalg.norm(points - point, axis=1)
    if distance.min() > 1e-9:
        raise ValueError("the frame's anchors are not symmetric; solve every cable")
    return int(distance.argmin())
