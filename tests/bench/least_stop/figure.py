"""docs/least_stop.png: how the optima are distributed over the poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tests.bench.least_stop.cases import MOTIONS
from tonus.config.schema.least_stop import LeastStops, Tear

_COLOURS = {-0.06: "#0072B2", 0.0: "#009E73", 0.12: "#D55E00"}
"""of a pose, by its height in m"""
_QUANTITIES = (("speed", "least peak speed / (m/s)"), ("tension", "peak tension / N"))


def draw(table: LeastStops, out: Path) -> None:
    """Per torn cable every pose as a point, for each motion, with the median as a bar."""
    motions = [motion for motion in MOTIONS if any(getattr(t, motion) for t in table.tears)]
    figure = Figure(figsize=(3.0 + 2.6 * len(motions), 6.0), dpi=110)
    figure.set_layout_engine("constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, len(motions), sharex=True, sharey="row", squeeze=False)
    for row, (quantity, label) in zip(panels, _QUANTITIES, strict=True):
        for panel, motion in zip(row, motions, strict=True):
            _points(panel, table.tears, motion, quantity)
        row[0].set_ylabel(label)
        row[0].set_ylim(bottom=0.0)
    for panel, motion in zip(panels[0], motions, strict=True):
        panel.set_title(motion if motion == "rest" else f"{table.speed_limit:g} m/s {motion}")
    for panel in panels[1]:
        panel.set_xlabel("torn cable")
    handles = [
        panels[0][0].plot([], [], "o", color=colour, label=f"z = {z:+.2f} m")[0]
        for z, colour in _COLOURS.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(out)


def _points(panel: Axes, tears: tuple[Tear, ...], motion: str, quantity: str) -> None:
    for cable in sorted({tear.cable for tear in tears}):
        stops = [(t.position, getattr(t, motion)) for t in tears if t.cable == cable]
        known = [(place, getattr(stop, quantity)) for place, stop in stops if stop is not None]
        if not known:
            continue
        values = np.array([value for _, value in known])
        shift = np.linspace(-0.3, 0.3, len(known))
        colours = [_COLOURS.get(place[2], "#555555") for place, _ in known]
        panel.scatter(cable + shift, values, s=9, c=colours)
        panel.plot([cable - 0.35, cable + 0.35], [np.median(values)] * 2, color="black")
    panel.set_xticks(range(8))
    panel.grid(axis="y", alpha=0.3)
