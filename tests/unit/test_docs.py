"""The documents that the code prints are the ones that lie in docs."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tonus.tools.report import states
from tonus.tools.report.signals import markdown

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_of_signals_is_the_one_the_topics_print() -> None:
    assert (ROOT / "docs" / "log.md").read_text() == markdown()


def test_the_page_of_states_is_the_one_the_table_prints() -> None:
    assert (ROOT / "docs" / "states.md").read_text() == states.markdown()


PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_page_points_to_a_file_that_is_not_there(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text()):
        assert (page.parent / target).exists(), f"{page.name} points to {target}"
