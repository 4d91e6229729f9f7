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


@dataclass
class _Curve:
    colour: str
    width: float
    line: str
    parts: list[tuple[Array, Array]] = field(default_factory=list)


@dataclass
class _Marks:
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
        self._curves: dict[str, _Curve] = {}
        self._marks: dict[str, _Marks] = {}
        self._limits: dict[str, float] = {}

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
        curve = self._curves.setdefault(label, _Curve(colour, width, line))
        curve.parts.append(thin(piece.time, values, piece.points))

    def mark(self, times: Array, level: float, label: str, colour: str) -> None:
        """Single moments; their number goes into the legend."""
        if len(times):
            self._marks.setdefault(label, _Marks(colour, level)).times.append(times)

    def limit(self, value: float, label: str) -> None:
        """A dashed line across the panel."""
        self._limits[label] = value

    def draw(self, panel: Axes) -> None:
        for label, curve in self._curves.items():
            time, values = (np.concatenate(each) for each in zip(*curve.parts, strict=True))
            panel.plot(
                time,
                values,
                color=curve.colour,
                linewidth=curve.width,
                linestyle=curve.line,
                label=label,
            )
        for label, marks in self._marks.items():
            times = np.concatenate(marks.times)
            level = np.full(len(times), marks.level)
            text = f"{label} ({len(times)})"
            panel.plot(times, level, "v", color=marks.colour, markersize=5, label=text)
        for label, value in self._limits.items():
            panel.axhline(value, color="0.25", linewidth=0.9, linestyle=style.DASHES, label=label)
        if self.zero:
            panel.axhline(0.0, color="0.4", linewidth=0.6)
        if self.range is not None:
            panel.set_ylim(*self.range)
        panel.set_ylabel(self.label)
