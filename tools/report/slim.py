"""A log of which only some signals are kept, so that a long one fits into memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.log.decode import Column
from tools.log.log import EVENTS, Log

Progress = Callable[[float], None]
"""Receives the share that is done, 0 to 1."""
Fields = Mapping[str, Sequence[str]]
"""By topic; a topic or field that a file does not have is left out."""

RUN: Fields = {
    "/tonus/timing": (
        *("tick", "missed_own", "missed_host"),
        *("wakeup_us", "collect_us", "compute_us", "publish_us"),
    ),
    "/tonus/state": ("state", "fault", "fault_where", "scenario_time"),
    "/tonus/drives": ("torque_command",),
    "/tonus/pose": ("position", "velocity", "desired_position"),
    "/tonus/stiffness": ("law", "cap", "k_eq"),
    "/tonus/wrench": ("external", "contact"),
    "/tonus/tension": ("reference", "measured"),
    "/tonus/envelope": ("grade", "bound", "progress"),
    "/tonus/truth": (
        *("position", "tension", "load", "contact_force"),
        *("losses", "input_work", "platform_power"),
    ),
}
"""What the report and the comparison look at: about 0.7 kB a cycle."""


class SlimLog(Log):
    """A log that is read once, a chunk at a time, keeping ``fields`` and the events."""

    def __init__(self, path: Path, fields: Fields, progress: Progress = lambda _: None) -> None:
        super().__init__(path)
        names = [topic for topic in self.topics if topic in fields or topic == EVENTS]
        kept: dict[str, list[Column]] = {topic: [] for topic in names}
        for number, batch in enumerate(self.batches(names), start=1):
            for topic, column in batch.items():
                if len(column.times):
                    kept[topic].append(_narrow(column, fields.get(topic)))
            progress(number / len(self._framing.chunks))
        for topic, columns in kept.items():
            none = _narrow(self._decode(topic, []), fields.get(topic))
            self._columns[topic] = _join(columns or [none])


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


def _join(columns: Sequence[Column]) -> Column:
    times = np.concatenate([column.times for column in columns])
    messages: NDArray[Any] = np.concatenate([column.messages for column in columns])
    sequence = np.concatenate([column.sequence for column in columns])
    joined = Column(messages, times, sequence)
    if (np.diff(times) < 0).any():
        return joined.chosen(np.argsort(times, kind="stable"))
    return joined
