"""One panel of a picture while it is filled, piece after piece of a run; drawn when it is full."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from tonus.tools.report import style
from tonus.tools.report.pieces import Array, Piece
from tonus.tools.report.thin import thin

FINE = 4
"""times the stretches of a static picture: for one that is zoomed into"""


@dataclass
class Curve:
    colour: str
    width: float
    line: str
    parts: list[tuple[Array, Array]] = field(default_factory=list)

    @property
    def points(self) -> tuple[Array, Array]:
        """Times and values (n,), finely thinned."""
        time, values = (np.concatenate(each) for each in zip(*self.parts, strict=True))
        return time, values


@dataclass
class Marks:
    colour: str
    level: float
    times: list[Array] = field(default_factory=list)


class Sheet:
    """Curves of any length as thinned ones, in the order in which they first came."""

    def __init__(self) -> None:
        self.label = ""
        """of the vertical axis, with its unit"""
        self.range: tuple[float, float] | None = None
        """of the vertical axis, None for what the curves take"""
        self.zero = False
        """whether a thin line marks it"""
        self.curves: dict[str, Curve] = {}
        self.marks: dict[str, Marks] = {}
        self.limits: dict[str, float] = {}

    def curve(
        self,
        piece: Piece,
        values: NDArray[Any],
        label: str,
        colour: str,
        *,
        width: float,
        line: str = "-",
    ) -> None:
        """Go on with a curve: its values (n,) at the piece's cycles."""
        curve = self.curves.setdefault(label, Curve(colour, width, line))
        curve.parts.append(thin(piece.time, values, FINE * piece.points))

    def mark(self, times: Array, level: float, label: str, colour: str) -> None:
        """Single moments; their number goes into the legend."""
        if len(times):
            self.marks.setdefault(label, Marks(colour, level)).times.append(times)

    def limit(self, value: float, label: str) -> None:
        """A dashed line across the panel."""
        self.limits[label] = value

    def draw(self, panel: Axes) -> None:
        for label, curve in self.curves.items():
            time, values = thin(*curve.points)
            panel.plot(
                time,
                values,
                color=curve.colour,
                linewidth=curve.width,
                linestyle=curve.line,
                label=label,
            )
        for label, marks in self.marks.items():
            times = np.concatenate(marks.times)
            level = np.full(len(times), marks.level)
            text = f"{label} ({len(times)})"
            panel.plot(times, level, "v", color=marks.colour, markersize=5, label=text)
        for label, value in self.limits.items():
            panel.axhline(value, color="0.25", linewidth=0.9, linestyle=style.DASHES, label=label)
        if self.zero:
            panel.axhline(0.0, color="0.4", linewidth=0.6)
        if self.range is not None:
            panel.set_ylim(*self.range)
        panel.set_ylabel(self.label)
