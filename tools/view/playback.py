"""The clock of a playback: play, pause, speed, seek; for one log, or several aligned at START."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tonus.tools.view.moment import Happening, Moment, Samples
from tonus.tools.view.recorded import Recorded
from tonus.tools.view.settings import settings

SPEEDS = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
_BACK_S = 0.5


class Playback:
    """What logs hold at one common time, in s; 0 is the beginning of the earliest.

    `advance` is called in one thread; pages play, pause and seek in another, also while it reads.
    """

    speeds = SPEEDS

    def __init__(self, logs: Sequence[Recorded]) -> None:
        self.logs = list(logs)
        starts = [log.started_s() if len(logs) > 1 else 0.0 for log in logs]
        self._offsets = [max(starts) - start for start in starts]
        self.length_s = max(
            log.length_s + offset for log, offset in zip(logs, self._offsets, strict=True)
        )
        self.time_s, self.speed, self.playing = 0.0, 1.0, True
        self._shown_s = -1.0
        self._jumped = True
        self._lock = threading.Lock()
        self._events: list[tuple[int, list[Happening]]] = []

    def read_on(self) -> None:
        """Find the events, in a pass over every log; in another thread than `advance`."""
        for number, (log, offset) in enumerate(zip(self.logs, self._offsets, strict=True)):
            found = [replace(each, time_s=each.time_s + offset) for each in log.happenings()]
            with self._lock:
                self._events.append((number, found))

    def events(self) -> list[tuple[int, list[Happening]]]:
        """By number of their log, as far as they have been read."""
        with self._lock:
            return list(self._events)

    def play(self, *, playing: bool) -> None:
        """Go on, from the beginning where the end was reached; or pause."""
        with self._lock:
            if playing and self.time_s >= self.length_s:
                self.time_s, self._jumped = 0.0, True
            self.playing = playing

    def set_speed(self, speed: float) -> None:
        """The nearest one of `SPEEDS`."""
        self.speed = min(SPEEDS, key=lambda each: abs(each - speed))

    def seek(self, time_s: float) -> None:
        """Show another time; beyond the ends, the end."""
        with self._lock:
            self.time_s, self._jumped = float(min(max(time_s, 0.0), self.length_s)), True

    def advance(self, elapsed_s: float) -> list[Moment]:
        """One moment of each log, after ``elapsed_s`` of the watcher's time."""
        with self._lock:
            if self.playing:
                self.time_s = min(self.time_s + elapsed_s * self.speed, self.length_s)
                self.playing = self.time_s < self.length_s
            now, (jumped, self._jumped) = self.time_s, (self._jumped, False)
        since = now - settings().window_s if jumped else self._shown_s
        moments = [
            self._moment(log, offset, since, now, jumped)
            for log, offset in zip(self.logs, self._offsets, strict=True)
        ]
        self._shown_s = now
        return moments

    def _moment(
        self, log: Recorded, offset: float, since: float, now: float, jumped: bool
    ) -> Moment:
        samples = log.samples(since - offset, now - offset)
        if self.playing:
            log.prepare(now - offset)
        # Between two samples nothing comes, and the one before is shown still.
        at = samples or log.samples(now - offset - _BACK_S, now - offset)
        newest = at.rows[-1:]
        truth = at.truth[-1:] if at.truth is not None else np.empty(0, "V1")
        moved = Samples(samples.times + offset, samples.rows, samples.truth)
        return Moment(now, moved, newest, truth, jumped=jumped)

    def ahead(self, number: int, seconds: float) -> Samples:
        """What one log holds around this moment, this much either way."""
        log, now = self.logs[number], self.time_s - self._offsets[number]
        return log.samples(now - seconds, now + seconds)

    def close(self) -> None:
        """Let go of the logs."""
        for log in self.logs:
            log.close()
