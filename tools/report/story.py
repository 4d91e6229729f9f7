"""What a picture of a run needs to know: its log, its limits, and one time axis for all."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cached_property

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import ValidationError

from tonus.config.schema.root import Config
from tonus.runtime.states import State
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.report.pieces import CYCLE, Array, Piece, Progress, cut, outline
from tonus.tools.report.thin import POINTS
from tonus.tools.run.summary import find_faults

_PIECE = 30_000
"""cycles that are in memory with all their topics at once"""
_OWN = ("/tonus/timing", "/tonus/state")
_MISSED = ("missed_own", "missed_host")


class Story:
    """One run, as far as it has to be known whole; the rest of it comes in `pieces`.

    Raises ToolError for a log that holds no control cycle.
    """

    def __init__(
        self, log: Log, config: Config | None = None, progress: Progress = lambda _: None
    ) -> None:
        """``config``: instead of the one attached to the log."""
        missing = [topic for topic in CYCLE if topic not in log]
        if missing:
            raise ToolError(f"{log.path}: has no topic {missing[0]}; name a log of `tonus run`")
        self._whole = log
        log = outline(log, progress)
        counts = {len(log[topic]) for topic in _OWN}
        if counts == {0}:
            raise ToolError(f"{log.path}: holds no cycle{_why(log)}")
        if len(counts) > 1:
            raise ToolError(f"{log.path}: its topics are of unlike length; recover it first")
        self.log = log
        self.note: str | None = None
        """why the limits are not known, None if they are"""
        self.config = config or self._attached()
        self._start = self._whole.start_ns
        self.time: Array = np.asarray((log.times("/tonus/timing") - self._start) * 1e-9, np.float64)
        """s (n,) of the cycles since the log's first message, as `tonus log info` has them"""
        self.faults = find_faults(log)
        self.has_truth = False
        """known when the pieces are"""
        timing = log["/tonus/timing"]
        self._missed = {
            name: np.diff(timing[name].astype(np.int64), prepend=0) > 0 for name in _MISSED
        }

    @cached_property
    def period(self) -> float:
        """s from cycle to cycle, as most of them are apart."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else 1e-3

    def pieces(self, progress: Progress = lambda _: None) -> Iterator[Piece]:
        """All cycles in order, read as they are asked for."""
        count = len(self.time)
        for first in range(0, count, _PIECE):
            last = min(first + _PIECE, count)
            piece = self._piece(first, last, -(-POINTS * (last - first) // count))
            self.has_truth |= piece.has_truth
            yield piece
            progress(last / count)

    def near(self, start_s: float, end_s: float) -> Piece:
        """The cycles between two times in s; keep them few."""
        first = min(int(np.searchsorted(self.time, start_s)), len(self.time) - 1)
        last = int(np.searchsorted(self.time, end_s, "right"))
        return self._piece(first, max(last, first + 1), POINTS)

    def _piece(self, first: int, last: int, points: int) -> Piece:
        times = self.log.times("/tonus/timing")
        part = cut(self._whole, int(times[first]), int(times[last - 1]) + 1)
        if len(part["/tonus/timing"]) != last - first:
            raise ToolError(f"{self.log.path}: its cycles are not in order; recover it first")
        missed = {name: rises[first:last] for name, rises in self._missed.items()}
        return Piece(part, self.config, self.time[first:last], self.period, missed, points)

    @cached_property
    def bands(self) -> list[tuple[State, float, float]]:
        """State, from and to in s."""
        state = self.log["/tonus/state"]["state"]
        entered = np.flatnonzero(np.diff(state.astype(np.int16), prepend=-1) != 0)
        ends = [*self.time[entered[1:]].tolist(), float(self.time[-1])]
        return [
            (State(int(state[index])), float(self.time[index]), end)
            for index, end in zip(entered, ends, strict=True)
        ]

    def in_state(self, *states: State) -> NDArray[np.bool_]:
        """(n,) which cycles ran in one of these."""
        return np.isin(self.log["/tonus/state"]["state"], states)

    def at(self, tick: int) -> float:
        """s of a tick on the common time axis."""
        ticks = self.log["/tonus/timing"]["tick"]
        return float(self.time[min(int(np.searchsorted(ticks, tick)), len(ticks) - 1)])

    def seconds(self, time_ns: int) -> float:
        """s of a log_time on the common time axis."""
        return (time_ns - self._start) * 1e-9

    def _attached(self) -> Config | None:
        text = self.log.config_text
        if text is None:
            self.note = "no configuration is attached"
            return None
        try:
            return Config.model_validate(yaml.safe_load(text))
        except (yaml.YAMLError, ValidationError):
            self.note = "the attached configuration is not one that this version reads"
            return None


def _why(log: Log) -> str:
    damage = re.sub(r"\s+", " ", log.damage or "")
    return f": {damage}; nothing can be shown" if damage else "; nothing can be shown"
