"""A run in pieces that memory holds, however long it is."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.runtime.states import State
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.log.decode import Column, joined
from tonus.tools.log.log import EVENTS
from tonus.tools.report.thin import POINTS
from tonus.tools.run.summary import TRUTH

Array = NDArray[np.float64]
Progress = Callable[[float], None]
"""Receives the share that is done, 0 to 1."""
CYCLE = (
    *("/tonus/timing", "/tonus/state", "/tonus/pose", "/tonus/stiffness"),
    *("/tonus/wrench", "/tonus/tension", "/tonus/envelope"),
)
"""topics with a record a cycle that a report looks at"""
_KEPT: Mapping[str, Sequence[str]] = {
    "/tonus/timing": (
        *("tick", "missed_own", "missed_host"),
        *("wakeup_us", "collect_us", "compute_us", "publish_us"),
    ),
    "/tonus/state": ("state", "fault", "fault_where"),
}
"""What a report needs of the whole run at once, about 50 bytes a cycle."""
_NS = 1e-9
_MARGIN_NS = 10_000_000
"""of truth before and after a piece, so that it can be interpolated at its cycles"""


@dataclass(frozen=True)
class Piece:
    """Consecutive cycles (n,), with all topics that are drawn."""

    log: Log
    config: Config | None
    time: Array
    """s (n,) since the log's first message"""
    period: float
    """s from cycle to cycle"""
    missed: Mapping[str, NDArray[np.bool_]]
    """whether a tick was missed before this one, by whose making"""
    points: int = POINTS
    """stretches of a thinned curve"""

    @property
    def has_truth(self) -> bool:
        return TRUTH in self.log and len(self.log[TRUTH]) > 0

    def in_state(self, *states: State) -> NDArray[np.bool_]:
        """(n,) which cycles ran in one of these."""
        return np.isin(self.log["/tonus/state"]["state"], states)


def outline(log: Log, progress: Progress = lambda _: None) -> Log:
    """The log with what is needed of the whole run, and its events, read already."""
    names = [topic for topic in log.topics if topic in _KEPT or topic == EVENTS]
    if log.holds(names):
        return log
    found: dict[str, list[Column]] = {topic: [] for topic in names}
    for number, batch in enumerate(log.batches(names), start=1):
        for topic, column in batch.items():
            if len(column.times):
                found[topic].append(_narrow(column, _KEPT.get(topic)))
        progress(min(number / max(log.chunk_count, 1), 1.0))
    part = copy.copy(log)
    kept = {topic: joined(columns) for topic, columns in found.items() if columns}
    part.keep({topic: _in_order(column) for topic, column in kept.items()})
    return part


def cut(log: Log, start_ns: int, end_ns: int) -> Log:
    """Cycles with start_ns <= log_time < end_ns, and the truth round them. Raises ToolError where
    topics of a cycle are not side by side."""
    topics = [topic for topic in (*CYCLE, TRUTH) if topic in log]
    wide = (start_ns - _MARGIN_NS, end_ns + _MARGIN_NS)
    around = log
    if not log.holds(topics):
        begin, end = ((edge - log.start_ns) * _NS for edge in wide)
        around = log.between(begin, end)
        around.load(topics)
    kept = {}
    for topic in topics:
        column = Column(around[topic], around.times(topic), around.sequence(topic))
        edges = wide if topic == TRUTH else (start_ns, end_ns)
        first, last = np.searchsorted(column.times, edges).tolist()
        kept[topic] = column.chosen(slice(first, last))
    if len({len(kept[topic].times) for topic in CYCLE}) > 1:
        raise ToolError(f"{log.path}: its topics are of unlike length; recover it first")
    part = copy.copy(around)
    part.keep(kept)
    return part


def _narrow(column: Column, names: Sequence[str] | None) -> Column:
    """``names`` of a topic's messages, all of them if None."""
    fields = column.messages.dtype.fields
    if names is None or fields is None:
        return column
    chosen = [name for name in names if name in fields]
    messages = np.empty(len(column.messages), [(name, fields[name][0]) for name in chosen])
    for name in chosen:
        messages[name] = column.messages[name]
    return Column(messages, column.times, column.sequence)


def _in_order(column: Column) -> Column:
    if (np.diff(column.times) < 0).any():
        return column.chosen(np.argsort(column.times, kind="stable"))
    return column
