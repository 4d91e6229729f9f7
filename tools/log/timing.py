"""A run's timing held against budgets: the same for the lab and for the robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.budget import COUNTS, Budget, Limit
from tonus.runtime.states import State
from tonus.tools.errors import ToolError
from tonus.tools.log.log import Log

Array = NDArray[np.float64]
_HOST = ("wakeup_us", "collect_us", "compute_us", "publish_us", "cycle_us", "processor_us")
"""figures of a host, which a log in virtual time has none of"""
_NEEDED = ("/tonus/timing", "/tonus/state", "/tonus/drives", "/tonus/force_cells")


@dataclass(frozen=True)
class Line:
    """One limit, judged."""

    limit: Limit
    value: float | None
    """None where the log has no such figure"""

    @property
    def passed(self) -> bool | None:
        return None if self.value is None else self.value <= self.limit.at_most

    @property
    def statistic(self) -> str:
        at = self.limit.at
        return at.replace("_", " ") if isinstance(at, str) else f"p{at:g}"


@dataclass(frozen=True)
class Judgement:
    """A budget's lines for one log."""

    ticks: int
    """judged"""
    virtual: bool
    lines: tuple[Line, ...]

    @property
    def passed(self) -> bool:
        """No line failed; one without a figure does not."""
        return all(line.passed is not False for line in self.lines)


def judge(log: Log, budget: Budget) -> Judgement:
    """Raises `ToolError` for a log that holds no tick in the budget's states."""
    for topic in _NEEDED:
        if topic not in log:
            raise ToolError(f"{log.path}: there is no topic {topic}; timing needs a run's own log")
    log.load(_NEEDED)
    states = [State[name] for name in budget.states]
    chosen = np.isin(log["/tonus/state"]["state"], states)
    ticks = int(chosen.sum())
    if not ticks:
        names = ", ".join(budget.states)
        raise ToolError(f"{log.path}: no tick in {names}; choose other states in the budget")
    virtual = log.metadata.get("time") == "virtual"
    series = _series(log, chosen)
    lines = []
    for limit in budget.limits:
        absent = virtual and limit.signal in _HOST
        value = None if absent else _value(limit, series[limit.signal], ticks)
        lines.append(Line(limit, value))
    return Judgement(ticks, virtual, tuple(lines))


def _series(log: Log, chosen: NDArray[np.bool_]) -> dict[str, Array]:
    """Each signal in the chosen ticks (n,); of counted ones what each tick added."""
    timing = log["/tonus/timing"]
    found: dict[str, Any] = {name: timing[name][chosen] for name in _HOST if name != "cycle_us"}
    found["cycle_us"] = sum(found[name] for name in ("collect_us", "compute_us", "publish_us"))
    tick = timing["tick"].astype(np.int64)
    found["gap_ticks"] = np.diff(tick, prepend=tick[0] - 1)[chosen]
    found["drive_age_ticks"] = log["/tonus/drives"]["age"][chosen].max(axis=1)
    found["cell_age_ticks"] = log["/tonus/force_cells"]["age"][chosen].max(axis=1)
    for name in ("missed_own", "missed_host"):
        found[name] = np.diff(timing[name].astype(np.int64), prepend=0)[chosen]
    # Lost before the recorder, whatever the state; and what the tick numbers miss beyond misses.
    found["lost_records"] = np.array([sum(int(count) for count in log.recorded.values())])
    return {name: np.asarray(values, np.float64) for name, values in found.items()}


def _value(limit: Limit, values: Array, ticks: int) -> float:
    if limit.signal in COUNTS:
        total = float(values.sum())
        return total if limit.at == "total" else total / ticks * 1e6
    if isinstance(limit.at, str):
        return float(values.max())
    return float(np.percentile(values, limit.at))


def histogram(values: Array, edges: Array) -> NDArray[np.int64]:
    """Counts (len(edges) - 1,), what lies beyond the last edge counted in the last."""
    clipped = np.clip(values, edges[0], np.nextafter(edges[-1], edges[0]))
    return np.histogram(clipped, edges)[0]
