"""A log, decoded around the moment that is shown: opening one reads its index only."""

from __future__ import annotations

from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from tonus.runtime.signals import TABLE, cycle_dtype
from tonus.runtime.states import State
from tonus.tools.documents import from_yaml
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.log.log import EVENTS, TUNING
from tonus.tools.view.moment import Happening, Samples, joined
from tonus.tools.view.settings import settings
from tonus.tools.view.shape import Shape

if TYPE_CHECKING:
    from tonus.config.schema.root import Config

_SLAB_S = 1.0
_TRUTH = "/tonus/truth"
_TIMING, _STATE = "/tonus/timing", "/tonus/state"
_NS = 1e-9


class Recorded:
    """The run in ``path`` and the segments that follow it. Raises `ToolError`."""

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, str(path)
        self._log = log = open_log(path)
        self._topics = [topic.name for topic in TABLE if topic.name in log]
        missing = [each.name for each in TABLE if each.name not in (*log.topics, TUNING)]
        if missing:
            raise ToolError(f"{path}: has no topic {missing[0]}; name a log of `tonus run`")
        span = log.span_ns
        if span is None:
            raise ToolError(f"{path}: holds no message{': ' + log.damage if log.damage else ''}")
        self.start_ns, self.length_s = span[0], (span[1] - span[0]) * _NS
        self._document = _configuration(log)
        try:
            self.shape = Shape.of(self._document, _scenario(log))
        except (LookupError, TypeError, ValueError) as error:
            raise _of_another_version(log) from error
        self._step = max(1, round(1.0 / (settings().sample_hz * self.shape.period)))
        self._slabs: OrderedDict[int, Samples] = OrderedDict()
        self._ahead: tuple[int, Future[Samples]] | None = None
        self._reader = ThreadPoolExecutor(1, thread_name_prefix="log")

    @cached_property
    def config(self) -> Config:
        """Checked as a whole, which takes half a second. Raises `ToolError`."""
        from tonus.config.schema.root import Config

        try:
            return Config.model_validate(self._document)
        except ValueError as error:
            raise _of_another_version(self._log) from error

    @property
    def damage(self) -> str | None:
        """What is missing, as far as it is known."""
        return self._log.damage

    def samples(self, start_s: float, end_s: float) -> Samples:
        """Those with start_s < time <= end_s, in s since the log's first message."""
        start_s, end_s = max(start_s, -_SLAB_S), min(end_s, self.length_s)
        first, last = int(max(start_s, 0.0) // _SLAB_S), int(max(end_s, 0.0) // _SLAB_S)
        parts = [self._slab(number) for number in range(first, last + 1)]
        return joined(parts).between(start_s, end_s)

    def prepare(self, time_s: float) -> None:
        """Read what comes after ``time_s``, meanwhile."""
        number = int(max(time_s, 0.0) // _SLAB_S) + 1
        if number in self._slabs or number * _SLAB_S > self.length_s:
            return
        if self._ahead is None or self._ahead[0] != number:
            self._ahead = number, self._reader.submit(self._read, number)

    def happenings(self) -> list[Happening]:
        """Every event; takes a pass over the file, on a reader of its own."""
        if EVENTS not in self._log:
            return []
        log = open_log(self.path)
        return [
            Happening(
                (each.time_ns - self.start_ns) * _NS, each.level, each.name, each.where, each.text
            )
            for each in log.events()
        ]

    def started_s(self) -> float:
        """s since the first message at which the scenario started, 0 if it never did."""
        log = open_log(self.path)
        for batch in log.batches([_STATE]):
            column = batch[_STATE]
            active = np.flatnonzero(column.messages["state"] == State.ACTIVE)
            if len(active):
                return float((column.times[active[0]] - self.start_ns) * _NS)
        return 0.0

    def _slab(self, number: int) -> Samples:
        found = self._slabs.get(number)
        if found is None:
            if self._ahead is not None and self._ahead[0] == number:
                found = self._ahead[1].result()
                self._ahead = None
            else:
                found = self._reader.submit(self._read, number).result()
            self._slabs[number] = found
            while len(self._slabs) * _SLAB_S > settings().log_memory_s:
                self._slabs.popitem(last=False)
        self._slabs.move_to_end(number)
        return found

    def _read(self, number: int) -> Samples:
        """Of one stretch of time; in the reader's thread alone."""
        part = self._log.between(number * _SLAB_S, (number + 1) * _SLAB_S)
        topics = [topic for topic in (*self._topics, _TRUTH) if topic in part]
        part.load(topics)
        times = part.times(_TIMING)[part[_TIMING]["tick"] % self._step == 0]
        rows = {topic: np.searchsorted(part.times(topic), times, "right") - 1 for topic in topics}
        ready = np.ones(len(times), bool)
        for topic in self._topics:
            ready &= rows[topic] >= 0
        # Zeros where an older log has no such topic.
        known = cycle_dtype(self.shape.cables)
        names = [topic.name for topic in TABLE]
        members = [
            (short, part[name].dtype if name in self._topics else known[short])
            for name in names
            for short in [name.rsplit("/", 1)[1]]
        ]
        result = np.zeros(int(ready.sum()), members)
        for topic in self._topics:
            result[topic.rsplit("/", 1)[1]] = part[topic][rows[topic][ready]]
        truth = None
        if _TRUTH in rows and len(part[_TRUTH]):
            truth = part[_TRUTH][np.maximum(rows[_TRUTH][ready], 0)]
        seconds = (times[ready] - self.start_ns) * _NS
        return Samples(seconds.astype(np.float64), result, truth)

    def close(self) -> None:
        """End the reader's thread."""
        self._reader.shutdown(wait=False, cancel_futures=True)


def _configuration(log: Log) -> Any:
    text = log.config_text
    if text is None:
        raise ToolError(f"{log.path}: holds no configuration, so it cannot be shown")
    try:
        return from_yaml(text)
    except yaml.YAMLError as error:
        raise _of_another_version(log) from error


def _scenario(log: Log) -> Any:
    """None where it cannot be read: the picture then lacks the phantom."""
    data = log.attachments.get("scenario.yaml")
    try:
        return None if data is None else from_yaml(data)
    except yaml.YAMLError:
        return None


def _of_another_version(log: Log) -> ToolError:
    return ToolError(
        f"{log.path}: its configuration is not one that this version reads; "
        "use the version that recorded it"
    )
