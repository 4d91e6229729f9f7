"""Tensions as bars, and the full screen of `tonus ctl watch`."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from tonus.tools.cli.tension_bars import bar, bars


def _drawn(tensions: list[float]) -> str:
    console = Console(file=io.StringIO(), width=60)
    console.print(bars(tensions, 40))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


@pytest.mark.parametrize(
    ("share", "drawn"),
    [(0.0, ""), (1.0, "█" * 10), (0.5, "█" * 5), (0.0125, "▏"), (0.55, "█████▌")],
)
def test_a_bar_is_as_long_as_its_share(share: float, drawn: str) -> None:
    assert bar(share, 10) == drawn


def test_each_cable_has_its_line_on_a_common_scale() -> None:
    lines = _drawn([0.0, 45.0, 90.0, -0.1, 100.0, 12.0]).splitlines()
    assert len(lines) == 7
    assert "100 N for a whole bar" in lines[0]
    assert lines[5].count("█") == 40
    assert lines[3].count("█") == 36
    assert "█" not in lines[1]
    assert "█" not in lines[4]


def test_more_than_the_largest_scale_is_a_whole_bar() -> None:
    assert "900 N for a whole bar" in _drawn([900.0, 0.0])
