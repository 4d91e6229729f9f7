"""What a picture of a run needs to know: its log, its limits, and one time axis for all."""

from __future__ import annotations

import re

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import ValidationError

from config.schema.root import Config
from runtime.states import State
from tools.errors import ToolError
from tools.log import Log
from tools.summary import TRUTH, find_faults

Array = NDArray[np.float64]
_CYCLE = ("/tonus/timing", "/tonus/state", "/tonus/pose", "/tonus/stiffness")
_CYCLE_TOO = ("/tonus/wrench", "/tonus/tension", "/tonus/envelope")


class Story:
    """One run. Raises ToolError for a log that holds no control cycle."""

    def __init__(self, log: Log, config: Config | None = None) -> None:
        """``config``: instead of the one attached to the log."""
        missing = [topic for topic in (*_CYCLE, *_CYCLE_TOO) if topic not in log]
        if missing:
            raise ToolError(f"{log.path}: has no topic {missing[0]}; name a log of `tonus run`")
        counts = {len(log[topic]) for topic in (*_CYCLE, *_CYCLE_TOO)}
        if counts == {0}:
            raise ToolError(f"{log.path}: holds no cycle{_why(log)}")
        if len(counts) > 1:
            raise ToolError(f"{log.path}: its topics are of unlike length; recover it first")
        self.log = log
        self.note: str | None = None
        """why the limits are not known, None if they are"""
        self.config = config or self._attached()
        self._start = int(log.times("/tonus/timing")[0])
        self.time: Array = np.asarray((log.times("/tonus/timing") - self._start) * 1e-9, np.float64)
        """s (n,) of the cycles since the first"""
        self.faults = find_faults(log)
        self.has_truth = TRUTH in log and len(log[TRUTH]) > 0

    @property
    def period(self) -> float:
        """s from cycle to cycle, as most of them are apart."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else 1e-3

    @property
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
