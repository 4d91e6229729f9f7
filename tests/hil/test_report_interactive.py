"""The interactive plots of a report: in its page, offline; a log's texts are no markup in them."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tests.loop import QUICK
from tonus.tools.cli.log.report import report as command
from tonus.tools.log import open as open_log
from tonus.tools.report import figures, interactive, panels
from tonus.tools.report.sheet import FINE
from tonus.tools.report.story import Story
from tonus.tools.report.thin import POINTS
from tonus.tools.testing.player import Player

pytestmark = [
    pytest.mark.tonus(config="config/direct.yaml", overrides=QUICK),
    pytest.mark.wide,
]

MARKUP = "</script><img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def log(tonus_shared_run: Player) -> Path:
    return tonus_shared_run("sine_x", duration=5.0).path


def test_without_plotly_the_page_is_as_before_and_one_line_says_how_to_get_more(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "plotly", None)
    out = tmp_path / "report.html"
    result = CliRunner().invoke(command, [str(log), "--out", str(out)])
    assert result.exit_code == 0
    assert result.stderr.splitlines() == [interactive.MISSING]
    assert "tonus[view]" in result.stderr
    text = out.read_text(encoding="utf-8")
    assert "<script" not in text
    assert 'id="time"' in text


def test_with_plotly_it_is_in_the_same_page_and_fetches_nothing(log: Path, tmp_path: Path) -> None:
    pytest.importorskip("plotly", reason="pip install tonus[view]")
    out = tmp_path / "report.html"
    result = CliRunner().invoke(command, [str(log), "--out", str(out)])
    assert (result.exit_code, result.stderr) == (0, "")
    text = out.read_text(encoding="utf-8")
    assert 'id="interactive"' in text
    assert 'id="time"' in text
    assert not re.findall(r"<(?:script|img|link)[^>]*(?:src|href)=[\"']?https?:", text)


def test_a_spike_of_one_tick_is_kept_in_a_long_run(log: Path) -> None:
    story = Story(open_log(log))
    (piece,) = story.pieces()
    (sheet,) = figures.filled([piece], (panels.tension,))
    assert len(piece.time) > 2 * POINTS
    for column, curve in zip(
        panels.tensions(piece.log).T, list(sheet.curves.values()), strict=True
    ):
        _, values = curve.points
        assert len(values) <= 2 * FINE * POINTS
        assert (np.nanmax(values), np.nanmin(values)) == (column.max(), column.min())


def test_texts_of_a_log_are_no_markup(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("plotly", reason="pip install tonus[view]")
    story = Story(open_log(log))
    events = [replace(event, text=MARKUP) for event in story.log.events()]
    monkeypatch.setattr(type(story.log), "events", lambda _: events)
    html = interactive.interactive(story, figures.filled(story.pieces(), (panels.force,)))
    assert MARKUP not in html
    assert "<img" not in html.rpartition("Plotly.newPlot(")[2]


def test_a_cable_is_hidden_in_every_panel_by_one_click(log: Path) -> None:
    graph = pytest.importorskip("plotly.graph_objects", reason="pip install tonus[view]")
    story = Story(open_log(log))
    named: set[str] = set()
    sheets = figures.filled(story.pieces(), (panels.tension, panels.tension_error))
    traces = [each for sheet in sheets for each in interactive._traces(graph, sheet, named)]
    (first, second) = (each for each in traces if each.legendgroup == "cable 1")
    assert (first.showlegend, second.showlegend) == (True, False)
