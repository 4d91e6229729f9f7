"""The documents that the code prints are the ones that lie in docs."""

from __future__ import annotations

from pathlib import Path

from tonus.tools.report import commands, configuration, events, states
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
    assert (ROOT / "docs" / "configuration.md").read_text() == configuration.markdown()


def test_a_key_is_shown_with_the_limits_that_hold_for_it() -> None:
    """Two behind a validator of ours, under names that no JSON schema has, and a default."""
    page = configuration.markdown()
    assert "| `node_id` | whole number ≥ 1, ≤ 127 |  |  |" in page
    assert "| `duration` | number > 0 |  | s in ACTIVE |" in page
    assert "| `sign` | `1` or `-1` | `1` | which way the motor turns" in page
