"""Layouts for viewers: every line they draw is a signal of the log."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from click.testing import CliRunner

from tonus.runtime.signals import cycle_dtype
from tonus.tools.cli.log.layout import layout
from tonus.tools.log.layout import PAGES, VIEWERS, foxglove, plotjuggler

CYCLE = cycle_dtype(8)


def known() -> set[str]:
    """topic.field[element] of the cycle record."""
    names = set()
    for topic in CYCLE.names:
        fields = CYCLE[topic]
        for field in fields.names:
            shape = fields[field].shape
            elements = [f"[{i}]" for i in range(shape[0])] if shape else [""]
            names |= {f"/tonus/{topic}.{field}{element}" for element in elements}
    return names


def test_every_line_of_the_foxglove_layout_is_in_the_record() -> None:
    panels = json.loads(foxglove(8))["configById"]
    drawn = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    assert len(drawn) > 60
    assert set(drawn) <= known()


def test_every_panel_of_the_foxglove_layout_is_placed_once() -> None:
    document = json.loads(foxglove(8))

    def leaves(node: object) -> list[str]:
        if isinstance(node, str):
            return [node]
        return leaves(node["first"]) + leaves(node["second"])  # type: ignore[index]

    tabs = document["configById"]["Tab!pages"]["tabs"]
    placed = [leaf for tab in tabs for leaf in leaves(tab["layout"])]
    assert sorted([*placed, "Tab!pages"]) == sorted(document["configById"])


def test_every_curve_of_the_plotjuggler_layout_is_in_the_record() -> None:
    curves = [curve.get("name", "") for curve in ET.fromstring(plotjuggler(8)).iter("curve")]
    paths = {name.replace("/", ".", 3).replace(".", "/", 2) for name in curves}
    assert paths <= known()
    assert len(curves) == sum(1 for plots in PAGES.values() for p in plots for _ in p.series(8))


def test_lines_of_one_plot_differ_in_colour_up_to_eight() -> None:
    for area in ET.fromstring(plotjuggler(8)).iter("plot"):
        colours = [curve.get("color") for curve in area.iter("curve")][:8]
        assert len(set(colours)) == len(colours)
    assert np.all([len(plots) == 4 for plots in PAGES.values()])


@pytest.mark.parametrize("viewer", list(VIEWERS))
def test_the_command_writes_the_file_and_names_it(viewer: str, tmp_path: Path) -> None:
    out = tmp_path / "mine"
    found = CliRunner().invoke(layout, [viewer, "--out", str(out)])
    assert found.output.strip() == str(out)
    assert out.read_text() == VIEWERS[viewer][1](8)
