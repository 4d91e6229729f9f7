"""Keyframes of a running cycle: one now and then, written a step a tick."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Protocol

from tonus.runtime.recording.keyframe import Keyframe, KeyframeError


class KeyframeSink(Protocol):
    """Where the cycle's state goes now and then."""

    def __call__(self, stamp_ns: int, tick: int, state: bytes) -> None: ...


class KeyframeKeeper:
    """Takes a keyframe of ``owner``, handed over before its first tick, every so many ticks."""

    def __init__(self, owner: object, sink: KeyframeSink, ticks: int) -> None:
        self._keyframe, self._sink, self._ticks = Keyframe(owner), sink, ticks
        self._due = 0
        self._kept: tuple[int, int, Iterator[bytes]] | None = None
        self._prepared: bytes | None = None
        """what `now` hands over, as long as no tick has come since"""

    def prepare(self) -> None:
        """Write down what `now` will hand over, unless a tick comes before: forks of a process that
        stands between two ticks then share it. A state that cannot be kept is left to `now`."""
        with suppress(KeyframeError):
            self._prepared = self._keyframe.take()

    def now(self, due_ns: int, tick: int) -> None:
        """The whole keyframe at once, after ``tick``, where no tick waits for it. Raises
        `KeyframeError`."""
        self._kept, self._due = None, tick + self._ticks
        self._sink(due_ns, tick, self._prepared or self._keyframe.take())

    def __call__(self, due_ns: int, tick: int) -> None:
        """At the end of each tick; the whole keyframe at once would overrun one."""
        self._prepared = None
        if self._kept is None:
            if tick < self._due:
                return
            self._due = tick + self._ticks
            self._kept = (due_ns, tick, self._keyframe.steps())
        seen_ns, seen_in, steps = self._kept
        try:
            data = next(steps)
        except Exception:
            self._kept = None
            raise
        if data:
            self._kept = None
            self._sink(seen_ns, seen_in, data)
