"""The panels of a run over time; a picture is some of them, one below the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes

from tonus.runtime.states import State
from tonus.tools.report import style
from tonus.tools.report.pieces import Array, Piece
from tonus.tools.report.sheet import Sheet
from tonus.tools.report.story import Story
from tonus.tools.run.summary import tensions, truth_at_cycles

Panel = Callable[[Sheet, Piece], None]
"""Puts what it shows of a piece on its sheet."""
_MM = 1e3
_RUNNING = (State.HOLD, State.ACTIVE)
_LABEL_SPACING = 0.032
"""of the width, between the names of two states"""
_LARGEST_SHIFT = 0.08
"""of the width, by which a name may be moved"""


def force(sheet: Sheet, piece: Piece) -> None:
    """External load and contact, estimated or measured, and true."""
    load, contact = truth_at_cycles(piece.log, "load"), truth_at_cycles(piece.log, "contact_force")
    wrench = piece.log["/tonus/wrench"]
    if load is not None:
        sheet.curve(piece, _norm(load[:, :3]), "load, true", style.BLACK, width=2.0)
    external = _norm(wrench["external"][:, :3])
    sheet.curve(piece, external, "load, estimated", style.ORANGE, width=1.0)
    if contact is not None:
        sheet.curve(piece, contact, "contact, true", style.BLUE, width=2.0)
    sheet.curve(piece, wrench["contact"], "contact, measured", style.SKY, width=1.0)
    if piece.config is not None:
        value = piece.config.control.envelope.contact_limit
        sheet.limit(value, f"contact limit {value:g} N")
    sheet.label = "force / N"


def stiffness(sheet: Sheet, piece: Piece) -> None:
    """The law, the envelope's cap, and what is commanded."""
    rows = piece.log["/tonus/stiffness"]
    sheet.curve(piece, rows["cap"], "cap", style.VERMILION, width=1.0, line=":")
    sheet.curve(piece, rows["law"], "law", style.ORANGE, width=1.0)
    sheet.curve(piece, rows["k_eq"], "K_eq, commanded", style.BLUE, width=1.6)
    if piece.config is not None:
        law = piece.config.control.stiffness
        sheet.limit(law.maximum, f"K_max {law.maximum:.0f} N/m")
        sheet.limit(law.minimum, f"K_min {law.minimum:.0f} N/m")
        sheet.range = 0.0, 1.08 * law.maximum
    sheet.label = "stiffness / N/m"


def tension(sheet: Sheet, piece: Piece) -> None:
    """The cables: true in a lab, measured otherwise."""
    for cable, column in enumerate(tensions(piece.log).T):
        colour, line = style.cable(cable)
        sheet.curve(piece, column, f"cable {cable}", colour, width=1.1, line=line)
    if piece.config is not None:
        bounds = piece.config.control.tension
        sheet.limit(bounds.max, f"T_max {bounds.max:g} N")
        sheet.limit(bounds.min, f"T_min {bounds.min:g} N")
    source = "true" if piece.has_truth else "measured"
    sheet.label = f"cable tension, {source} / N"


def error(sheet: Sheet, piece: Piece) -> None:
    """Position less reference in HOLD and ACTIVE."""
    against, values = position_error(piece)
    for axis, colour, column in zip("xyz", style.AXES, values.T * _MM, strict=True):
        sheet.curve(piece, column, f"{axis}, {against} - desired", colour, width=1.1)
    sheet.zero = True
    sheet.label = "position error / mm"


def tension_error(sheet: Sheet, piece: Piece) -> None:
    """Tension less reference in HOLD and ACTIVE."""
    values = tensions(piece.log) - piece.log["/tonus/tension"]["reference"]
    values[~piece.in_state(*_RUNNING)] = np.nan
    for cable, column in enumerate(values.T):
        colour, line = style.cable(cable)
        sheet.curve(piece, column, f"cable {cable}", colour, width=0.9, line=line)
    sheet.zero = True
    source = "true" if piece.has_truth else "measured"
    sheet.label = f"tension, {source} - reference / N"


def path(sheet: Sheet, piece: Piece) -> None:
    """Desired and estimated position."""
    pose = piece.log["/tonus/pose"]
    for number, (axis, colour) in enumerate(zip("xyz", style.AXES, strict=True)):
        desired, position = pose["desired_position"][:, number], pose["position"][:, number]
        sheet.curve(piece, position * _MM, f"{axis}, estimated", colour, width=1.1)
        sheet.curve(piece, desired * _MM, f"{axis}, desired", colour, width=1.1, line="--")
    sheet.label = "position / mm"


def speed(sheet: Sheet, piece: Piece) -> None:
    """Estimated speed, and the rate at which the envelope lets the reference go on."""
    values = _norm(piece.log["/tonus/pose"]["velocity"])
    sheet.curve(piece, values, "speed, estimated", style.BLUE, width=1.1)
    if piece.config is not None:
        value = piece.config.control.envelope.speed_limit
        sheet.limit(value, f"speed limit {value:g} m/s")
    sheet.label = "speed / m/s"


def latency(sheet: Sheet, piece: Piece) -> None:
    """How late each tick woke and how long it worked; zero in virtual time."""
    timing = piece.log["/tonus/timing"]
    cycle = timing["collect_us"] + timing["compute_us"] + timing["publish_us"]
    sheet.curve(piece, cycle, "cycle", style.SKY, width=0.8)
    sheet.curve(piece, timing["wakeup_us"], "wake-up", style.BLUE, width=0.8)
    for name, whose, colour in (
        ("missed_own", "our own", style.VERMILION),
        ("missed_host", "host", style.ORANGE),
    ):
        missed = piece.time[piece.missed[name]]
        sheet.mark(missed, piece.period * 1e6, f"missed, {whose}", colour)
    sheet.label = "latency / µs"


def position_error(piece: Piece) -> tuple[str, Array]:
    """Against what, and the error (n, 3) in m; nan outside HOLD and ACTIVE."""
    position = truth_at_cycles(piece.log, "position")
    against = "truth" if position is not None else "estimate"
    pose = piece.log["/tonus/pose"]
    if position is None:
        position = np.asarray(pose["position"])
    running = piece.in_state(*_RUNNING)
    return against, np.where(running[:, None], position - pose["desired_position"], np.nan)


def dress(panels: Sequence[Axes], story: Story, *, names: bool = True) -> None:
    """What all panels of a picture share: states, faults, grid, legends and the time axis."""
    bands = story.bands
    for panel in panels:
        for number, (state, start, end) in enumerate(bands):
            panel.axvspan(start, end, color=style.BANDS[state], linewidth=0, zorder=0)
            if number:
                panel.axvline(start, color="0.7", linewidth=0.7, zorder=0.5)
    trim(panels)
    if names:
        _name(panels[0], bands, float(story.time[-1]))
    _mark_faults(panels, story)
    panels[-1].set_xlabel("time since the first message / s")


def trim(panels: Sequence[Axes]) -> None:
    """Grid, margins and legends."""
    for panel in panels:
        panel.grid(color="0.88", linewidth=0.6)
        panel.set_axisbelow(True)
        panel.margins(x=0.0)
        # Outside, so that no curve is ever hidden.
        panel.legend(loc="upper left", bbox_to_anchor=(1.005, 1.02), fontsize=8, frameon=False)


def _name(panel: Axes, bands: list[tuple[State, float, float]], span: float) -> None:
    """The states' names over the first panel, moved apart where they would meet, and left out where
    they would stand over another state: the page lists them all."""
    last = -1.0
    for state, start, _ in bands:
        due = start / (span or 1.0)
        place = max(due, last + _LABEL_SPACING)
        if place - due > _LARGEST_SHIFT:
            continue
        last = place
        panel.text(
            place,
            1.02,
            state.name,
            transform=panel.transAxes,
            rotation=35,
            rotation_mode="anchor",
            fontsize=8,
            ha="left",
            va="bottom",
        )


def _mark_faults(panels: Sequence[Axes], story: Story) -> None:
    for fault in story.faults:
        at = story.at(fault["tick"])
        for panel in panels:
            panel.axvline(at, color=style.VERMILION, linewidth=1.2)
        panels[0].annotate(
            f"{fault['name']} {fault['where']}".strip(),
            (at, 0.97),
            xycoords=("data", "axes fraction"),
            xytext=(-4, 0),
            textcoords="offset points",
            ha="right",
            va="top",
            fontsize=8,
            color=style.VERMILION,
            # One beyond the panel's times would take the room of all panels.
            annotation_clip=True,
            bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0.0, "pad": 1.0},
        )


def _norm(vectors: Array) -> Array:
    lengths: Array = np.sqrt((vectors**2).sum(axis=1))
    return lengths
