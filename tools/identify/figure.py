"""identify.png: frequency responses and friction, measured and fitted, on one page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from tonus.tools.identify.drums import Drum
from tonus.tools.identify.estimate import Fit
from tonus.tools.identify.identify import Identification
from tonus.tools.identify.response import Response
from tonus.tools.report.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION

Array = NDArray[np.float64]
_TITLES = {
    "platform": "Platform: the cables' force to position",
    "loop": "Closed loop: a load's force to deviation",
}
_MM = 1e3
_CLEAR = 0.15
"""relative half width beyond which a line would only clutter the picture"""
_POINTS = 400
_NEAR = 0.2
"""of the mean tension, for which friction is drawn"""
_TICKS = (1.0, 2.0, 3.0, 5.0)
_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE, "#F0E442", "0.5")


def draw(found: Identification, out: Path) -> None:
    """Write the figure. Raises OSError."""
    rows = len(found.responses) + bool(found.drums)
    figure = Figure(figsize=(10.0, 3.6 * max(rows, 1)), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    parts = figure.subfigures(max(rows, 1), 1, squeeze=False)[:, 0]
    for part, response in zip(parts, found.responses, strict=False):
        _response(part, response)
    if found.drums:
        _friction(parts[-1], found.drums)
    figure.savefig(out)


def _response(part: SubFigure, response: Response) -> None:
    part.suptitle(_TITLES[response.kind], fontsize=11, x=0.01, ha="left")
    size, phase = part.subplots(1, 2)
    clear = [line for line in response.lines if line.half_width < _CLEAR]
    lines = clear or list(response.lines)
    f = np.array([line.frequency for line in lines])
    measured = np.array([line.compliance for line in lines])
    width = np.array([line.half_width for line in lines])
    span = np.geomspace(0.8 * f.min(), 1.2 * f.max(), _POINTS)
    fitted = response.compliance(span)
    mass, damping, stiffness = response.fit.value
    label = f"M {mass:.3g} kg, C {damping:.3g} N s/m, K {stiffness:.4g} N/m"
    size.loglog(span, _MM * np.abs(fitted), color=BLACK, linewidth=1.2, label=label)
    size.errorbar(f, _MM * np.abs(measured), _MM * np.abs(measured) * width, **_MARKS)
    size.yaxis.set_major_locator(LogLocator(subs=_TICKS))
    size.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    size.yaxis.set_minor_formatter(NullFormatter())
    size.set_ylabel("displacement over force / (mm/N)")
    size.legend(fontsize=8, frameon=False)
    phase.semilogx(span, _degrees(fitted), color=BLACK, linewidth=1.2)
    phase.errorbar(f, _degrees(measured), np.degrees(width), **_MARKS)
    phase.set_ylabel("phase / degrees")
    for panel in (size, phase):
        panel.set_xlabel("frequency / Hz")
        panel.xaxis.set_major_locator(LogLocator(subs=_TICKS))
        panel.xaxis.set_major_formatter(FormatStrFormatter("%g"))
        panel.xaxis.set_minor_formatter(NullFormatter())
        _grid(panel)


_MARKS = {"fmt": "o", "color": BLUE, "markersize": 4, "capsize": 2, "linewidth": 0.8}


def _degrees(values: NDArray[np.complex128]) -> Array:
    """Phase within −270 and 90 degrees, so that a mass at −180 does not jump."""
    angle = np.degrees(np.angle(values))
    return np.where(angle > 90.0, angle - 360.0, angle)


def _friction(part: SubFigure, drums: tuple[tuple[Drum, Fit], ...]) -> None:
    title = "Drums: torque that neither tension nor inertia explains, near the mean tension"
    part.suptitle(title, fontsize=11, x=0.01, ha="left")
    panel = part.subplots()
    for number, (drum, found) in enumerate(drums):
        inertia, viscous, coulomb, load, driving, driven = found.value
        winding = drum.torque * drum.rate > 0.0
        share = np.where(winding, 1.0 / driving, driven)
        lost = (drum.friction - share * inertia * drum.acceleration) / drum.radius
        tension, speed = float(drum.tension.mean()), drum.radius * drum.rate
        near = np.flatnonzero(np.abs(drum.tension - tension) < _NEAR * tension)
        some = near[:: max(len(near) // _POINTS, 1)]
        colour = _COLOURS[number % len(_COLOURS)]
        panel.plot(speed[some], lost[some], ".", color=colour, markersize=2, alpha=0.5)
        for side, end in ((1.0, float(speed.max())), (-1.0, float(speed.min()))):
            at = np.array([0.0, end])
            held = viscous * at / drum.radius**2 + side * (load * tension + coulomb) + tension
            model = (held / driving if side > 0.0 else held * driven) - tension
            label = f"drum {number}" if side > 0.0 else None
            panel.plot(at, model, color=colour, linewidth=1.0, label=label)
    panel.set_xlabel("speed of the cable, reeling in positive / (m/s)")
    panel.set_ylabel("loss at the cable / N")
    panel.legend(loc="upper left", bbox_to_anchor=(1.005, 1.02), fontsize=8, frameon=False)
    _grid(panel)


def _grid(panel: Axes) -> None:
    panel.grid(color="0.88", linewidth=0.6, which="both")
    panel.set_axisbelow(True)
