"""The time axis of questions about a log: s since its first message."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tonus.runtime.recording.taps import Level
from tonus.tools.log.log import Event

_NS = 1_000_000_000
_AT_ONCE_NS = 10_000_000


@dataclass(frozen=True)
class Timeline:
    """``start_ns`` is the log_time of the log's first message."""

    start_ns: int

    def seconds(self, time_ns: int) -> float:
        """s since the log's first message."""
        return (time_ns - self.start_ns) / _NS

    def before(self, events: Sequence[Event], time: float) -> int:
        """How many of the events, which are in order of time, happened up to ``time`` s."""
        return sum(self.seconds(event.time_ns) <= time for event in events)

    def until(self, events: Sequence[Event], time: float) -> int:
        """How many of the events, which are in order of time, happened before ``time`` s."""
        return sum(self.seconds(event.time_ns) < time for event in events)

    def last(self, events: Sequence[Event], count: int) -> list[list[Event]]:
        """The last ``count`` of what was told: each an event, with those of its name that follow at
        once, as when one delay of the host concerns every node of a channel."""
        told: list[list[Event]] = []
        for event in reversed(events):
            again = told and told[-1][0].name == event.name
            if again and told[-1][0].time_ns - event.time_ns <= _AT_ONCE_NS:
                told[-1].insert(0, event)
            elif len(told) == count:
                break
            else:
                told.append([event])
        return told[::-1]

    def lines(self, events: Sequence[Event], count: int) -> list[str]:
        """`last`, each in a line."""
        return self.each(self.last(events, count))

    def each(self, told: Sequence[Sequence[Event]]) -> list[str]:
        """A line for each of what `last` gives."""
        found = []
        for first, *others in told:
            found.append(f"  {self.line(first)}" + (f"; {len(others)} more" if others else ""))
        return found

    def line(self, event: Event) -> str:
        """An event for a person: time, tick, level, name, place, text."""
        level = "" if event.level <= Level.INFO else f"{Level(event.level).name} "
        place = f" {event.where}" if event.where and event.where not in event.text else ""
        at = self.seconds(event.time_ns)
        return f"{at:9.3f} s  tick {event.tick:>6}  {level}{event.name}{place}: {event.text}"
