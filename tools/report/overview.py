"""overview.png: a run on one page, force, stiffness, tensions and position error over time."""

from __future__ import annotations

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tonus.config.schema.root import Config
from tonus.tools.log import Log
from tonus.tools.report import figures, panels
from tonus.tools.report.story import Story

_PANELS = (panels.force, panels.stiffness, panels.tension, panels.error)


def overview(log: Log, config: Config, out: Path) -> None:
    """Draw a log of cycles to a PNG. Bounds come from ``config``, truth from a lab's log."""
    log.load([topic for topic in log.topics if topic.startswith("/tonus/")])
    figure = Figure(figsize=(11.0, 11.5), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(_title(log, config), fontsize=11, x=0.01, ha="left")
    if len(log["/tonus/timing"]):
        story = Story(log, config)
        axes = figure.subplots(len(_PANELS), 1, sharex=True)
        for axis, sheet in zip(axes, figures.filled(story.pieces(), _PANELS), strict=True):
            sheet.draw(axis)
        panels.dress(axes, story)
    figure.savefig(out)


def _title(log: Log, config: Config) -> str:
    parts = [config.name, f"controller {log.metadata.get('controller', config.control.controller)}"]
    parts += [f"{key} {log.metadata[key]}" for key in ("scenario", "seed") if key in log.metadata]
    return "Tonus:  " + ",  ".join(parts)
