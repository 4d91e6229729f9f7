"""A firewall between control and the code that runs beside it in the tick: reports, self-test,
record, keyframes, control socket. An exception there is a counted event, and control goes on.

A part that fails in every call is switched off. The traceback is written after the run: to format
one takes longer than a tick has.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import TypeVar, TypeVarTuple

from tonus.drivers.events import Meaning
from tonus.drivers.fieldbus import BusEvent

Arguments = TypeVarTuple("Arguments")
Result = TypeVar("Result")

EVENTS: dict[str, Meaning] = {
    "part_failed": Meaning(
        "an exception in code that runs beside control; which part, type and text",
        "counted; control goes on without what the part would have done",
        "read the traceback in the process's log; report it with the log",
    ),
    "part_off": Meaning(
        "a part failed in every call, operation.firewall.failures times in a row",
        "it is not called again in this run; control goes on",
        "read the traceback in the process's log; restart the daemon to use the part again",
    ),
}
_LINE = 300
"""characters of an exception's text in an event"""


def _nobody() -> None:
    """Who asks a part for its events each time."""


class Part:
    """Calls the code of one part; gives None where it raised or is switched off."""

    def __init__(
        self, name: str, limit: int, *, lasting: bool = False, told: Callable[[], None] = _nobody
    ) -> None:
        """``limit``: failures in a row after which it counts as ``failing``, and is switched off
        unless it is ``lasting``; ``told``: called with each failure."""
        self.name = name
        self.failures = 0
        """in all"""
        self.failing = self.off = False
        self.first: Exception | None = None
        self._limit, self._lasting, self._row = limit, lasting, 0
        self._events: list[BusEvent] = []
        self._told = told

    def call(self, action: Callable[[*Arguments], Result], *arguments: *Arguments) -> Result | None:
        """``action(*arguments)``. Not as ``part(...)``, which takes twice as long."""
        if self.off:
            return None
        try:
            result = action(*arguments)
        except Exception as error:  # noqa: BLE001 - whatever it is, control goes on
            self.failed(error)
            return None
        self._row = 0
        return result

    def failed(self, error: Exception) -> None:
        """Count it; the first, second, fourth, eighth ... is reported."""
        self.first = self.first or error
        self._told()
        self.failures += 1
        self._row += 1
        if self.failures & (self.failures - 1) == 0:
            text = f"{in_one_line(error)}; failure {self.failures}, control goes on without it"
            self._events.append(BusEvent("part_failed", self.name, text))
        if self._row < self._limit:
            return
        self.failing = True
        if not self._lasting:
            self.off = True
            text = f"switched off after {self._row} failures in a row: {in_one_line(error)}"
            self._events.append(BusEvent("part_off", self.name, text))

    def take_events(self) -> list[BusEvent]:
        """Events since the last call."""
        events, self._events = self._events, []
        return events


class Firewall:
    """Every part of one daemon."""

    def __init__(self, failures: int) -> None:
        """``failures`` in a row switch a part off."""
        self._failures = failures
        self._parts: list[Part] = []
        self._failed = False
        """a part, since events were taken"""

    def _told(self) -> None:
        self._failed = True

    def part(self, name: str, *, lasting: bool = False) -> Part:
        """A new part; a ``lasting`` one is called again however often it fails."""
        part = Part(name, self._failures, lasting=lasting, told=self._told)
        self._parts.append(part)
        return part

    def take_events(self) -> list[BusEvent]:
        """Of every part; empty almost always."""
        if not self._failed:
            return []
        self._failed = False
        return [event for part in self._parts for event in part.take_events()]

    def tracebacks(self) -> str:
        """Of the first failure of each part, for the process' log; empty: nothing failed."""
        texts = []
        for part in self._parts:
            if part.first is not None:
                lines = traceback.format_exception(part.first)
                texts.append(f"{part.name} failed {part.failures} times, at first:\n")
                texts.append("".join(lines))
        return "".join(texts)


def in_one_line(error: Exception) -> str:
    """Type and text; an exception may have any text, or fail to give one."""
    try:
        text = " ".join(str(error).split())[:_LINE]
    except Exception:  # noqa: BLE001 - see above
        text = "its text is not available"
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
