"""The panels of a run over time; a picture is some of them, one below the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from runtime.states import State
from tools.report import style
from tools.report.story import Array, Story
from tools.report.thin import thin
from tools.summary import tensions, truth_at_cycles

Panel = Callable[[Axes, Story], None]
_MM = 1e3
_RUNNING = (State.HOLD, State.ACTIVE)
_LABEL_SPACING = 0.032
"""of the width, between the names of two states"""


def force(panel: Axes, story: Story) -> None:
    """External load and contact, estimated or measured, and true."""
    load, contact = truth_at_cycles(story.log, "load"), truth_at_cycles(story.log, "contact_force")
    wrench = story.log["/tonus/wrench"]
    if load is not None:
        _curve(panel, story, _norm(load[:, :3]), "load, true", style.BLACK, width=2.0)
    external = _norm(wrench["external"][:, :3])
    _curve(panel, story, external, "load, estimated", style.ORANGE, width=1.0)
    if contact is not None:
        _curve(panel, story, contact, "contact, true", style.BLUE, width=2.0)
    _curve(panel, story, wrench["contact"], "contact, measured", style.SKY, width=1.0)
    if story.config is not None:
        value = story.config.control.envelope.contact_limit
        limit(panel, value, f"contact limit {value:g} N")
    panel.set_ylabel("force / N")


def stiffness(panel: Axes, story: Story) -> None:
    """The law, the envelope's cap, and what is commanded."""
    rows = story.log["/tonus/stiffness"]
    _curve(panel, story, rows["cap"], "cap", style.VERMILION, width=1.0, line=":")
    _curve(panel, story, rows["law"], "law", style.ORANGE, width=1.0)
    _curve(panel, story, rows["k_eq"], "K_eq, commanded", style.BLUE, width=1.6)
    if story.config is not None:
        law = story.config.control.stiffness
        limit(panel, law.maximum, f"K_max {law.maximum:.0f} N/m")
        limit(panel, law.minimum, f"K_min {law.minimum:.0f} N/m")
        panel.set_ylim(0.0, 1.08 * law.maximum)
    panel.set_ylabel("stiffness / N/m")


def tension(panel: Axes, story: Story) -> None:
    """The eight cables: true in a lab, measured otherwise."""
    for cable, column in enumerate(tensions(story.log).T):
        colour, line = style.cable(cable)
        _curve(panel, story, column, f"cable {cable + 1}", colour, width=1.1, line=line)
    if story.config is not None:
        bounds = story.config.control.tension
        limit(panel, bounds.max, f"T_max {bounds.max:g} N")
        limit(panel, bounds.min, f"T_min {bounds.min:g} N")
    source = "true" if story.has_truth else "measured"
    panel.set_ylabel(f"cable tension, {source} / N")


def error(panel: Axes, story: Story) -> None:
    """Position less reference in HOLD and ACTIVE."""
    against, values = position_error(story)
    for axis, colour, column in zip("xyz", style.AXES, values.T * _MM, strict=True):
        _curve(panel, story, column, f"{axis}, {against} - desired", colour, width=1.1)
    panel.axhline(0.0, color="0.4", linewidth=0.6)
    panel.set_ylabel("position error / mm")


def tension_error(panel: Axes, story: Story) -> None:
    """Tension less reference in HOLD and ACTIVE."""
    values = tensions(story.log) - story.log["/tonus/tension"]["reference"]
    values[~story.in_state(*_RUNNING)] = np.nan
    for cable, column in enumerate(values.T):
        colour, line = style.cable(cable)
        _curve(panel, story, column, f"cable {cable + 1}", colour, width=0.9, line=line)
    panel.axhline(0.0, color="0.4", linewidth=0.6)
    source = "true" if story.has_truth else "measured"
    panel.set_ylabel(f"tension, {source} - reference / N")


def path(panel: Axes, story: Story) -> None:
    """Desired and estimated position."""
    pose = story.log["/tonus/pose"]
    for number, (axis, colour) in enumerate(zip("xyz", style.AXES, strict=True)):
        desired, position = pose["desired_position"][:, number], pose["position"][:, number]
        _curve(panel, story, position * _MM, f"{axis}, estimated", colour, width=1.1)
        _curve(panel, story, desired * _MM, f"{axis}, desired", colour, width=1.1, line="--")
    panel.set_ylabel("position / mm")


def speed(panel: Axes, story: Story) -> None:
    """Estimated speed, and the rate at which the envelope lets the reference go on."""
    values = _norm(story.log["/tonus/pose"]["velocity"])
    _curve(panel, story, values, "speed, estimated", style.BLUE, width=1.1)
    if story.config is not None:
        value = story.config.control.envelope.speed_limit
        limit(panel, value, f"speed limit {value:g} m/s")
    panel.set_ylabel("speed / m/s")


def latency(panel: Axes, story: Story) -> None:
    """How late each tick woke and how long it worked; zero in virtual time."""
    timing = story.log["/tonus/timing"]
    cycle = timing["collect_us"] + timing["compute_us"] + timing["publish_us"]
    _curve(panel, story, cycle, "cycle", style.SKY, width=0.8)
    _curve(panel, story, timing["wakeup_us"], "wake-up", style.BLUE, width=0.8)
    for name, colour in (("missed_own", style.VERMILION), ("missed_host", style.ORANGE)):
        missed = np.flatnonzero(np.diff(timing[name].astype(np.int64), prepend=0) > 0)
        if len(missed):
            label = f"missed, {'our own' if name == 'missed_own' else 'host'} ({len(missed)})"
            level = np.full(len(missed), story.period * 1e6)
            panel.plot(story.time[missed], level, "v", color=colour, markersize=5, label=label)
    panel.set_ylabel("latency / µs")


def position_error(story: Story) -> tuple[str, Array]:
    """Against what, and the error (n, 3) in m; nan outside HOLD and ACTIVE."""
    position = truth_at_cycles(story.log, "position")
    against = "truth" if position is not None else "estimate"
    pose = story.log["/tonus/pose"]
    if position is None:
        position = np.asarray(pose["position"])
    running = story.in_state(*_RUNNING)
    return against, np.where(running[:, None], position - pose["desired_position"], np.nan)


def dress(panels: Sequence[Axes], story: Story, *, names: bool = True) -> None:
    """What all panels of a picture share: states, faults, grid, legends and the time axis."""
    bands = story.bands
    for panel in panels:
        for number, (state, start, end) in enumerate(bands):
            panel.axvspan(start, end, color=style.BANDS[state], linewidth=0, zorder=0)
            if number:
                panel.axvline(start, color="0.7", linewidth=0.7, zorder=0.5)
        panel.grid(color="0.88", linewidth=0.6)
        panel.set_axisbelow(True)
        panel.margins(x=0.0)
        # Outside, so that no curve is ever hidden.
        panel.legend(loc="upper left", bbox_to_anchor=(1.005, 1.02), fontsize=8, frameon=False)
    if names:
        _name(panels[0], bands, float(story.time[-1]))
    _mark_faults(panels, story)
    panels[-1].set_xlabel("time since the first cycle / s")


def limit(panel: Axes, value: float, label: str) -> None:
    """A dashed line across a panel."""
    panel.axhline(value, color="0.25", linewidth=0.9, linestyle=style.DASHES, label=label)


def _curve(
    panel: Axes,
    story: Story,
    values: NDArray[Any],
    label: str,
    colour: str,
    *,
    width: float,
    line: str = "-",
) -> None:
    low, high = panel.get_xlim() if panel.get_autoscalex_on() is False else (-np.inf, np.inf)
    shown = slice(*np.searchsorted(story.time, (low, high)))
    time, thinned = thin(story.time[shown], values[shown])
    panel.plot(time, thinned, color=colour, linewidth=width, linestyle=line, label=label)


def _name(panel: Axes, bands: list[tuple[State, float, float]], span: float) -> None:
    """The states' names over the first panel, moved apart where they would meet."""
    place = -1.0
    for state, start, _ in bands:
        place = max(start / (span or 1.0), place + _LABEL_SPACING)
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
        )


def _norm(vectors: Array) -> Array:
    lengths: Array = np.sqrt((vectors**2).sum(axis=1))
    return lengths
