"""The workspace's maps: every pose of a grid, and for each what the cables have in reserve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tonus.config import Config
from tonus.tools.check.feasibility import Poses, against, closures, reserves, workspace_poses
from tonus.tools.workspace.stiffness import stiffness

Array = NDArray[np.float64]
DIRECTIONS = np.vstack([np.eye(3), -np.eye(3)])
CHUNK = 500
"""Poses between two words of progress."""
Step = Callable[[int], None]


@dataclass(frozen=True)
class Map:
    """One figure at every pose, not a number where it has no meaning; from ``low`` on it counts as
    feasible, where it is a question of that."""

    title: str
    unit: str
    values: Array
    low: float | None = None

    @property
    def share(self) -> float | None:
        """of the poses that are feasible"""
        if self.low is None:
            return None
        return float(np.mean(self.values >= self.low))

    @property
    def worst(self) -> int | None:
        """Index of the pose with the least value."""
        return None if np.isnan(self.values).all() else int(np.nanargmin(self.values))


@dataclass(frozen=True)
class Maps:
    """All maps over the same poses."""

    at: Poses
    missing: int | None
    maps: dict[str, Map] = field(default_factory=dict)

    def summary(self) -> dict[str, dict[str, float | str | None]]:
        """What a script wants to know, by map."""
        return {name: self._summary_of(one) for name, one in self.maps.items()}

    def _summary_of(self, one: Map) -> dict[str, float | str | None]:
        summary: dict[str, float | str | None] = {"unit": one.unit, "share": one.share}
        if one.worst is not None:
            summary["least"] = float(np.nanmin(one.values))
            summary["median"] = float(np.nanmedian(one.values))
            summary["largest"] = float(np.nanmax(one.values))
            summary["least_at"] = self.at.describe(one.worst)
        return summary


def grid(config: Config, points: int, *, tilt: bool) -> Poses:
    """``points`` cubed positions over the box, with ``tilt`` also turned both ways about each
    axis."""
    box = config.robot.workspace
    if not tilt:
        box = box.model_copy(update={"tilt_deg": 0.0})
    return workspace_poses(config.robot.geometry, box, points)


def compute(
    config: Config,
    at: Poses,
    force: float,
    *,
    missing: int | None = None,
    step: Step = lambda _: None,
) -> Maps:
    """Maps at the poses ``at``: wrench feasibility under gravity and with ``force`` (N) besides,
    either way on an axis, wrench closure, and stiffnesses.

    With a cable ``missing`` the others may hang as loose as the controller then lets them.
    """
    robot, bounds = config.robot, config.control.tension
    if missing is not None:
        bounds = bounds.model_copy(update={"min": bounds.slack})
    weight, length = robot.platform.mass * robot.gravity, robot.geometry.moment_length
    loads = (against(weight, np.zeros((1, 3))), against(weight, force * DIRECTIONS))
    parts: list[tuple[Array, ...]] = []
    for first in range(0, len(at.positions), CHUNK):
        some = slice(first, first + CHUNK)
        part = Poses(
            at.positions[some],
            at.rotations[some],
            at.lengths[some],
            at.matrices[some],
            at.arms[some],
        )
        if missing is not None:
            part = part.without(missing)
        left = [reserves(part, load, bounds, length).min(axis=1) for load in loads]
        stiff = stiffness(part, robot, bounds.pre, missing)
        # A platform that the cables cannot carry has no stiffness.
        held = (
            np.where(left[0] >= 0.0, values, np.nan)
            for values in (stiff.translational, stiff.rotational, stiff.geometric)
        )
        parts.append((*left, closures(part, length), *held))
        step(len(part.positions))
    gravity, loaded, closed, sideways, turning, geometric = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    return Maps(
        at,
        missing,
        {
            "gravity": Map("reserve of tension, weight alone", "N", gravity, 0.0),
            "force": Map(f"reserve of tension, weight and {force:g} N", "N", loaded, 0.0),
            "closure": Map("wrench closure, least over largest tension", "", closed, 1e-9),
            "translational": Map("stiffness, lengths held", "N/m", sideways),
            "rotational": Map("rotational stiffness, lengths held", "N m/rad", turning),
            "geometric": Map("stiffness, tensions held", "N/m", geometric),
        },
    )


__all__ = ["Map", "Maps", "compute", "grid"]
