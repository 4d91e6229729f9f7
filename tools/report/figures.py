"""The pictures of the report beside those over time: Figure 1, spectra, timing."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.runtime.signals import Grade
from tonus.runtime.states import State
from tonus.tools.report import panels, style
from tonus.tools.report.pieces import Array, Piece
from tonus.tools.report.sheet import Sheet
from tonus.tools.report.story import Story
from tonus.tools.run.summary import tensions, truth_at_cycles

_ARMED = (State.PRETENSION, State.HOLD, State.ACTIVE, State.SAFE_STOP)
_DOTS = 3000
"""points of the cloud in Figure 1"""
_SEGMENT_S = 2.0
"""length of the stretches whose spectra are averaged"""
SPECTRA_S = 60.0
"""of ACTIVE that spectra are taken of, at most"""
_BINS = 120


def filled(pieces: Iterable[Piece], drawn: Sequence[panels.Panel]) -> list[Sheet]:
    """A sheet for each panel."""
    sheets = [Sheet() for _ in drawn]
    for piece in pieces:
        for sheet, fill in zip(sheets, drawn, strict=True):
            fill(sheet, piece)
    return sheets


def over_time(
    story: Story,
    sheets: Sequence[Sheet],
    between: tuple[float, float] | None = None,
    *,
    height: float = 2.3,
) -> Figure:
    """Sheets on one time axis, the whole run's or ``between`` two times in s."""
    figure = Figure(figsize=(11.0, height * len(sheets) + 0.8), layout="constrained")
    axes = list(figure.subplots(len(sheets), 1, sharex=True, squeeze=False)[:, 0])
    for axis, sheet in zip(axes, sheets, strict=True):
        sheet.draw(axis)
    panels.dress(axes, story, names=between is None)
    if between is not None:
        axes[0].set_xlim(*between)
    return figure


class Cloud:
    """Figure 1's points: highest tension of all, K_eq, contact, and the envelope's grade, of
    the armed robot, thinned to `_DOTS`."""

    def __init__(self, story: Story) -> None:
        self._step = max(1, int(story.in_state(*_ARMED).sum()) // _DOTS)
        self._seen = 0
        self._parts: list[tuple[Array, Array, Array, Array]] = []

    def add(self, piece: Piece) -> None:
        armed = np.flatnonzero(piece.in_state(*_ARMED))
        chosen = armed[-self._seen % self._step :: self._step]
        self._seen += len(armed)
        log = piece.log
        true = truth_at_cycles(log, "contact_force")
        contact = log["/tonus/wrench"]["contact"] if true is None else true
        highest = tensions(log)[chosen].max(axis=1)
        k_eq, grade = log["/tonus/stiffness"]["k_eq"], log["/tonus/envelope"]["grade"]
        self._parts.append((highest, k_eq[chosen] * 1e-3, contact[chosen], grade[chosen]))

    def points(self) -> tuple[Array, ...]:
        """Each (n,): N, kN/m, N, Grade."""
        return tuple(np.concatenate(each) for each in zip(*self._parts, strict=True))


def envelope(story: Story, cloud: Cloud) -> Figure | None:
    """Figure 1: tension, stiffness and contact force of the armed robot, in the box of its limits;
    None if it never ran."""
    highest, k_eq, contact, grades = cloud.points()
    if not len(grades):
        return None
    figure = Figure(figsize=(9.8, 6.6))
    panel = figure.add_subplot(projection="3d", computed_zorder=False)
    figure.subplots_adjust(left=0.0, right=0.70, bottom=0.05, top=0.98)
    handles = []
    if story.config is not None:
        _box(panel, story.config)
        handles.append(Line2D([], [], color="0.35", linewidth=0.9, label="bounds of the envelope"))
    for grade, colour in style.GRADES.items():
        of = grades == grade
        if of.any():
            panel.scatter(
                highest[of],
                k_eq[of],
                contact[of],
                s=4 if grade is Grade.GREEN else 12,
                marker="o" if grade is Grade.GREEN else "^" if grade is Grade.AMBER else "s",
                color=colour,
                depthshade=False,
                rasterized=True,
                label=f"{grade.name.lower()}, {100.0 * of.mean():.3g} %",
            )
    panel.set_xlabel("highest cable tension / N", labelpad=8)
    panel.set_ylabel("stiffness K_eq / kN/m", labelpad=8)
    panel.set_zlabel("contact force / N", labelpad=6)
    panel.view_init(elev=20, azim=-58)
    handles = [*panel.get_legend_handles_labels()[0], *handles]
    panel.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.02, 0.9), frameon=False)
    return figure


def spectra(story: Story) -> Figure | None:
    """Amplitude densities (Welch's method) over the beginning of the longest ACTIVE; None if it
    lasted less than a stretch."""
    active = _longest(story.in_state(State.ACTIVE))
    segment = round(_SEGMENT_S / story.period)
    if active.stop - active.start < segment:
        return None
    begin = float(story.time[active.start])
    last = min(float(story.time[active.stop - 1]), begin + SPECTRA_S)
    piece = story.near(begin, last)
    against, position = panels.position_error(piece)
    tension = tensions(piece.log) - piece.log["/tonus/tension"]["reference"]
    wrench = piece.log["/tonus/wrench"]["external"][:, :3]
    source = "true" if piece.has_truth else "measured"
    rows = (
        (position * 1e3, f"position error, {against}", "mm/√Hz", "xyz", style.AXES),
        (tension, f"tension error, {source}", "N/√Hz", None, None),
        (wrench, "load, estimated", "N/√Hz", "xyz", style.AXES),
    )
    from scipy.signal import welch  # a second, for which every run's overview would wait

    figure = Figure(figsize=(11.0, 8.2), layout="constrained")
    axes = figure.subplots(len(rows), 1, sharex=True)
    for axis, (values, title, unit, names, colours) in zip(axes, rows, strict=True):
        hertz, density = welch(values, 1.0 / story.period, nperseg=segment, axis=0)
        for column in range(values.shape[1]):
            colour, line = (colours[column], "-") if colours else style.cable(column)
            label = names[column] if names else f"cable {column}"
            axis.loglog(
                hertz[1:],
                np.sqrt(density[1:, column]),
                color=colour,
                linestyle=line,
                linewidth=0.9,
                label=label,
            )
        axis.set_ylabel(f"{title}\n/ {unit}")
        axis.grid(color="0.88", linewidth=0.6)
        axis.legend(loc="upper left", bbox_to_anchor=(1.005, 1.02), fontsize=8, frameon=False)
    axes[-1].set_xlabel("frequency / Hz")
    return figure


def timing(story: Story) -> Figure | None:
    """Histograms of wake-up and cycle, on axes that show the rare; None in virtual time."""
    wakeup, cycle = latencies(story)
    if max(wakeup.max(), cycle.max()) <= 0.0:
        return None
    rows = ((wakeup, "wake-up", style.BLUE, "-"), (cycle, "cycle", style.ORANGE, "-"))
    return histograms(rows, story.period)


def latencies(story: Story) -> tuple[Array, Array]:
    """Of every tick (n,) in µs: how late it woke, and how long it worked."""
    rows = story.log["/tonus/timing"]
    cycle = rows["collect_us"] + rows["compute_us"] + rows["publish_us"]
    return np.asarray(rows["wakeup_us"], np.float64), np.asarray(cycle, np.float64)


def histograms(
    rows: Sequence[tuple[Array, str, str, str]], period: float, notes: Sequence[str] = ()
) -> Figure:
    """Of latencies in µs, each with name, colour and line; ``period`` of the ticks in s; ``notes``
    stand in the legend too."""
    figure = Figure(figsize=(11.0, 3.4), layout="constrained")
    panel = figure.subplots()
    largest = max(float(values.max()) for values, *_ in rows)
    edges = np.geomspace(1.0, max(10.0, 1.2 * largest), _BINS)
    for values, label, colour, line in rows:
        p50, p999 = np.percentile(values, (50.0, 99.9))
        text = f"{label}: p50 {p50:.0f}, p99.9 {p999:.0f}, max {values.max():.0f} µs"
        panel.hist(
            np.maximum(values, 1.0),
            edges.tolist(),
            histtype="step",
            color=colour,
            linewidth=1.3,
            linestyle=line,
            label=text,
        )
    period *= 1e6
    panel.axvline(period, color="0.25", linestyle=style.DASHES, label=f"period {period:.0f} µs")
    for note in notes:
        panel.plot([], [], linestyle="none", label=note)
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_xlabel("µs")
    panel.set_ylabel("ticks")
    panel.grid(color="0.88", linewidth=0.6)
    panel.legend(loc="upper left", bbox_to_anchor=(1.005, 1.02), fontsize=8, frameon=False)
    return figure


def _box(panel: Poly3DCollection, config: Config) -> None:
    """The safe region: T_min to T_max, K_min to K_max, contact up to its limit."""
    bounds, law = config.control.tension, config.control.stiffness
    ends = np.array(
        [
            [bounds.min, bounds.max],
            [law.minimum * 1e-3, law.maximum * 1e-3],
            [0.0, config.control.envelope.contact_limit],
        ]
    )
    faces = []
    for axis in range(3):
        for end in ends[axis]:
            u, v = (ends[other] for other in range(3) if other != axis)
            corners = [(u[i], v[j]) for i, j in ((0, 0), (0, 1), (1, 1), (1, 0))]
            faces.append([np.insert(np.array(corner), axis, end) for corner in corners])
    panel.add_collection3d(
        Poly3DCollection(faces, facecolor=(0, 0, 0, 0.02), edgecolor="0.35", linewidth=0.9)
    )


def _longest(mask: NDArray[np.bool_]) -> slice:
    """The longest stretch of ``mask`` (n,)."""
    steps = np.diff(mask.astype(np.int8), prepend=0, append=0)
    starts, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    if not len(starts):
        return slice(0, 0)
    best = int((ends - starts).argmax())
    return slice(int(starts[best]), int(ends[best]))
