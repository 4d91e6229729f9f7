"""Topics of a log on one time base: a row for each tick.

A tick has the latest message of each topic, at or before its own time (as `Log.join`): a topic that
comes less often is held at its last value. Ticks before the first message of any topic are left
out. A topic that is not of the control cycle has a column with the time since that message.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.recording.messages import KEYFRAME_TOPIC
from tonus.runtime.signals import TABLE
from tonus.tools.errors import ToolError
from tonus.tools.log.decode import Column, in_order, joined
from tonus.tools.log.log import AFTER_ALL, EVENTS, Log
from tonus.tools.log.memory import memory_for_logs
from tonus.tools.log.tables import Signal, TableColumn, signals, time_of

BASE = "/tonus/timing"
_HOME = "/tonus/"
_CYCLE = frozenset(topic.name for topic in TABLE)
_NO_SIGNALS = EVENTS, KEYFRAME_TOPIC
_NS = 1e-9


@dataclass(frozen=True)
class Rows:
    """Consecutive rows (n,) of the table."""

    base: list[Signal]
    """time and tick"""
    topics: dict[str, list[Signal]]
    """by the topic's short name"""
    left_out: int
    """ticks among them for which a topic had no message yet"""

    @property
    def count(self) -> int:
        return len(self.base[0].values)

    def columns(self) -> list[TableColumn]:
        """All of them, named ``topic.field``."""
        found = [column for signal in self.base for column in signal.columns()]
        for topic, fields in self.topics.items():
            found += [column for signal in fields for column in signal.columns(f"{topic}.")]
        return found


def mergeable(log: Log, topics: Sequence[str]) -> list[str]:
    """``topics``, or if none are named all of Tonus's own that have a value at a tick. Raises
    ToolError for a log without ticks, and for a topic of which nothing can be held."""
    if BASE not in log:
        raise ToolError(f"{log.path}: has no topic {BASE}, whose ticks are the rows of --merge")
    topics = [log.named(topic) for topic in topics]
    for topic in topics:
        if topic in _NO_SIGNALS:
            raise ToolError(
                f"{log.path}: {topic} has no value between its messages; export it without --merge"
            )
    own = (topic for topic in log.topics if topic.startswith(_HOME) and topic not in _NO_SIGNALS)
    return list(dict.fromkeys(topics or own))


def merge(log: Log, topics: Sequence[str]) -> Iterator[Rows]:
    """The table in order of time, a part of it for each chunk of the log; ``topics`` as
    `mergeable` gives them. Raises ToolError for one that makes no table, and where the topics lie
    so far apart in the file that memory does not hold what is between them."""
    waiting: dict[str, Column] = {}
    others = [topic for topic in topics if topic != BASE]
    for until, batch in _with_end(log.batches_in_time([BASE, *others])):
        for topic, column in batch.items():
            if len(column.times):
                waiting[topic] = _behind(log, topic, waiting.get(topic), column)
        if sum(column.messages.nbytes for column in waiting.values()) > memory_for_logs():
            raise ToolError(f"{log.path}: topics lie too far apart in it; export without --merge")
        if BASE not in waiting:
            continue
        due, waiting[BASE] = _split(waiting[BASE], until)
        if len(due.times):
            yield _rows(log, due, topics, waiting)
        for topic in others:
            if topic in waiting:
                # The last one of before stays: it is held by what is to come.
                past = int(np.searchsorted(waiting[topic].times, until)) - 1
                waiting[topic] = waiting[topic].chosen(slice(max(past, 0), None))


def _with_end(
    batches: Iterable[tuple[int, dict[str, Column]]],
) -> Iterator[tuple[int, dict[str, Column]]]:
    """A damaged log ends before its time."""
    yield from batches
    yield AFTER_ALL, {}


def _behind(log: Log, topic: str, before: Column | None, column: Column) -> Column:
    if before is None or not len(before.times):
        return column
    if _kinds(before) != _kinds(column):
        raise ToolError(
            f"{log.path}: {topic} is not the same in all of the run; choose a part of it with "
            "--from and --to"
        )
    return in_order(joined([before, column]))


def _kinds(column: Column) -> list[Any]:
    """Names and types; the padding between them is another after some were put together."""
    dtype = column.messages.dtype
    return [dtype] if dtype.names is None else [(name, dtype[name]) for name in dtype.names]


def _split(column: Column, until: int) -> tuple[Column, Column]:
    place = int(np.searchsorted(column.times, until))
    return column.chosen(slice(None, place)), column.chosen(slice(place, None))


def _rows(log: Log, due: Column, topics: Sequence[str], waiting: dict[str, Column]) -> Rows:
    latest: dict[str, NDArray[np.intp]] = {}
    ready = np.ones(len(due.times), bool)
    for topic in topics:
        if topic == BASE:
            continue
        there = waiting[topic].times if topic in waiting else np.empty(0, np.int64)
        latest[topic] = np.searchsorted(there, due.times, "right") - 1
        ready &= latest[topic] >= 0
    ticks = due.chosen(ready)
    base = [time_of(ticks, log.start_ns), Signal("tick", "", ticks.messages["tick"])]
    found: dict[str, list[Signal]] = {}
    if len(ticks.times):
        for topic in topics:
            column = ticks if topic == BASE else waiting[topic].chosen(latest[topic][ready])
            found[_short(topic)] = _fields(log, topic, ticks, column)
    return Rows(base, found, int((~ready).sum()))


def _fields(log: Log, topic: str, ticks: Column, column: Column) -> list[Signal]:
    fields = signals(topic, column)
    if fields is None:
        raise ToolError(f"{log.path}: {topic} makes no table; name others with --topics")
    if topic not in _CYCLE:
        fields.append(Signal("held", "s", (ticks.times - column.times) * _NS))
    return fields


def _short(topic: str) -> str:
    """Without /tonus/, or whole."""
    return topic.removeprefix(_HOME) if topic.startswith(_HOME) else topic.strip("/")
