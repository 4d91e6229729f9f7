"""The table of events is complete: every name a driver tells is in it, and none is in vain."""

from __future__ import annotations

import ast
from pathlib import Path

from tonus import drivers
from tonus.drivers.events import EVENTS

_TELLS = {"add", "counted", "begin"}


def told() -> set[str]:
    """First arguments of every call that tells an event, in all drivers."""
    names = set()
    for path in Path(drivers.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                first = node.args[0] if node.args else None
                if node.func.attr in _TELLS and isinstance(first, ast.Constant):
                    names.add(str(first.value))
    return names


def test_every_event_a_driver_tells_is_in_the_table_and_every_entry_is_told() -> None:
    # Two names are told through a variable: PDOs of the wrong length, and what was dropped.
    assert told() | {"short_pdo", "long_pdo", "dropped"} == set(EVENTS)


def test_every_event_has_a_meaning() -> None:
    for name, entry in EVENTS.items():
        assert entry.meaning, name
        assert not entry.meaning.endswith(".")
