"""workspace.png: every map as three level cuts through the box, the worst turn at each position."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tonus.tools.workspace.maps import Map, Maps

Array = NDArray[np.float64]
_INFEASIBLE = "#D55E00"


def draw(maps: Maps, title: str, out: Path) -> None:
    """Draw ``maps`` over a regular grid to a PNG. Raises `OSError`."""
    axes = [np.unique(maps.at.positions[:, axis]) for axis in range(3)]
    levels = sorted({0, len(axes[2]) // 2, len(axes[2]) - 1})
    figure = Figure(figsize=(3.2 * len(levels) + 1.6, 2.75 * len(maps.maps)), dpi=110)
    figure.set_layout_engine("constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(maps.maps), len(levels), sharex=True, sharey=True, squeeze=False)
    for row, one in zip(panels, maps.maps.values(), strict=True):
        worst = _worst_turn(one.values, axes)
        norm = _range(worst, one.low)
        for panel, level in zip(row, levels, strict=True):
            _cut(panel, axes[0], axes[1], worst[:, :, level], one, norm)
            panel.set_title(f"z = {axes[2][level]:+.2f} m", fontsize=8)
        row[0].set_ylabel("y / m", fontsize=8)
        bar = figure.colorbar(ScalarMappable(norm, "viridis"), ax=list(row), pad=0.01)
        bar.set_label(_label(one), fontsize=8)
        bar.ax.tick_params(labelsize=7)
    for panel in panels[-1]:
        panel.set_xlabel("x / m", fontsize=8)
    figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    figure.savefig(out)


def _range(values: Array, low: float | None) -> Normalize:
    """Of the colours: what is feasible."""
    shown = values[np.isfinite(values) & (values >= (-np.inf if low is None else low))]
    return Normalize(shown.min(), shown.max()) if shown.size else Normalize(0.0, 1.0)


def _worst_turn(values: Array, axes: list[Array]) -> Array:
    """(x, y, z): the least over the turns, which follow each other over the whole grid."""
    return np.asarray(values.reshape(-1, *(len(axis) for axis in axes)).min(axis=0))


def _cut(panel: Axes, x: Array, y: Array, values: Array, one: Map, norm: Normalize) -> None:
    shown = np.ma.masked_invalid(values.T)
    if one.low is not None:
        shown = np.ma.masked_less(shown, one.low)
    panel.set_facecolor(_INFEASIBLE)
    panel.pcolormesh(x, y, shown, norm=norm, cmap="viridis", shading="nearest")
    panel.set_aspect("equal")
    panel.tick_params(labelsize=7)


def _label(one: Map) -> str:
    title, _, detail = one.title.partition(", ")
    unit = f" / {one.unit}" if one.unit else ""
    return f"{title}{unit}\n{detail}"
