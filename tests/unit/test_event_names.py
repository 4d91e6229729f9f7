"""Every event name that the daemon and its tools can write is in the table of events."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from tonus import runtime, tools
from tonus.drivers import events as drivers
from tonus.runtime.events import EVENTS
from tonus.runtime.recording.taps import Level
from tonus.runtime.safety import firewall
from tonus.runtime.signals import Consistency
from tonus.tools.report.events import every, faults

_FORMED = {
    "name": "handed on by a function that takes level and name",
    "event.name": "of a driver or the firewall, which have tables of their own",
    "fault.name.lower()": "a fault",
    "f'pose_{consistency.name.lower()}'": "a consistency",
}
"""Names that are not written out, as they stand in the code."""


def events_in(tree: ast.AST) -> Iterator[ast.expr]:
    """The argument behind the level in every call that has one: the event's name."""
    for call in ast.walk(tree):
        if not isinstance(call, ast.Call):
            continue
        for level, name in zip(call.args, call.args[1:], strict=False):
            if ast.unparse(level) in {"level", *(f"Level.{each.name}" for each in Level)}:
                yield name


def written() -> tuple[set[str], set[str]]:
    """The names that are written out, and the expressions that form the others."""
    names, formed = set(), set()
    for package in (runtime, tools):
        for path in Path(str(package.__file__)).parent.rglob("*.py"):
            for name in events_in(ast.parse(path.read_text())):
                if isinstance(name, ast.Constant):
                    names.add(str(name.value))
                else:
                    formed.add(ast.unparse(name))
    return {name for name in names if len(name) > 1}, formed  # 'v' is a marker of a plot


def test_the_table_has_every_event_and_no_other() -> None:
    names, formed = written()
    assert formed == set(_FORMED)
    assert names | {f"pose_{each.name.lower()}" for each in Consistency} == set(EVENTS)


def test_an_event_under_a_new_name_would_be_found() -> None:
    tree = ast.parse("sink(stamp, tick, Level.ERROR, 'new', '', text); log(level, 'newer')")
    assert [ast.literal_eval(name) for name in events_in(tree)] == ["new", "newer"]


def test_no_name_has_two_meanings() -> None:
    tables = (EVENTS, faults(), drivers.EVENTS, firewall.EVENTS)
    assert len(every()) == sum(map(len, tables))


def test_every_event_but_good_news_says_what_a_person_should_do() -> None:
    without = {name for name, each in every().items() if not each.remedy}
    assert without == {
        *("state", "operator", "tuned", "drums_observed", "tracker_back", "pose_good"),
        *("recording_resumed", "heartbeat_back", "operational_again", "recovered"),
        "supervisor_back",
        *("bus_recovered", "ring_closed", "slave_recovered"),
    }
