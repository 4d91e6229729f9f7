"""docs/fmea.md is held to the code: every fault and event has a row, every named test exists."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from tonus import runtime, tools
from tonus.drivers.events import EVENTS
from tonus.runtime.safety import firewall
from tonus.runtime.signals import Consistency
from tonus.runtime.states import Fault

TESTS = Path(__file__).resolve().parents[1]
PAGE = (TESTS.parent / "docs" / "fmea.md").read_text()
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAGE.splitlines()
    if line.startswith("|") and not line.startswith(("|---", "| failure "))
]
_NO_FAILURE = {"operator", "state", "signal"}
"""Events that tell of commands and of the machine's way."""


def named() -> set[str]:
    return {name for row in ROWS for name in re.findall(r"`(\w+)`", row[1] + row[2])}


def events_of_the_daemon() -> set[str]:
    """Names given to `_emit`, `_tell`, `note` and `event`, where they are written out."""
    names = set()
    for package in (runtime, tools):
        for path in Path(str(package.__file__)).parent.rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
                    continue
                at = {"_emit": 2, "_tell": 1, "note": 1, "event": 1}.get(node.func.attr)
                if at is None or len(node.args) <= at:
                    continue
                name = node.args[at]
                if isinstance(name, ast.Constant) and isinstance(name.value, str):
                    names.add(name.value)
    return names | {f"pose_{each.name.lower()}" for each in Consistency}


def test_every_fault_has_a_row() -> None:
    assert {fault.name for fault in Fault} - {"NONE"} <= named()


def test_every_event_of_a_driver_has_a_row() -> None:
    assert set(EVENTS) <= named()


def test_every_event_of_the_firewall_has_a_row() -> None:
    assert set(firewall.EVENTS) <= named()


def test_every_event_of_the_daemon_has_a_row() -> None:
    found = events_of_the_daemon()
    assert {"refused", "tracker_lost", "recorder_lost", "daemon_lost"} <= found
    assert found - _NO_FAILURE <= named()


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
