"""docs/fmea.md is held to the code: every fault and event has a row, every named test exists."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from tonus.drivers.events import EVENTS
from tonus.runtime import events
from tonus.runtime.safety import firewall
from tonus.runtime.states import Fault

TESTS = Path(__file__).resolve().parents[1]
PAGE = (TESTS.parent / "docs" / "fmea.md").read_text()
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAGE.splitlines()
    if line.startswith("|") and not line.startswith(("|---", "| failure "))
]
_NO_FAILURE = {"operator", "state", "signal", "tuned"}
"""Events that tell of commands and of the machine's way."""


def named() -> set[str]:
    return {name for row in ROWS for name in re.findall(r"`(\w+)`", row[1] + row[2])}


def test_every_fault_has_a_row() -> None:
    assert {fault.name for fault in Fault} - {"NONE"} <= named()


def test_every_event_of_a_driver_has_a_row() -> None:
    assert set(EVENTS) <= named()


def test_every_event_of_the_firewall_has_a_row() -> None:
    assert set(firewall.EVENTS) <= named()


def test_every_event_of_the_daemon_has_a_row() -> None:
    assert set(events.EVENTS) - _NO_FAILURE <= named()


def test_every_row_is_complete_and_names_a_test_that_exists() -> None:
    assert len(ROWS) > 30
    files = {path.name: path for path in TESTS.rglob("test_*.py")}
    for row in ROWS:
        assert len(row) == 5, row
        assert all(row), row
        for place in row[4].split(", "):
            file, _, name = place.partition("::")
            assert file in files, place
            functions = {
                node.name
                for node in ast.walk(ast.parse(files[file].read_text()))
                if isinstance(node, ast.FunctionDef)
            }
            assert name in functions, place
