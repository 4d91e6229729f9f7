"""Layouts of plots for the viewers that open a run's log: Foxglove (and Lichtblick), PlotJuggler.

Both come from one table of plots whose signals are the cycle record's, so that no layout can name a
signal that is not there.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree as ET

from tonus.runtime.signals import TABLE

MARKERS, BASE = "/viewer/markers", "base"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#000000")
"""told apart by the colour-blind too (Okabe and Ito, Color Universal Design)"""
_FIELDS = {
    f"{topic.name.rsplit('/', 1)[1]}.{field.name}": field
    for topic in TABLE
    for field in topic.fields
}
_FOXGLOVE_COLUMNS = 2


@dataclass(frozen=True)
class Plot:
    """One diagram over time."""

    title: str
    signals: tuple[str, ...]
    """topic.field of the cycle record; arrays are drawn element by element"""

    def series(self, cables: int) -> Iterator[tuple[str, str, int | None]]:
        """(topic, field, element or None for a scalar) of each line."""
        for signal in self.signals:
            topic, field = signal.split(".")
            size = _FIELDS[signal].sized(cables).size
            for element in range(size) if size else (None,):
                yield f"/tonus/{topic}", field, element


PAGES: Mapping[str, tuple[Plot, ...]] = {
    "Motion": (
        Plot("position, m", ("pose.position", "pose.desired_position")),
        Plot("velocity, m/s", ("pose.velocity",)),
        Plot("stiffness, N/m", ("stiffness.k_eq", "stiffness.law", "stiffness.cap")),
        Plot("external force, N", ("wrench.external", "wrench.contact")),
    ),
    "Cables": (
        Plot("tension measured, N", ("tension.measured",)),
        Plot("tension reference, N", ("tension.reference",)),
        Plot("drum torque commanded, N m", ("drives.torque_command",)),
        Plot("drum rate, rad/s", ("drives.rate",)),
    ),
    "Safety": (
        Plot("state, grade, bound", ("state.state", "envelope.grade", "envelope.bound")),
        Plot("contact force, N", ("wrench.contact",)),
        Plot("energy, J", ("energy.tank", "energy.storage")),
        Plot("wrench deficit, N", ("wrench.deficit",)),
    ),
    "Timing": (
        Plot("wake-up, us", ("timing.wakeup_us",)),
        Plot("cycle, us", ("timing.collect_us", "timing.compute_us", "timing.publish_us")),
        Plot("missed ticks", ("timing.missed_own", "timing.missed_host")),
        Plot("age of measurements, ticks", ("drives.age", "force_cells.age")),
    ),
}


def foxglove(cables: int) -> str:
    """JSON for "Import from file" in Foxglove or Lichtblick: a tab a page, and the robot in 3-D."""
    panels: dict[str, Any] = {
        "3D!robot": {
            "followTf": BASE,
            "followMode": "follow-none",
            "topics": {MARKERS: {"visible": True}},
            "foxglovePanelTitle": "robot",
        }
    }
    tabs: list[dict[str, Any]] = [{"title": "Robot", "layout": "3D!robot"}]
    for page, plots in PAGES.items():
        names = []
        for number, plot in enumerate(plots):
            name = f"Plot!{page.lower()}{number}"
            panels[name] = _foxglove_plot(plot, cables)
            names.append(name)
        half = len(names) // _FOXGLOVE_COLUMNS
        columns = [_split(names[:half], "column"), _split(names[half:], "column")]
        tabs.append({"title": page, "layout": _split(columns, "row")})
    panels["Tab!pages"] = {"activeTabIdx": 0, "tabs": tabs}
    layout = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": "Tab!pages",
    }
    return json.dumps(layout, indent=2) + "\n"


def _foxglove_plot(plot: Plot, cables: int) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": plot.title,
        "paths": [
            {
                "value": f"{topic}.{field}" + ("" if element is None else f"[{element}]"),
                "label": _label(field, element),
                "color": colour,
                "enabled": True,
                "timestampMethod": "receiveTime",
            }
            for (topic, field, element), colour in _coloured(plot, cables)
        ],
        "xAxisVal": "timestamp",
        "showLegend": True,
        "legendDisplay": "floating",
        "isSynced": True,
    }


def _split(parts: Sequence[Any], direction: str) -> Any:
    """A binary tree of panels, as this format wants it, each of equal share."""
    if len(parts) == 1:
        return parts[0]
    return {
        "direction": direction,
        "first": parts[0],
        "second": _split(parts[1:], direction),
        "splitPercentage": 100.0 / len(parts),
    }


def plotjuggler(cables: int) -> str:
    """XML for "Load Layout" in PlotJuggler: a tab a page."""
    root = ET.Element("root")
    window = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    for page, plots in PAGES.items():
        tab = ET.SubElement(window, "Tab", tab_name=page, containers="1")
        container = ET.SubElement(tab, "Container")
        shares = ";".join([f"{1.0 / len(plots):.6f}"] * len(plots))
        splitter = ET.SubElement(
            container, "DockSplitter", orientation="-", count=str(len(plots)), sizes=shares
        )
        for plot in plots:
            area = ET.SubElement(splitter, "DockArea", name=plot.title)
            drawn = ET.SubElement(area, "plot", mode="TimeSeries", style="Lines")
            for (topic, field, element), colour in _coloured(plot, cables):
                name = f"{topic}/{field}" + ("" if element is None else f"[{element}]")
                ET.SubElement(drawn, "curve", name=name, color=colour)
    ET.SubElement(window, "currentTabIndex", index="0")
    ET.indent(root, " ")
    return "<?xml version='1.0' encoding='UTF-8'?>\n" + ET.tostring(root, "unicode") + "\n"


def _coloured(plot: Plot, cables: int) -> Iterator[tuple[tuple[str, str, int | None], str]]:
    for number, line in enumerate(plot.series(cables)):
        yield line, COLOURS[number % len(COLOURS)]


def _label(field: str, element: int | None) -> str:
    words = field.replace("_", " ")
    return words if element is None else f"{words} {element}"


VIEWERS: Mapping[str, tuple[str, Callable[[int], str]]] = {
    "foxglove": ("tonus.foxglove.json", foxglove),
    "plotjuggler": ("tonus.plotjuggler.xml", plotjuggler),
}
"""usual file name and maker, for so many cables, by viewer"""
