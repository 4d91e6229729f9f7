"""The platform's path in space, desired and gone, of one run or of several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D
from numpy.typing import NDArray

from tonus.runtime.states import State
from tonus.tools.report import style
from tonus.tools.report.pieces import Array, Piece
from tonus.tools.report.story import Story
from tonus.tools.run.summary import truth_at_cycles

_POINTS = 4000
"""of a path"""
_MARGIN = 1.08
"""times the largest extent, for the box"""
_LEAST_MM = 1.0
"""half an edge of the box round a robot that stood still"""
_MM = 1e3


@dataclass
class Path:
    """Positions in ACTIVE, in mm in the base frame, thinned to `_POINTS`."""

    step: int
    seen: int = 0
    truth: bool = False
    parts: list[tuple[Array, Array]] = field(default_factory=list)

    @classmethod
    def of(cls, story: Story) -> Path:
        """Read from all pieces of a run."""
        found = cls(max(1, int(story.in_state(State.ACTIVE).sum()) // _POINTS))
        for piece in story.pieces():
            found.add(piece)
        return found

    def add(self, piece: Piece) -> None:
        active = np.flatnonzero(piece.in_state(State.ACTIVE))
        chosen = active[-self.seen % self.step :: self.step]
        self.seen += len(active)
        pose, true = piece.log["/tonus/pose"], truth_at_cycles(piece.log, "position")
        self.truth |= true is not None
        gone = np.asarray(pose["position"]) if true is None else true
        desired = np.asarray(pose["desired_position"])
        self.parts.append((gone[chosen] * _MM, desired[chosen] * _MM))

    def points(self) -> tuple[Array, Array]:
        """Gone and desired, each (n, 3)."""
        gone, desired = (np.concatenate(each) for each in zip(*self.parts, strict=True))
        return gone, desired


def draw(paths: Sequence[tuple[str, str, Path]]) -> Figure | None:
    """Paths with name and colour; None if no robot was ever ACTIVE. One unit is as long on each
    axis."""
    drawn = [(name, colour, path) for name, colour, path in paths if path.seen]
    if not drawn:
        return None
    figure = Figure(figsize=(9.8, 6.6))
    panel = figure.add_subplot(projection="3d")
    figure.subplots_adjust(left=0.0, right=0.70, bottom=0.05, top=0.98)
    extent: list[NDArray[np.float64]] = []
    for name, colour, path in drawn:
        gone, desired = path.points()
        source = "true" if path.truth else "estimated"
        prefix = f"{name}, " if name else ""
        panel.plot(*gone.T, color=colour, linewidth=1.3, label=f"{prefix}{source}")
        panel.plot(
            *desired.T,
            color=style.BLACK if len(drawn) == 1 else colour,
            linewidth=0.9,
            linestyle="--",
            label=f"{prefix}desired",
        )
        panel.plot(*gone[:1].T, "o", color=colour, markersize=5, label=f"{prefix}at START")
        extent += [gone, desired]
    for name, _, path in paths:
        if not path.seen:
            panel.plot([], [], [], linestyle="none", label=f"{name}: never ACTIVE")
    _cube(panel, np.concatenate(extent))
    panel.set_xlabel("x / mm", labelpad=8)
    panel.set_ylabel("y / mm", labelpad=8)
    panel.set_zlabel("z / mm", labelpad=6)
    panel.view_init(elev=22, azim=-58)
    panel.legend(loc="upper left", bbox_to_anchor=(1.02, 0.9), frameon=False)
    return figure


def _cube(panel: Axes3D, points: Array) -> None:
    """Limits of equal length round all points (n, 3)."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = max(0.5 * _MARGIN * float((high - low).max()), _LEAST_MM)
    middle = 0.5 * (low + high)
    panel.set_xlim(middle[0] - half, middle[0] + half)
    panel.set_ylim(middle[1] - half, middle[1] + half)
    panel.set_zlim(middle[2] - half, middle[2] + half)
    panel.set_box_aspect((1.0, 1.0, 1.0))
