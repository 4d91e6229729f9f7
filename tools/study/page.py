"""A study as one page that needs no network: means with their confidence, plots, every run."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib import import_module
from pathlib import Path
from typing import Any

from tonus.config.schema.parameter_study import ParameterStudy
from tonus.tools.draft import write_whole
from tonus.tools.pages.page import page
from tonus.tools.pages.rows import Rows
from tonus.tools.report.interactive import available
from tonus.tools.study.groups import ROBOT, Group, differences, groups, number, short, told
from tonus.tools.study.play import COMPLETED, Row
from tonus.tools.study.trials import trials

_HEIGHT = 420
_MOST_ROWS = 2000
"""runs in the page's table; the Parquet file has all"""


def write_page(study: ParameterStudy, rows: Sequence[Row], folder: Path) -> Path:
    """``index.html`` in ``folder``."""
    path = folder / "index.html"
    found = groups(study, rows)
    bad = sum(group.bad for group in found)
    over = "the robots, each over its seeds" if ROBOT in study.parameters else "the seeds"
    one = study.seeds == 1 or (isinstance(study.seeds, tuple) and len(study.seeds) == 1)
    sure = "one each, so without a confidence" if one else "with 95 % confidence"
    text = page(
        "study.html.j2",
        f"Study {study.name}",
        subtitle=study.description,
        facts=f"{len(rows)} of {len(trials(study))} runs, {bad} not completed; "
        f"means over {over}, {sure}",
        means=_means(study, found),
        differences=_means(study, differences(study, rows)),
        plots=_plots(study, found, rows),
        runs=_runs(study, rows),
    )
    write_whole(path, text)
    return path


def _means(study: ParameterStudy, found: Sequence[Group]) -> Rows:
    labels = list(found[0].labels) if found else []
    shown = dict.fromkeys([*study.shown, *study.indicators, *study.measures])
    lines = []
    for group in found:
        cells = [number(group.labels[label]) for label in labels]
        cells += [told(group, figure) for figure in shown]
        lines.append([*cells, str(len(group.rows)), str(group.bad)])
    heads = [*labels, *shown, "runs", "not completed"]
    return Rows.of(heads, lines, range(len(labels), len(heads)))


def _runs(study: ParameterStudy, rows: Sequence[Row]) -> Rows:
    heads = ["run", "seed", *short(study).values(), *study.shown, "verdict", "repeat with"]
    lines = []
    for row in rows[:_MOST_ROWS]:
        values = [row["parameters"][key] for key in study.parameters]
        figures = [row[figure] for figure in study.shown]
        cells = [str(row["index"]), str(row["seed"]), *map(number, values)]
        verdict = row["verdict"]
        if verdict != COMPLETED:
            verdict += f": {row['reason']}"
        lines.append([*cells, *map(number, figures), verdict, row["command"]])
    told = Rows.of(heads, lines, range(2 + len(study.parameters) + len(study.shown)))
    if len(rows) > _MOST_ROWS:
        told.notes.append(f"The first {_MOST_ROWS} of {len(rows)}; the table has all.")
    return told


def _plots(study: ParameterStudy, found: Sequence[Group], rows: Sequence[Row]) -> list[str]:
    """Each as HTML; the first one brings plotly's script. Nothing without plotly."""
    if not available() or not found:
        return []
    graph = import_module("plotly.graph_objects")
    figures: list[Any] = []
    names = short(study)
    settings = [key for key in study.parameters if key != ROBOT]
    numeric = [key for key in settings if all(map(_is_number, _column(rows, key)))]
    drawn = study.drawn is not None
    for name in study.shown:
        if drawn:  # hardly two samples have a value in common
            figures.extend(_scatter(graph, name, key, rows) for key in numeric)
            continue
        figures.extend(_lines(graph, name, key, names[key], found) for key in numeric)
        if len(numeric) >= 2:
            figures.append(_heat(graph, name, numeric[0], numeric[1], rows))
        figures.append(_spread(graph, name, found))
    if numeric:
        figures.append(_parallel(graph, study, numeric, rows))
    if study.pareto is not None:
        figures.append(_front(graph, study.pareto, found))
    told = []
    for place, figure in enumerate(figures):
        figure.update_layout(height=_HEIGHT, margin={"t": 48, "b": 48}, template="plotly_white")
        # Names of its own would be drawn at random, and the page differ each time.
        name = f"plot{place}"
        told.append(figure.to_html(full_html=False, include_plotlyjs=place == 0, div_id=name))
    return told


def _column(rows: Sequence[Row], key: str) -> list[Any]:
    return [row["parameters"][key] for row in rows]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _lines(graph: Any, name: str, key: str, label: str, found: Sequence[Group]) -> Any:
    """A line for each setting of everything else."""
    lines: dict[str, list[tuple[float, Group]]] = {}
    for group in found:
        rest = ", ".join(f"{k} {number(v)}" for k, v in group.labels.items() if k != label)
        lines.setdefault(rest, []).append((group.labels[label], group))
    figure = graph.Figure()
    for rest, points in lines.items():
        there = [(x, mean) for x, g in sorted(points, key=lambda p: p[0]) if (mean := g.mean(name))]
        figure.add_trace(
            graph.Scatter(
                x=[x for x, _ in there],
                y=[mean.value for _, mean in there],
                error_y={"type": "data", "array": [mean.half or 0.0 for _, mean in there]},
                name=escape(rest),
                mode="lines+markers",
            )
        )
    return figure.update_layout(title=f"{name} over {key}", xaxis_title=key, yaxis_title=name)


def _scatter(graph: Any, name: str, key: str, rows: Sequence[Row]) -> Any:
    good = [row for row in rows if row["verdict"] == COMPLETED and row[name] is not None]
    points = graph.Scatter(
        x=_column(good, key),
        y=[row[name] for row in good],
        text=[f"run {row['index']}, seed {row['seed']}" for row in good],
        mode="markers",
    )
    figure = graph.Figure(points)
    return figure.update_layout(title=f"{name} over {key}", xaxis_title=key, yaxis_title=name)


def _heat(graph: Any, name: str, across: str, down: str, rows: Sequence[Row]) -> Any:
    """Means over everything else."""
    cells: dict[tuple[float, float], list[float]] = {}
    for row in rows:
        if row["verdict"] == COMPLETED and row[name] is not None:
            place = row["parameters"][across], row["parameters"][down]
            cells.setdefault(place, []).append(row[name])
    x, y = sorted({a for a, _ in cells}), sorted({d for _, d in cells})
    means = {place: sum(values) / len(values) for place, values in cells.items()}
    z = [[means.get((a, d)) for a in x] for d in y]
    figure = graph.Figure(graph.Heatmap(x=list(map(str, x)), y=list(map(str, y)), z=z))
    return figure.update_layout(title=f"{name}, mean", xaxis_title=across, yaxis_title=down)


def _spread(graph: Any, name: str, found: Sequence[Group]) -> Any:
    figure = graph.Figure()
    for group in found:
        label = ", ".join(f"{key} {number(value)}" for key, value in group.labels.items()) or "all"
        figure.add_trace(graph.Box(y=group.values(name), name=escape(label), boxpoints="all"))
    return figure.update_layout(title=f"{name} by seed", yaxis_title=name, showlegend=False)


def _parallel(graph: Any, study: ParameterStudy, numeric: list[str], rows: Sequence[Row]) -> Any:
    good = [row for row in rows if row["verdict"] == COMPLETED]
    good = [row for row in good if all(row[name] is not None for name in study.shown)]
    names = short(study)
    axes = [{"label": names[key], "values": _column(good, key)} for key in numeric]
    axes += [{"label": name, "values": [row[name] for row in good]} for name in study.shown]
    shade = [row[study.shown[0]] for row in good] if study.shown else None
    figure = graph.Figure(graph.Parcoords(dimensions=axes, line={"color": shade}))
    return figure.update_layout(title="every completed run")


def _front(graph: Any, pair: tuple[str, str], found: Sequence[Group]) -> Any:
    points = []
    for group in found:
        means = group.mean(pair[0]), group.mean(pair[1])
        if means[0] is not None and means[1] is not None:
            label = ", ".join(f"{key} {number(value)}" for key, value in group.labels.items())
            points.append((means[0].value, means[1].value, escape(label)))
    best = sorted(point for point in points if not any(_beats(each, point) for each in points))
    figure = graph.Figure()
    shown = (("all", points, "markers"), ("Pareto", best, "lines+markers"))
    for name, chosen, mode in shown:
        x, y, text = ([each[i] for each in chosen] for i in range(3))
        figure.add_trace(graph.Scatter(x=x, y=y, text=text, name=name, mode=mode))
    return figure.update_layout(
        title=f"{pair[0]} and {pair[1]}", xaxis_title=pair[0], yaxis_title=pair[1]
    )


def _beats(one: tuple[float, float, str], other: tuple[float, float, str]) -> bool:
    return one[0] <= other[0] and one[1] <= other[1] and one[:2] != other[:2]
