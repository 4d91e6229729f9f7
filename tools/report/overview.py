"""overview.png: a run on one page, force, stiffness, tensions and position error over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from config.schema.root import Config
from runtime.states import State
from tools.log import Log
from tools.summary import TRUTH, find_faults, tensions, truth_at_cycles

Array = NDArray[np.float64]

# Okabe and Ito's palette, told apart with any common colour vision.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
_CABLE_COLOURS = (BLUE, VERMILION, GREEN, PURPLE)
_CABLE_STYLES = ("-", "--")
_BANDS = {
    State.OFF: "#FFFFFF",
    State.STANDBY: "#F4F4F4",
    State.REFERENCING: "#E6EEF6",
    State.PRETENSION: "#DCE6F0",
    State.HOLD: "#EAF4EC",
    State.ACTIVE: "#FFFFFF",
    State.SAFE_STOP: "#FBEBD9",
    State.FAULT: "#F7D9D4",
}
_MM = 1e3
_DASHES = (0, (6, 3))
_LABEL_SPACING = 0.032
"""of the width, between the names of two states"""


def overview(log: Log, config: Config, out: Path) -> None:
    """Draw a log of cycles to a PNG. Bounds come from ``config``, truth from a lab's log."""
    log.load([topic for topic in log.topics if topic.startswith("/tonus/")])
    times = log.times("/tonus/timing")
    time = (times - times[0]) * 1e-9 if len(times) else np.empty(0)
    figure = Figure(figsize=(11.0, 11.5), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(4, 1, sharex=True)
    force, stiffness, tension, error = panels
    _force(force, log, time, config)
    _stiffness(stiffness, log, time, config)
    _tension(tension, log, time, config)
    _error(error, log, time)
    bands = _bands(log, time)
    for panel in panels:
        _shade(panel, bands)
        panel.grid(color="0.88", linewidth=0.6)
        panel.set_axisbelow(True)
        panel.margins(x=0.0)
        # Outside, so that no curve is ever hidden.
        panel.legend(loc="upper left", bbox_to_anchor=(1.005, 1.02), fontsize=8, frameon=False)
    _name(force, bands, time)
    _mark_faults(panels, log, time)
    error.set_xlabel("time since the first cycle / s")
    figure.suptitle(_title(log, config), fontsize=11, x=0.01, ha="left")
    figure.savefig(out)


def _title(log: Log, config: Config) -> str:
    parts = [config.name, f"controller {log.metadata.get('controller', config.control.controller)}"]
    parts += [f"{key} {log.metadata[key]}" for key in ("scenario", "seed") if key in log.metadata]
    return "Tonus:  " + ",  ".join(parts)


def _force(panel: Axes, log: Log, time: Array, config: Config) -> None:
    load, contact = truth_at_cycles(log, "load"), truth_at_cycles(log, "contact_force")
    wrench = log["/tonus/wrench"]
    if load is not None:
        panel.plot(time, _norm(load[:, :3]), color=BLACK, linewidth=2.0, label="load, true")
    external = _norm(wrench["external"][:, :3])
    panel.plot(time, external, color=ORANGE, linewidth=1.0, label="load, estimated")
    if contact is not None:
        panel.plot(time, contact, color=BLUE, linewidth=2.0, label="contact, true")
    panel.plot(time, wrench["contact"], color=SKY, linewidth=1.0, label="contact, measured")
    limit = config.control.envelope.contact_limit
    _limit(panel, limit, f"contact limit {limit:g} N")
    panel.set_ylabel("force / N")


def _stiffness(panel: Axes, log: Log, time: Array, config: Config) -> None:
    rows, law = log["/tonus/stiffness"], config.control.stiffness
    panel.plot(time, rows["cap"], color=VERMILION, linewidth=1.0, linestyle=":", label="cap")
    panel.plot(time, rows["law"], color=ORANGE, linewidth=1.0, label="law")
    panel.plot(time, rows["k_eq"], color=BLUE, linewidth=1.6, label="K_eq, commanded")
    _limit(panel, law.maximum, f"K_max {law.maximum:.0f} N/m")
    _limit(panel, law.minimum, f"K_min {law.minimum:.0f} N/m")
    panel.set_ylim(0.0, 1.08 * law.maximum)
    panel.set_ylabel("stiffness / N/m")


def _tension(panel: Axes, log: Log, time: Array, config: Config) -> None:
    values, bounds = tensions(log), config.control.tension
    for cable, column in enumerate(values.T):
        panel.plot(
            time,
            column,
            color=_CABLE_COLOURS[cable % len(_CABLE_COLOURS)],
            linestyle=_CABLE_STYLES[cable // len(_CABLE_COLOURS) % len(_CABLE_STYLES)],
            linewidth=1.1,
            label=f"cable {cable + 1}",
        )
    _limit(panel, bounds.max, f"T_max {bounds.max:g} N")
    _limit(panel, bounds.min, f"T_min {bounds.min:g} N")
    source = "true" if _has_truth(log) else "measured"
    panel.set_ylabel(f"cable tension, {source} / N")


def _error(panel: Axes, log: Log, time: Array) -> None:
    pose = log["/tonus/pose"]
    position = truth_at_cycles(log, "position")
    against = "truth" if position is not None else "estimate"
    if position is None:
        position = np.asarray(pose["position"])
    running = np.isin(log["/tonus/state"]["state"], (State.HOLD, State.ACTIVE))
    error = np.where(running[:, None], (position - pose["desired_position"]) * _MM, np.nan)
    for axis, colour, column in zip("xyz", (BLUE, VERMILION, GREEN), error.T, strict=True):
        panel.plot(time, column, color=colour, linewidth=1.1, label=f"{axis}, {against} - desired")
    panel.axhline(0.0, color="0.4", linewidth=0.6)
    panel.set_ylabel("position error / mm")


def _bands(log: Log, time: Array) -> list[tuple[State, float, float]]:
    """State, from and to in s."""
    state = log["/tonus/state"]["state"]
    if not len(state):
        return []
    entered = np.flatnonzero(np.diff(state, prepend=-1) != 0)
    ends = [*time[entered[1:]].tolist(), float(time[-1])]
    return [
        (State(int(state[index])), float(time[index]), end)
        for index, end in zip(entered, ends, strict=True)
    ]


def _shade(panel: Axes, bands: list[tuple[State, float, float]]) -> None:
    for number, (state, start, end) in enumerate(bands):
        panel.axvspan(start, end, color=_BANDS[state], linewidth=0, zorder=0)
        if number:
            panel.axvline(start, color="0.7", linewidth=0.7, zorder=0.5)


def _name(panel: Axes, bands: list[tuple[State, float, float]], time: Array) -> None:
    """The states' names over the first panel, moved apart where they would meet."""
    span = float(time[-1]) if len(time) else 1.0
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


def _mark_faults(panels: NDArray[np.object_], log: Log, time: Array) -> None:
    ticks = log["/tonus/timing"]["tick"]
    for fault in find_faults(log):
        at = float(time[np.searchsorted(ticks, fault["tick"])])
        for panel in panels:
            panel.axvline(at, color=VERMILION, linewidth=1.2)
        text = f"{fault['name']} {fault['where']}".strip()
        panels[0].annotate(
            text,
            (at, 0.97),
            xycoords=("data", "axes fraction"),
            xytext=(-4, 0),
            textcoords="offset points",
            ha="right",
            va="top",
            fontsize=8,
            color=VERMILION,
        )


def _limit(panel: Axes, value: float, label: str) -> None:
    panel.axhline(value, color="0.25", linewidth=0.9, linestyle=_DASHES, label=label)


def _norm(vectors: Array) -> Array:
    lengths: Array = np.sqrt((vectors**2).sum(axis=1))
    return lengths


def _has_truth(log: Log) -> bool:
    return TRUTH in log and len(log[TRUTH]) > 0
