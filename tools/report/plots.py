"""The figures of `tonus log figure`: each drawn as in overview and report, alone in a file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from tonus.tools.draft import drafted
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.report import figures, overlay, panels, space, style
from tonus.tools.report.saved import KINDS, save
from tonus.tools.report.story import Story

_VIRTUAL = "has no latencies: it was in virtual time"
_NEVER_ARMED, _NEVER_ACTIVE = "the robot was never armed", "the robot was never ACTIVE"
_TOO_SHORT = "ACTIVE did not last long enough for a spectrum"


@dataclass(frozen=True)
class Plot:
    line: str
    """what it shows"""
    one: Callable[[Story], Figure | None]
    several: Callable[[Sequence[overlay.Run]], Figure | None] | None
    """of several runs at once, None where that would show nothing"""
    why_not: str = ""
    """what to say of a log that has nothing to show"""


def draw(logs: Sequence[Log], what: str) -> Figure:
    """One of `PLOTS`, of one log or several. Raises ToolError where there is nothing to show."""
    plot = PLOTS[what]
    stories = [Story(log) for log in logs]
    if len(stories) == 1:
        figure = plot.one(stories[0])
    elif plot.several is not None:
        figure = plot.several(overlay.runs(stories))
    else:
        raise ToolError(f"{what} shows one log, and {len(logs)} are named; name one")
    if figure is None:
        raise ToolError(f"{logs[0].path}: {plot.why_not}; choose another --what")
    return figure


def write(figure: Figure, out: Path) -> None:
    """In the format of the file's name. Raises ToolError."""
    try:
        with drafted(out) as beside:
            save(figure, beside, kind_of(out))
    except OSError as error:
        raise ToolError(f"{out}: {error.strerror}; choose another with --out") from error


def kind_of(out: Path) -> str:
    """Raises ToolError for a name of another format."""
    kind = out.suffix.lower().removeprefix(".")
    if kind not in KINDS:
        names = ", ".join(f".{each}" for each in KINDS)
        raise ToolError(f"{out}: a figure is written as {names}; correct the name")
    return kind


def _time(*drawn: panels.Panel) -> Callable[[Story], Figure]:
    def one(story: Story) -> Figure:
        height = 2.3 if len(drawn) > 1 else 3.6
        return figures.over_time(story, figures.filled(story.pieces(), drawn), height=height)

    return one


def _together(*drawn: overlay.Panel) -> Callable[[Sequence[overlay.Run]], Figure]:
    return lambda runs: overlay.over_time(runs, drawn)


def _envelope(story: Story) -> Figure | None:
    cloud = figures.Cloud(story)
    for piece in story.pieces():
        cloud.add(piece)
    return figures.envelope(story, cloud)


def _path(story: Story) -> Figure | None:
    return space.draw([("", style.BLUE, space.Path.of(story))])


PLOTS = {
    "overview": Plot(
        "force, stiffness, tensions and position error over time",
        _time(panels.force, panels.stiffness, panels.tension, panels.error),
        _together(overlay.force, overlay.stiffness, overlay.tension, overlay.error),
    ),
    "force": Plot(
        "external load and contact force over time",
        _time(panels.force),
        _together(overlay.force),
    ),
    "stiffness": Plot(
        "the law, the envelope's cap and the commanded K_eq over time",
        _time(panels.stiffness),
        _together(overlay.stiffness),
    ),
    "tension": Plot(
        "tensions of the cables and their errors over time",
        _time(panels.tension, panels.tension_error),
        _together(overlay.tension, overlay.tension_error),
    ),
    "error": Plot(
        "position error over time, in HOLD and ACTIVE",
        _time(panels.error),
        _together(overlay.error),
    ),
    "position": Plot("position, desired and estimated, over time", _time(panels.path), None),
    "speed": Plot(
        "estimated speed of the platform over time", _time(panels.speed), _together(overlay.speed)
    ),
    "path": Plot(
        "the platform's path in 3-D, in ACTIVE", _path, overlay.path, why_not=_NEVER_ACTIVE
    ),
    "envelope": Plot(
        "tension, stiffness and force in their bounds (the paper's Figure 1)",
        _envelope,
        None,
        why_not=_NEVER_ARMED,
    ),
    "spectra": Plot(
        "spectra of position and tension error in ACTIVE",
        figures.spectra,
        None,
        why_not=_TOO_SHORT,
    ),
    "timing": Plot(
        "histograms of wake-up and cycle, of a run in real time",
        figures.timing,
        overlay.timing,
        why_not=_VIRTUAL,
    ),
}
