"""How controllers look in every picture, and what the pictures share."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tonus.tools.paper.case import Kind
from tonus.tools.paper.compare import usual
from tonus.tools.paper.results import Results, Row, Traces
from tonus.tools.report import style
from tonus.tools.report.thin import thin

Array = NDArray[np.float64]
WIDE, PART = 11.0, 8.6
"""inches: a picture over the whole page, and one over a part of it"""
LOOKS: dict[str, tuple[str, str, str]] = {
    "bio": (style.BLUE, "-", "o"),
    "bio_integral": (style.SKY, "-", "s"),
    "bio_observer": (style.GREEN, "-", "D"),
    "pid": (style.VERMILION, "--", "^"),
    "pid_length": (style.ORANGE, "--", "v"),
    "pd": (style.PURPLE, "-.", "P"),
    "pd_matched": (style.BLACK, ":", "X"),
    "force": ("0.45", "-.", "*"),
    "eq9_literal": (style.BLACK, "-", "x"),
    "constant_tension": (style.BLUE, "-", "o"),
}
"""Colour, line and marker: no two controllers differ by colour alone"""
_OTHER = ("0.6", "-", ".")


def look(controller: str) -> tuple[str, str, str]:
    """Colour, line style and marker of a controller."""
    return LOOKS.get(controller, _OTHER)


def curves_of(results: Results) -> Iterator[tuple[Row, Traces]]:
    """One trial of each controller, the one with the lowest seed whose curves were kept."""
    for controller in results.names("controller"):
        rows = results.select(controller=controller, plant=None, bus=None).rows
        for row in sorted(rows, key=lambda row: row.seed):
            curves = results.traces(row.key)
            if curves is not None and len(curves["time"]) > 1:
                yield row, {name: values.astype(np.float64) for name, values in curves.items()}
                break


def line(axis: Axes, row: Row, time: Array, values: Array, **more: Any) -> None:
    """A curve in its controller's look, thinned; ``more`` for matplotlib's plot wins."""
    colour, line, _ = look(row.controller)
    x, y = thin(time, values)
    axis.plot(x, y, **{"color": colour, "linestyle": line, "linewidth": 1.2, **more})


def grid(axis: Axes) -> None:
    """Faint lines."""
    axis.grid(color="0.88", linewidth=0.6)


def legend(figure: Figure, axis: Axes) -> None:
    """What an axis shows, above the whole figure."""
    handles, labels = axis.get_legend_handles_labels()
    if handles:
        figure.legend(
            handles, labels, loc="outside upper center", ncols=min(len(labels), 6), frameon=False
        )


def largest(results: Results, kind: Kind) -> str | None:
    """The case of a kind with the most controllers; of equals the first."""
    rows = usual(results).select(kind=kind)
    names = rows.names("case")
    if not names:
        return None
    return max(names, key=lambda case: len(rows.select(case=case).names("controller")))
