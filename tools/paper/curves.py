"""Pictures over time, of one trial of each controller. None where its trials are missing."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from tonus.tools.paper import printed
from tonus.tools.paper.case import Kind
from tonus.tools.paper.compare import LITERAL, usual
from tonus.tools.paper.indicators import norms
from tonus.tools.paper.look import PART, WIDE, curves_of, grid, largest, legend, line
from tonus.tools.paper.results import Results
from tonus.tools.report import style


def force_against_way(results: Results) -> Figure | None:
    """Stage 1: hysteresis loops and the fitted line."""
    found = []
    for plant in ("model", "lab"):
        rows = results.select(stage=1, kind=Kind.SLOPE, plant=plant, bus=None)
        for row, curves in curves_of(rows):
            found.append((row, curves))
            break
    if not found:
        return None
    figure = Figure(figsize=(PART, 4.6), layout="constrained")
    axis = figure.subplots()
    for row, curves in found:
        position = curves["position"] - curves["position"][0]
        farthest = position[int(norms(position).argmax())]
        way = farthest / max(float(np.linalg.norm(farthest)), 1e-12)
        x, force = position @ way, curves["load"] @ way
        pushed = np.abs(force) > 0.0
        model = row.plant == "model"
        axis.plot(
            x[pushed] * 1e3,
            force[pushed],
            color=style.BLUE if model else style.ORANGE,
            linewidth=1.4 if model else 0.8,
            label="model, without friction" if model else "lab, with friction",
            zorder=3 if model else 2,
        )
        rise = row.indicators.get("slope")
        if model and rise is not None and pushed.sum() > 2:
            offset = float((force[pushed] - rise * x[pushed]).mean())
            ends = np.array([float(x.min()), float(x.max())])
            axis.plot(
                ends * 1e3,
                offset + rise * ends,
                color=style.BLACK,
                linestyle=(0, (6, 3)),
                linewidth=1.0,
                label=f"fitted: {rise:.0f} N/m",
                zorder=4,
            )
            axis.plot(
                ends * 1e3,
                offset + printed.SLOPE * ends,
                color=style.VERMILION,
                linestyle=":",
                linewidth=1.4,
                label=f"paper: {printed.SLOPE:g} N/m",
                zorder=1,
            )
    axis.set_xlabel("displacement / mm")
    axis.set_ylabel("force of the port / N")
    grid(axis)
    axis.legend(frameon=False)
    return figure


def tracking(results: Results) -> Figure | None:
    """Stage 2: one sine, the way and the error of every controller."""
    case = _fastest_sine(results)
    if case is None:
        return None
    found = list(curves_of(usual(results).select(case=case)))
    if not found:
        return None
    figure = Figure(figsize=(WIDE, 5.4), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 1.4))
    _, first = found[0]
    axis = int(np.ptp(first["desired"], axis=0).argmax())
    top.plot(
        first["time"],
        first["desired"][:, axis] * 1e3,
        color="0.7",
        linewidth=3.0,
        label="reference",
    )
    for row, curves in found:
        line(top, row, curves["time"], curves["position"][:, axis] * 1e3, label=row.controller)
        error = norms(curves["desired"] - curves["position"]) * 1e3
        line(bottom, row, curves["time"], error, linewidth=0.9)
    top.set_ylabel(f"{'xyz'[axis]} / mm")
    bottom.set_ylabel("|x_d − x| against truth / mm")
    bottom.set_xlabel(f"time in ACTIVE / s ({case})")
    for axes in (top, bottom):
        grid(axes)
    bottom.set_ylim(bottom=0.0)
    legend(figure, top)
    return figure


def _fastest_sine(results: Results) -> str | None:
    rows = usual(results).select(kind=Kind.SINE).rows
    speed = {
        row.case: row.indicators["amplitude"] * row.indicators["frequency_hz"]
        for row in rows
        if "amplitude" in row.indicators
    }
    return max(speed, key=lambda case: speed[case]) if speed else None


def _under_load(results: Results, kind: Kind) -> Figure | None:
    case = largest(results, kind)
    if case is None:
        return None
    found = [
        (row, curves)
        for row, curves in curves_of(usual(results).select(case=case))
        if float(norms(curves["load"]).max()) > 0.0
    ]
    if not found:
        return None
    figure = Figure(figsize=(WIDE, 6.6), layout="constrained")
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=(0.6, 1.5, 1.0))
    for row, curves in found:
        load = norms(curves["load"])
        # The lab's schedule starts when the drives are enabled: trials are shown from the onset.
        time = curves["time"] - float(curves["time"][int(np.argmax(load > 0.0))])
        if row is found[0][0]:
            top.plot(time, load, color=style.BLACK, linewidth=1.2)
            top.set_xlim(-0.5, float(time[-1]))
        line(
            middle,
            row,
            time,
            norms(curves["desired"] - curves["position"]) * 1e3,
            label=row.controller,
        )
        line(bottom, row, time, curves["k_eq"] * 1e-3)
    top.set_ylabel("load / N")
    middle.set_ylabel("|x_d − x| / mm")
    bottom.set_ylabel("K_eq / kN/m")
    bottom.set_xlabel(f"time since the load's onset / s ({case})")
    for axes in (top, middle, bottom):
        grid(axes)
    legend(figure, middle)
    return figure


def load_ramp(results: Results) -> Figure | None:
    """Stage 3: 100 N at 20 N/s."""
    return _under_load(results, Kind.RAMP)


def load_step(results: Results) -> Figure | None:
    """Stage 3: 25 N at once."""
    return _under_load(results, Kind.STEP)


def contact(results: Results) -> Figure | None:
    """Stage 3: the force on the phantom, with and without the envelope."""
    rows = results.select(kind=Kind.CONTACT, plant=None, bus=None)
    guarded = list(curves_of(usual(results).select(kind=Kind.CONTACT)))
    bare = Results(
        [row for row in rows if not row.indicators.get("envelope_enabled", 1.0)], results.traces
    )
    opened = list(curves_of(bare))
    if not guarded and not opened:
        return None
    figure = Figure(figsize=(WIDE, 5.2), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(1.5, 1.0))
    for trials, faint in ((opened, True), (guarded, False)):
        for row, curves in trials:
            label = f"{row.controller}, envelope off" if faint else row.controller
            more = {"alpha": 0.45, "linewidth": 2.4} if faint else {}
            line(top, row, curves["time"], curves["contact"], label=label, **more)
            line(bottom, row, curves["time"], curves["k_eq"] * 1e-3, **more)
    top.axhline(printed.CONTACT_LIMIT, color=style.VERMILION, linewidth=1.0, linestyle=style.DASHES)
    top.annotate(
        "F_lim",
        (0.002, printed.CONTACT_LIMIT),
        xycoords=("axes fraction", "data"),
        va="bottom",
        fontsize=9,
    )
    top.set_ylabel("true contact force / N")
    bottom.set_ylabel("K_eq / kN/m")
    bottom.set_xlabel("time in ACTIVE / s")
    for axes in (top, bottom):
        grid(axes)
    legend(figure, top)
    return figure


def pressing(results: Results) -> Figure | None:
    """Stage 3: the force asked for on the phantom."""
    case = largest(results, Kind.PRESS)
    found = [] if case is None else list(curves_of(usual(results).select(case=case)))
    if not found:
        return None
    figure = Figure(figsize=(WIDE, 3.8), layout="constrained")
    axis = figure.subplots()
    _, first = found[0]
    axis.plot(first["time"], first["contact_wanted"], color="0.7", linewidth=3.0, label="asked for")
    for row, curves in found:
        line(axis, row, curves["time"], curves["contact"], label=row.controller)
    axis.set_ylabel("contact force / N")
    axis.set_xlabel("time in ACTIVE / s")
    grid(axis)
    legend(figure, axis)
    return figure


def literal(results: Results) -> Figure | None:
    """Eq. (9) as printed: the tensions of a platform that should stand still."""
    found = list(curves_of(results.select(controller=LITERAL, plant=None, bus=None)))
    if not found:
        return None
    row, curves = found[0]
    figure = Figure(figsize=(WIDE, 3.8), layout="constrained")
    axis = figure.subplots()
    for cable in range(curves["tension"].shape[1]):
        colour, line = style.cable(cable)
        axis.plot(
            curves["time"],
            curves["tension"][:, cable],
            color=colour,
            linestyle=line,
            linewidth=0.8,
            label=f"cable {cable}",
        )
    end = float(curves["time"][-1])
    how = f"ended after {end:.2f} s: {row.fault}" if row.fault else "ran to its end"
    axis.set_title(f"eq. (9) as printed, {how}", fontsize=11, loc="left")
    axis.set_xlabel("time in ACTIVE / s")
    axis.set_ylabel("true tension / N")
    grid(axis)
    axis.legend(frameon=False, loc="center left", bbox_to_anchor=(1.005, 0.5))
    return figure
