"""Several runs in one picture: of each what one curve or two can tell, aligned at START."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from tonus.runtime.states import State
from tonus.tools.errors import ToolError
from tonus.tools.report import figures, panels, space, style
from tonus.tools.report.pieces import Array, Piece
from tonus.tools.report.sheet import Sheet
from tonus.tools.report.story import Story
from tonus.tools.run.summary import tensions, truth_at_cycles

_MM = 1e3


@dataclass(frozen=True)
class Run:
    """One of the runs, with its name in the legend."""

    name: str
    colour: str
    story: Story

    def started(self) -> float | None:
        """s of the first ACTIVE; None without one."""
        active = self.story.in_state(State.ACTIVE)
        return float(self.story.time[int(active.argmax())]) if active.any() else None


Panel = Callable[[Sheet, Piece, Run], None]
"""Puts what it shows of a piece of one run on the sheet of all."""


def runs(stories: Sequence[Story]) -> list[Run]:
    """Named by what tells them apart. Raises ToolError for more than there are colours for."""
    if len(stories) > len(style.RUNS):
        raise ToolError(f"{len(stories)} logs: one picture shows {len(style.RUNS)} at most")
    paths = [story.log.path for story in stories]
    parents, stems = ([path.absolute().parent.name for path in paths], [p.stem for p in paths])
    names = next(
        (each for each in (parents, stems) if len(set(each)) == len(paths)), [*map(str, paths)]
    )
    controllers = [story.log.metadata.get("controller", "") for story in stories]
    if len(set(controllers)) > 1:
        names = [
            f"{name} ({controller})" if controller else name
            for name, controller in zip(names, controllers, strict=True)
        ]
    return [
        Run(name, colour, story)
        for name, colour, story in zip(names, style.RUNS, stories, strict=False)
    ]


def over_time(all_runs: Sequence[Run], drawn: Sequence[Panel]) -> Figure:
    """Panels with a curve or two of each run; time 0 is START, the first ACTIVE, if each has one,
    otherwise the log's first message."""
    sheets = [Sheet() for _ in drawn]
    starts = [run.started() for run in all_runs]
    aligned = None not in starts
    for run, start in zip(all_runs, starts, strict=True):
        zero = start if aligned and start is not None else 0.0
        for piece in run.story.pieces():
            moved = replace(piece, time=piece.time - zero)
            for sheet, fill in zip(sheets, drawn, strict=True):
                fill(sheet, moved, run)
    figure = Figure(figsize=(11.0, 2.3 * len(sheets) + 0.8), layout="constrained")
    axes = list(figure.subplots(len(sheets), 1, sharex=True, squeeze=False)[:, 0])
    for axis, sheet in zip(axes, sheets, strict=True):
        sheet.draw(axis)
        if aligned:
            axis.axvline(0.0, color="0.7", linewidth=0.7, zorder=0.5)
    panels.trim(axes)
    axes[-1].set_xlabel(f"time since {'START' if aligned else 'the first message'} / s")
    return figure


def force(sheet: Sheet, piece: Piece, run: Run) -> None:
    """External load and contact, true in a lab."""
    load, contact = truth_at_cycles(piece.log, "load"), truth_at_cycles(piece.log, "contact_force")
    wrench = piece.log["/tonus/wrench"]
    load = wrench["external"] if load is None else load
    contact = wrench["contact"] if contact is None else contact
    sheet.curve(piece, _norm(load[:, :3]), f"{run.name}, load", run.colour, width=1.3)
    sheet.curve(piece, contact, f"{run.name}, contact", run.colour, width=1.0, line=":")
    sheet.label = "force / N"


def stiffness(sheet: Sheet, piece: Piece, run: Run) -> None:
    """What is commanded."""
    sheet.curve(piece, piece.log["/tonus/stiffness"]["k_eq"], run.name, run.colour, width=1.3)
    sheet.label = "stiffness K_eq / N/m"


def tension(sheet: Sheet, piece: Piece, run: Run) -> None:
    """Highest and lowest of all cables."""
    values = tensions(piece.log)
    sheet.curve(piece, values.max(axis=1), f"{run.name}, highest", run.colour, width=1.1)
    sheet.curve(piece, values.min(axis=1), f"{run.name}, lowest", run.colour, width=1.1, line="--")
    sheet.label = "cable tension / N"


def error(sheet: Sheet, piece: Piece, run: Run) -> None:
    """Distance from the reference in HOLD and ACTIVE."""
    against, values = panels.position_error(piece)
    name = f"{run.name}, {against}"
    sheet.curve(piece, _norm(values) * _MM, name, run.colour, width=1.1)
    sheet.label = "position error, norm / mm"


def tension_error(sheet: Sheet, piece: Piece, run: Run) -> None:
    """Of all cables together, RMS, in HOLD and ACTIVE."""
    values = tensions(piece.log) - piece.log["/tonus/tension"]["reference"]
    rms = _norm(values) / np.sqrt(values.shape[1])
    rms[~piece.in_state(State.HOLD, State.ACTIVE)] = np.nan
    sheet.curve(piece, rms, run.name, run.colour, width=1.1)
    sheet.label = "tension error, RMS of cables / N"


def speed(sheet: Sheet, piece: Piece, run: Run) -> None:
    """As estimated."""
    values = _norm(piece.log["/tonus/pose"]["velocity"])
    sheet.curve(piece, values, run.name, run.colour, width=1.1)
    sheet.label = "speed / m/s"


def timing(all_runs: Sequence[Run]) -> Figure | None:
    """Histograms of wake-up, dotted, and cycle; None if all were in virtual time."""
    rows: list[tuple[Array, str, str, str]] = []
    notes: list[str] = []
    for run in all_runs:
        wakeup, cycle = figures.latencies(run.story)
        if max(wakeup.max(), cycle.max()) > 0.0:
            rows.append((wakeup, f"{run.name}, wake-up", run.colour, ":"))
            rows.append((cycle, f"{run.name}, cycle", run.colour, "-"))
        else:
            notes.append(f"{run.name}: in virtual time")
    return figures.histograms(rows, all_runs[0].story.period, notes) if rows else None


def path(all_runs: Sequence[Run]) -> Figure | None:
    """In space; None if none was ever ACTIVE."""
    return space.draw([(run.name, run.colour, space.Path.of(run.story)) for run in all_runs])


def _norm(vectors: Array) -> Array:
    lengths: Array = np.sqrt((vectors**2).sum(axis=1))
    return lengths
