"""The run over time to look into: zoom, hover, hide a curve. It stands in the report's own page.

plotly draws it, which is in the extra `tonus[view]`; its script, some 5 MB, goes into the page, so
that it opens offline. The static picture stays beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib import import_module
from typing import Any

import numpy as np

from tonus.tools.errors import ToolError
from tonus.tools.report import style
from tonus.tools.report.pieces import Array
from tonus.tools.report.sheet import Sheet
from tonus.tools.report.story import Story

MISSING = (
    "plotly is not installed, so the report has static pictures only; "
    "for plots to zoom into: pip install 'tonus[view]'"
)
_DASHES = {"-": "solid", "--": "dash", ":": "dot"}
_PANEL_PX, _EVENTS_PX = 230, 110
_EVENTS = 500
"""marks of events"""
_NAME: dict[str, Any] = {
    "xref": "x",
    "y": 1,
    "yref": "paper",
    "showarrow": False,
    "textangle": -35,
    "xanchor": "left",
    "yanchor": "bottom",
    "font": {"size": 9},
}
_GAP = 0.012
"""of the height, between two panels"""
_NAME_SPACING, _LARGEST_SHIFT = 0.025, 0.08
"""of the width, between the names of two states, and by which one may be moved"""


def available() -> bool:
    """Whether plotly is installed."""
    try:
        import_module("plotly")
    except ImportError:
        return False
    return True


def interactive(story: Story, sheets: Sequence[Sheet]) -> str:
    """Sheets on one time axis below the run's events, as HTML with its script; safe to be put into
    a page: texts of the log are escaped. Raises ToolError without plotly."""
    if not available():
        raise ToolError(MISSING)
    graph, subplots = import_module("plotly.graph_objects"), import_module("plotly.subplots")
    heights = [_EVENTS_PX, *(_PANEL_PX for _ in sheets)]
    figure = subplots.make_subplots(
        rows=len(heights), cols=1, shared_xaxes=True, vertical_spacing=_GAP, row_heights=heights
    )
    figure.add_trace(_events(graph, story), row=1, col=1)
    figure.update_yaxes(title_text="events", showticklabels=False, range=(0, 2), row=1, col=1)
    named: set[str] = set()
    for row, sheet in enumerate(sheets, start=2):
        for trace in _traces(graph, sheet, named):
            figure.add_trace(trace, row=row, col=1)
        for label, value in sheet.limits.items():
            figure.add_hline(
                value,
                line={"color": "#404040", "width": 0.9, "dash": "dash"},
                annotation={"text": escape(label), "font": {"size": 9}},
                row=row,
                col=1,
            )
        figure.update_yaxes(title_text=sheet.label, range=sheet.range, row=row, col=1)
    figure.update_xaxes(range=(0.0, float(story.time[-1])))
    figure.update_xaxes(title_text="time since the first message / s", row=len(heights), col=1)
    figure.update_layout(
        height=sum(heights) + 120,
        template="plotly_white",
        hovermode="x unified",
        margin={"l": 70, "r": 10, "t": 90, "b": 50},
        legend={"groupclick": "togglegroup", "font": {"size": 10}},
        shapes=[*_bands(story), *(figure.layout.shapes or ()), *_faults(story)],
        annotations=[*(figure.layout.annotations or ()), *_names(story)],
    )
    html: str = figure.to_html(
        full_html=False,
        include_plotlyjs=True,
        div_id="interactive",
        config={"displaylogo": False, "responsive": True},
    )
    return html


def _events(graph: Any, story: Story) -> Any:
    """A mark for each; the state machine's own have bands."""
    events = story.log.events()[:_EVENTS]
    texts = [
        " ".join(escape(each) for each in (event.name, event.where, event.text) if each)
        for event in events
    ]
    return graph.Scatter(
        x=[story.seconds(event.time_ns) for event in events],
        y=[1.0] * len(events),
        mode="markers",
        marker={"symbol": "triangle-down", "size": 9, "color": style.VERMILION},
        text=texts,
        hovertemplate="%{text}<extra></extra>",
        name="events",
        showlegend=False,
    )


def _traces(graph: Any, sheet: Sheet, named: set[str]) -> list[Any]:
    """Curves and marks; those of one name are hidden and shown together, in all panels."""
    made = []
    for label, curve in sheet.curves.items():
        time, values = curve.points
        made.append(
            graph.Scatter(
                x=_short(time),
                y=_short(values),
                name=escape(label),
                mode="lines",
                line={"color": curve.colour, "width": curve.width, "dash": _DASHES[curve.line]},
                legendgroup=label,
                showlegend=label not in named,
                hovertemplate="%{y:.5g}",
            )
        )
        named.add(label)
    for label, marks in sheet.marks.items():
        times = np.concatenate(marks.times)
        made.append(
            graph.Scatter(
                x=_short(times),
                y=np.full(len(times), marks.level, np.float32),
                name=escape(f"{label} ({len(times)})"),
                mode="markers",
                marker={"symbol": "triangle-down", "size": 6, "color": marks.colour},
            )
        )
    return made


def _short(values: Array) -> Any:
    """Half the page's bytes; a tenth of a millisecond in ten minutes is not seen."""
    return values.astype(np.float32)


def _bands(story: Story) -> list[dict[str, Any]]:
    common = {"type": "rect", "xref": "x", "yref": "paper", "y0": 0, "y1": 1, "layer": "below"}
    return [
        {**common, "x0": start, "x1": end, "fillcolor": style.BANDS[state], "line": {"width": 0}}
        for state, start, end in story.bands
    ]


def _names(story: Story) -> list[dict[str, Any]]:
    """Of the states, moved apart where they would meet; without those that would be moved far."""
    span, placed = float(story.time[-1]) or 1.0, []
    last = -1.0
    for state, start, _ in story.bands:
        place = max(start / span, last + _NAME_SPACING)
        if place - start / span <= _LARGEST_SHIFT:
            placed.append((state, place * span))
            last = place
    return [
        {
            **_NAME,
            "x": at,
            "text": state.name,
        }
        for state, at in placed
    ]


def _faults(story: Story) -> list[dict[str, Any]]:
    line = {"color": style.VERMILION, "width": 1.2}
    times = [story.at(fault["tick"]) for fault in story.faults]
    common = {"type": "line", "xref": "x", "yref": "paper", "y0": 0, "y1": 1, "line": line}
    return [{**common, "x0": at, "x1": at} for at in times]
