"""Bus events on their way to a person: bounded in number, and repeated ever more rarely."""

from __future__ import annotations

from collections.abc import Hashable

from drivers.fieldbus import BusEvent

CAPACITY = 256
"""Events kept between two calls of `take`; what does not fit is counted and said."""


class EventLog:
    """Collects events in the tick without letting a flood grow memory or the log."""

    def __init__(self) -> None:
        self._pending: list[BusEvent] = []
        self._dropped = 0
        self._counts: dict[Hashable, int] = {}
        self._episodes: set[Hashable] = set()

    def add(self, name: str, where: str, text: str) -> None:
        if len(self._pending) < CAPACITY:
            self._pending.append(BusEvent(name, where, text))
        else:
            self._dropped += 1

    def counted(self, name: str, where: str, text: str) -> None:
        """Report the 1st, 2nd, 4th, 8th ... occurrence of this name at this place.

        Beyond `CAPACITY` places all others of one name are counted together.
        """
        key: Hashable = (name, where)
        if key not in self._counts and len(self._counts) >= CAPACITY:
            key = name
        count = self._counts.get(key, 0) + 1
        self._counts[key] = count
        if count & (count - 1) == 0:
            self.add(name, where, text if count == 1 else f"{text} ({count} so far)")

    def begin(self, name: str, where: str, text: str) -> None:
        """Report once; again only after `end` of the same name and place."""
        if (name, where) not in self._episodes:
            self._episodes.add((name, where))
            self.counted(name, where, text)

    def end(self, name: str, where: str) -> bool:
        """True if there was an episode to end."""
        if self._episodes and (name, where) in self._episodes:
            self._episodes.remove((name, where))
            return True
        return False

    def take(self) -> list[BusEvent]:
        if not self._pending:
            return []
        taken, self._pending = self._pending, []
        if self._dropped:
            taken.append(BusEvent("dropped", "events", f"{self._dropped} more were not kept"))
            self._dropped = 0
        return taken
