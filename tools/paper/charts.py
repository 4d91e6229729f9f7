"""Pictures of accuracy, trade-offs, Table 3, drawn plants. None where trials are missing."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from tonus.tools.paper import printed
from tonus.tools.paper.case import Kind
from tonus.tools.paper.compare import REFERENCE, compared, usual
from tonus.tools.paper.look import PART, WIDE, grid, legend, look
from tonus.tools.paper.printed import Indicator
from tonus.tools.paper.results import Results
from tonus.tools.paper.table import Spread
from tonus.tools.paper.tables import controllers_of
from tonus.tools.report import style


def accuracy_map(results: Results) -> Figure | None:
    """Stage 2: RMS error of every sine and controller."""
    rows = usual(results).select(stage=2, kind=Kind.SINE)
    cases, names = rows.names("case"), controllers_of(results)
    names = [name for name in names if rows.select(controller=name).rows]
    values = np.full((len(names), len(cases)), np.nan)
    for i, name in enumerate(names):
        for j, case in enumerate(cases):
            spread = Spread.of(rows.select(case=case, controller=name).values("position_rmse"))
            if spread is not None:
                values[i, j] = spread.mean * 1e3
    if not np.isfinite(values).any():
        return None
    figure = Figure(figsize=(WIDE, 1.6 + 0.42 * len(names)), layout="constrained")
    axis = figure.subplots()
    image = axis.imshow(values, aspect="auto", cmap="viridis", vmin=0.0)
    axis.set_xticks(range(len(cases)), [case.removeprefix("sine_") for case in cases])
    axis.tick_params(axis="x", rotation=35)
    axis.set_yticks(range(len(names)), names)
    for i in range(len(names)):
        for j in range(len(cases)):
            if np.isfinite(values[i, j]):
                dark = values[i, j] < 0.6 * float(np.nanmax(values))
                axis.text(
                    *(j, i, f"{values[i, j]:.2f}"),
                    ha="center",
                    va="center",
                    fontsize=8,
                    color="white" if dark else "black",
                )
    figure.colorbar(image, ax=axis, label="RMS error / mm")
    return figure


def pareto(results: Results) -> Figure | None:
    """Contact peak against load deviation: soft and firm at once is down and left."""
    hard = Indicator("", "", "N", "contact_peak", frozenset({Kind.CONTACT}))
    kind = Kind.RAMP if usual(results).select(kind=Kind.RAMP).rows else Kind.STEP
    away = Indicator("", "", "mm", "load_deviation_peak", frozenset({kind}), False, 1e3)
    forces, ways = compared(results, hard), compared(results, away)
    opened = _open_peaks(results)
    names = [name for name in controllers_of(results) if name in forces.values]
    names = [name for name in names if name in ways.values]
    if not names:
        return None
    figure = Figure(figsize=(PART, 5.0), layout="constrained")
    axis = figure.subplots()
    for name in names:
        x, y = ways.spread(name), forces.spread(name)
        assert x is not None
        assert y is not None
        colour, _, marker = look(name)
        axis.errorbar(
            x.mean,
            y.mean,
            xerr=x.sd or 0.0,
            yerr=y.sd or 0.0,
            fmt=marker,
            color=colour,
            markersize=9,
            capsize=3,
            label=name,
        )
        if name in opened:
            axis.plot(
                x.mean, opened[name], marker, color=colour, markersize=9, markerfacecolor="none"
            )
    if opened:
        axis.plot([], [], "o", color="0.3", markerfacecolor="none", label="envelope off")
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(FixedLocator([0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0]))
    axis.xaxis.set_minor_locator(NullLocator())
    axis.xaxis.set_major_formatter("{x:g}")
    axis.margins(0.12)
    load = "100 N ramp" if kind is Kind.RAMP else "25 N step"
    axis.set_xlabel(f"largest deviation under the {load} / mm")
    axis.set_ylabel("contact force, peak / N")
    grid(axis)
    axis.legend(frameon=False, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure


def _open_peaks(results: Results) -> dict[str, float]:
    """N by controller, envelope off."""
    rows = results.select(kind=Kind.CONTACT, plant=None, bus=None)
    found: dict[str, list[float]] = {}
    for row in rows:
        if not row.indicators.get("envelope_enabled", 1.0) and "contact_peak" in row.indicators:
            found.setdefault(row.controller, []).append(row.indicators["contact_peak"])
    return {name: float(np.mean(values)) for name, values in found.items()}


def table3_bars(results: Results) -> Figure | None:
    """Table 3 with PID as 1."""
    names = controllers_of(results)
    rows = []
    for indicator, pid, bio, _ in printed.TABLE3:
        found = compared(results, indicator)
        reference = found.spread(REFERENCE)
        if reference is not None and reference.mean != 0.0:
            rows.append((indicator, found, max(reference.mean, indicator.floor), bio / pid))
    if not rows or REFERENCE not in names:
        return None
    figure = Figure(figsize=(WIDE, 4.4), layout="constrained")
    axis = figure.subplots()
    width = 0.84 / (len(names) + 1)
    highest = 2.5
    for place, name in enumerate(names):
        colour, line, _ = look(name)
        for number, (_, found, base, _) in enumerate(rows):
            spread = found.spread(name)
            if spread is None:
                continue
            at = number - 0.42 + (place + 0.5) * width
            height = max(spread.mean, found.indicator.floor) / base
            axis.bar(
                at,
                min(height, highest),
                width * 0.92,
                color=colour,
                hatch="" if line == "-" else "///" if line == "--" else "...",
                edgecolor="white",
                linewidth=0.0,
                label=name if number == 0 else None,
                yerr=(spread.sd or 0.0) / base if height < highest else None,
                error_kw={"linewidth": 0.8, "ecolor": "0.2"},
            )
            if height > highest:
                axis.text(at, highest, f"{height:.2g}", ha="center", va="bottom", fontsize=7)
    for number, (_, _, _, ratio) in enumerate(rows):
        axis.hlines(
            ratio,
            number - 0.44,
            number + 0.44,
            color=style.BLACK,
            linestyle=(0, (2, 2)),
            linewidth=1.0,
            label="the paper's bio" if number == 0 else "_none",
        )
    axis.axhline(1.0, color="0.4", linewidth=0.8)
    ticks = [
        f"{indicator.symbol}\n{'more' if indicator.more_is_better else 'less'} is better"
        for indicator, *_ in rows
    ]
    axis.set_xticks(range(len(rows)), ticks)
    axis.set_ylabel(f"relative to {'an untuned' if results.untuned else 'the tuned'} PID")
    axis.set_ylim(0.0, highest * 1.06)
    legend(figure, axis)
    return figure


def drawn_plants(results: Results) -> Figure | None:
    """RMS errors of all drawn plants."""
    rows = results.select(plant="plants", bus=None)
    found = {
        name: rows.select(controller=name, plant=None, bus=None).values("position_rmse") * 1e3
        for name in rows.names("controller")
    }
    found = {name: values for name, values in found.items() if len(values)}
    if not found:
        return None
    figure = Figure(figsize=(PART, 3.8), layout="constrained")
    axis = figure.subplots()
    top = max(1.05, *(float(values.max()) for values in found.values()))
    edges = np.linspace(0.0, top, 41)
    for name, values in found.items():
        colour, line, _ = look(name)
        median = float(np.median(values))
        axis.hist(
            values,
            edges.tolist(),
            histtype="stepfilled" if len(found) == 1 else "step",
            color=colour,
            linestyle=line,
            linewidth=1.4,
            alpha=0.75,
            label=f"{name}: {len(values)} plants, median {median:.2f} mm",
        )
        axis.axvline(median, color=colour, linestyle=style.DASHES, linewidth=1.0)
    axis.axvline(1.0, color=style.VERMILION, linewidth=1.2, label="target for the median, 1.0 mm")
    axis.set_xlabel("RMS error against truth / mm")
    axis.set_ylabel("plants")
    legend(figure, axis)
    return figure
