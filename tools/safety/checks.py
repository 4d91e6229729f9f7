"""What does not agree in the safety evidence: one line for each finding, with its remedy."""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence

from tonus.runtime import events as daemon
from tonus.runtime.states import Fault
from tonus.tools.errors import ToolError
from tonus.tools.report.events import every
from tonus.tools.safety.budget import seconds
from tonus.tools.safety.schema import Failure
from tonus.tools.safety.source import Evidence

NO_FAILURE = {"operator", "state", "signal", "tuned"}
"""Events of commands and of the state machine, which need no row."""
TestsByFile = Mapping[str, Sequence[str]]


def findings(evidence: Evidence, tests: TestsByFile) -> list[str]:
    """All that is missing or unknown; empty: hazards, controls, requirements, failures and tests
    agree both ways. ``tests``: the existing ones, as `collect_tests` finds them."""
    return [
        *_hazards(evidence),
        *_controls(evidence),
        *_requirements(evidence, tests),
        *_failures(evidence, tests),
        *_events(evidence),
        *_untraced(evidence, tests),
    ]


def _hazards(evidence: Evidence) -> Iterator[str]:
    for name, hazard in evidence.hazards.items():
        if not hazard.controls:
            yield f"{name} has no control; name one in its controls"
        yield from _unknown(name, hazard.controls, evidence.controls)
    count = Counter(name for each in evidence.hazards.values() for name in each.situations)
    for name, times in count.items():
        if times > 1:
            yield f"{name} belongs to {times} hazards; choose the next number"
    led_to = {name for row in evidence.rows for name in row.leads_to}
    for name in evidence.situations:
        if name not in led_to:
            yield f"{name} has no failure that leads to it; add a row, or remove the situation"


def _controls(evidence: Evidence) -> Iterator[str]:
    used = {name for hazard in evidence.hazards.values() for name in hazard.controls}
    for name, control in evidence.controls.items():
        if not control.requirements:
            yield f"{name} has no requirement; name one in its requirements"
        if name not in used:
            yield f"{name} controls no hazard; name it in a hazard's controls, or remove it"
        yield from _unknown(name, control.requirements, evidence.requirements)


def _requirements(evidence: Evidence, tests: TestsByFile) -> Iterator[str]:
    used = {name for control in evidence.controls.values() for name in control.requirements}
    for name, requirement in evidence.requirements.items():
        if not any(requirement.tests.values()):
            yield f"{name} has no test; name one in its tests"
        if name not in used:
            yield f"{name} belongs to no control; name it in a control's requirements"
        yield from _missing(name, requirement.tests, tests)


def _failures(evidence: Evidence, tests: TestsByFile) -> Iterator[str]:
    known_events = {*every(), *(fault.name for fault in Fault)}
    for name, times in Counter(row.id for row in evidence.rows).items():
        if times > 1:
            yield f"{name} is the id of {times} rows; choose the next number"
    for row in evidence.rows:
        yield from _unknown(row.id, row.leads_to, evidence.situations)
        yield from _unknown(row.id, row.requirements, evidence.requirements)
        yield from _unknown(row.id, words(row), known_events)
        yield from _missing(row.id, row.tests, tests)
        if row.within is not None:
            try:
                seconds(row.within)
            except ToolError as error:
                yield f"{row.id}: within: {error}"


def _events(evidence: Evidence) -> Iterator[str]:
    """Every fault and every event of a failure has a row."""
    named = {name for row in evidence.rows for name in words(row)}
    faults = {fault.name for fault in Fault} - {"NONE"}
    lower = {fault.lower() for fault in faults}
    assert set(daemon.EVENTS) >= NO_FAILURE
    for name in sorted((faults | set(every())) - lower - NO_FAILURE - named):
        yield f"{name} has no row; name it in noticed of the failure that it detects"


def _untraced(evidence: Evidence, tests: TestsByFile) -> Iterator[str]:
    traced = {
        (file, name)
        for requirement in evidence.requirements.values()
        for file, names in requirement.tests.items()
        for name in names
    }
    for file in evidence.safety_path:
        if file not in tests:
            yield f"safety_path: there is no file {file}; {_near(file, tests)}"
        for name in tests.get(file, ()):
            if (file, name) not in traced:
                yield f"{file}::{name} belongs to no requirement; name it in the tests of one"


def words(row: Failure) -> list[str]:
    """The events and faults that a row names; a word with a dot is a key of the configuration."""
    return re.findall(r"`(\w+)`", row.noticed)


def _unknown(place: str, names: Collection[str], known: Collection[str]) -> Iterator[str]:
    for name in names:
        if name not in known:
            yield f"{place}: there is no {name}; {_near(name, known)}"


def _missing(place: str, named: Mapping[str, Collection[str]], tests: TestsByFile) -> Iterator[str]:
    for file, names in named.items():
        if file not in tests:
            yield f"{place}: there is no file {file} of tests; {_near(file, tests)}"
            continue
        for name in names:
            if name not in tests[file]:
                yield f"{place}: {file} has no {name}; {_near(name, tests[file])}"


def _near(name: str, known: Collection[str]) -> str:
    found = difflib.get_close_matches(name, list(known), n=1)
    return f"did you mean {found[0]}?" if found else "correct or remove it"
