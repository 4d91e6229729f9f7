"""The documents that the code prints are the ones that lie in docs."""

from __future__ import annotations

from pathlib import Path

from tonus.tools.report import commands, events, states
from tonus.tools.report.signals import markdown

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_of_signals_is_the_one_the_topics_print() -> None:
    assert (ROOT / "docs" / "log.md").read_text() == markdown()


def test_the_page_of_states_is_the_one_the_table_prints() -> None:
    assert (ROOT / "docs" / "states.md").read_text() == states.markdown()


def test_the_page_of_events_is_the_one_the_tables_print() -> None:
    assert (ROOT / "docs" / "events.md").read_text() == events.markdown()


def test_the_page_of_commands_is_the_one_the_commands_print() -> None:
    assert (ROOT / "docs" / "commands.md").read_text() == commands.markdown()
