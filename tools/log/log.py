"""A log, read."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel
from numpy.typing import NDArray

from tonus.config.checked import choose
from tonus.tools.errors import ToolError
from tonus.tools.log.ahead import contents
from tonus.tools.log.chunks import (
    ChunkPlace,
    DamageError,
    Framing,
    Run,
    data_is_whole,
    runs,
    scan,
)
from tonus.tools.log.decode import Collector, Column, column
from tonus.tools.log.memory import memory_for_logs

EVENTS, TUNING = "/tonus/events", "/tonus/tuning"
AFTER_ALL = int(np.iinfo(np.int64).max)
"""ns, a log_time later than any"""
_CONFIG_NAMES = ("config.yaml", "config.json")
_NS = 1_000_000_000


@dataclass(frozen=True)
class Event:
    """Something that happened, for a person."""

    time_ns: int
    tick: int
    level: int
    name: str
    where: str
    text: str


class Log:
    """Topics of one file as structured arrays, decoded at their first use.

    ``log[topic]`` raises `ToolError` for an unknown topic. docs/log.md lists topics and fields.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._framing: Framing = scan(path)
        self._columns: dict[str, Column] = {}
        self._damage = self._framing.damage
        # Metadata has no checksum of its own.
        if not all(map(_is_count, self._framing.metadata.get("tonus.recorded", {}).values())):
            self._damage = self._damage or "its account of lost records is damaged"
        self._usable = len(self._framing.chunks)
        self._window: tuple[int, int] | None = None
        self.remarks: tuple[str, ...] = ()
        """on files that should belong to this run and could not be read with it"""
        if not self._framing.channels:
            # Some programs announce topics inside their chunks, and again in the summary.
            for _ in self._runs(()):
                pass

    @property
    def topics(self) -> tuple[str, ...]:
        """Names of all topics, in the file's order; some may hold no message."""
        return tuple(dict.fromkeys(c.topic for c in self._framing.channels.values()))

    @property
    def metadata(self) -> dict[str, str]:
        """Metadata of the run: versions, seed, host."""
        return self._framing.metadata.get("tonus", {})

    @property
    def recorded(self) -> dict[str, str]:
        """Records lost before they were recorded, by ring; empty if the file was not finished."""
        told = self._framing.metadata.get("tonus.recorded", {})
        return {name: count for name, count in told.items() if _is_count(count)}

    @property
    def attachments(self) -> dict[str, bytes]:
        return self._framing.attachments

    @property
    def config_text(self) -> str | None:
        """The configuration of the run."""
        for name in _CONFIG_NAMES:
            if name in self.attachments:
                return self.attachments[name].decode(errors="replace")
        return None

    @property
    def start_ns(self) -> int:
        """log_time of the file's first message, of a slice too; 0 without messages."""
        return min((place.start_ns for place in self._framing.chunks), default=0)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """First and last log_time, None without messages."""
        chunks = self._places()
        if not chunks:
            return None
        first, last = min(c.start_ns for c in chunks), max(c.end_ns for c in chunks)
        if self._window is not None:
            first, last = max(first, self._window[0]), min(last, self._window[1] - 1)
        return first, last

    @property
    def damage(self) -> str | None:
        """What is missing, None for a complete file. Damage inside a chunk is found when it is
        decoded."""
        told = [self._damage] if self._damage else []
        return "; ".join([*told, *self.remarks]) or None

    def __contains__(self, topic: str) -> bool:
        return topic in self.topics

    def __getitem__(self, topic: str) -> NDArray[np.void]:
        """All messages of a topic, a structured array (n,) in order of time."""
        self.load([topic])
        return self._columns[topic].messages

    def is_as_written(self) -> bool:
        """Whether the file's data passes the checksum over all of it, beyond those of its chunks;
        takes a pass over the file."""
        return data_is_whole(self.path, self._framing)

    def has(self, topic: str, *fields: str) -> bool:
        """Whether there are messages of a topic, and such fields in them."""
        if topic not in self or not len(self[topic]):
            return False
        return set(fields) <= set(self[topic].dtype.names or ())

    def times(self, topic: str) -> NDArray[np.int64]:
        """log_time in ns (n,) of a topic's messages."""
        self.load([topic])
        return self._columns[topic].times

    def sequence(self, topic: str) -> NDArray[np.int64]:
        """Sequence numbers (n,): a step over more than one is a loss, except on bus topics, whose
        numbers count through all buses."""
        self.load([topic])
        return self._columns[topic].sequence

    def load(self, topics: Sequence[str] | None = None) -> None:
        """Decode several topics (all, if None) in one pass over the file."""
        names = self._known(topics)
        wanted = [name for name in names if name not in self._columns]
        if not wanted:
            return
        found = {name: self._collector(name) for name in wanted}
        room = memory_for_logs()
        for parts in self._runs(wanted):
            for name, some in parts.items():
                for run in some:
                    found[name].add(run)
                    room -= run.rows.nbytes + _RUN_BYTES
            if room < 0:
                raise ToolError(
                    f"{self.path}: holds more than half of this machine's free memory takes; "
                    "export a part of it with --topics, --from and --to, or record shorter files"
                )
        for name in wanted:
            self._columns[name] = self._trimmed(found.pop(name).column())

    def batches(self, topics: Sequence[str]) -> Iterator[dict[str, Column]]:
        """Messages chunk by chunk, for logs larger than the memory; in order of time within a
        batch. Raises `ToolError` for an unknown topic."""
        names = self._known(topics)
        for parts in self._runs(names):
            yield {name: self._decode(name, parts.get(name, [])) for name in names}

    def batches_in_time(self, topics: Sequence[str]) -> Iterator[tuple[int, dict[str, Column]]]:
        """The same, each with the log_time in ns before which no later one holds a message."""
        starts = [place.start_ns for place in self._places()]
        later = np.minimum.accumulate([*starts[1:], AFTER_ALL][::-1])[::-1].tolist()
        yield from zip(later, self.batches(topics), strict=False)

    def between(self, start_s: float, end_s: float) -> Log:
        """The messages with start_s <= time < end_s, in s since the log's first message."""
        part = copy.copy(self)
        part._columns = {}
        part._window = (self.start_ns + _whole_ns(start_s), self.start_ns + _whole_ns(end_s))
        return part

    @property
    def chunk_count(self) -> int:
        """How many batches there are to come, at most."""
        return len(self._places())

    def holds(self, topics: Sequence[str]) -> bool:
        """Whether these are decoded already."""
        return all(topic in self._columns for topic in topics)

    def keep(self, columns: Mapping[str, Column]) -> None:
        """Hold these instead of what is decoded from the file, for views that leave out a part."""
        self._columns = dict(columns)

    def join(self, *topics: str) -> NDArray[np.void]:
        """One record per tick (n,) with ``tick`` and a member for each topic, named by its last
        part: the latest message of the topic at that tick. Ticks before the first message of any
        topic are left out."""
        self.load(["/tonus/timing", *topics])
        now = self.times("/tonus/timing")
        rows = {topic: np.searchsorted(self.times(topic), now, "right") - 1 for topic in topics}
        ready = np.ones(len(now), bool)
        for index in rows.values():
            ready &= index >= 0
        members: list[Any] = [("tick", "<u8")]
        members += [(topic.rsplit("/", 1)[1], self[topic].dtype) for topic in topics]
        result = np.empty(int(ready.sum()), members)
        result["tick"] = self["/tonus/timing"]["tick"][ready]
        for topic, index in rows.items():
            result[topic.rsplit("/", 1)[1]] = self[topic][index[ready]]
        return result

    def events(self) -> list[Event]:
        """The events (docs/events.md) in order of time; empty without any."""
        if EVENTS not in self or self[EVENTS].dtype.names is None:
            return []
        rows = self[EVENTS]
        return [
            Event(int(time), *row)
            for time, row in zip(self.times(EVENTS), rows.tolist(), strict=True)
        ]

    def _known(self, topics: Sequence[str] | None) -> Sequence[str]:
        if topics is None:
            return self.topics
        return [self.named(name) for name in topics]

    def named(self, topic: str) -> str:
        """A topic by its name, which may leave out ``/tonus/``. Raises `ToolError`."""
        for name in (topic, f"/tonus/{topic}"):
            if name in self.topics:
                return name
        known = [name.removeprefix("/tonus/") for name in self.topics]
        remedy = choose(topic.removeprefix("/tonus/"), known, "`tonus log info` lists them")
        raise ToolError(f"{self.path}: there is no topic {topic}; {remedy}")

    def _places(self) -> list[ChunkPlace]:
        """Chunks that may hold what is wanted."""
        places = self._framing.chunks[: self._usable]
        if self._window is None:
            return places
        start, end = self._window
        return [place for place in places if place.start_ns < end and place.end_ns >= start]

    def _runs(self, topics: Sequence[str]) -> Iterator[dict[str, list[Run]]]:
        """By topic what each chunk holds, up to the first damaged one."""
        wanted = set(topics)
        for place, data in contents(self.path, self._places()):
            sound = data is not None
            parts: dict[str, list[Run]] = {}
            try:
                for run in runs(data, self._framing) if data is not None else ():
                    channel = self._framing.channels.get(run.channel)
                    if channel is not None and channel.topic in wanted:
                        parts.setdefault(channel.topic, []).append(run)
            except DamageError:
                sound = False
            if not sound:
                self._usable = self._framing.chunks.index(place)
                self._damage = f"the chunk at byte {place.offset} is damaged"
                return
            yield parts

    def _decode(self, topic: str, parts: list[Run]) -> Column:
        channel = self._channel(topic)
        schema = self._framing.schemas.get(channel.schema_id)
        return self._trimmed(column(schema, channel.message_encoding, parts))

    def _collector(self, topic: str) -> Collector:
        channel, statistics = self._channel(topic), self._framing.statistics
        expected = 0
        if statistics is not None and self._window is None:
            expected = statistics.channel_message_counts.get(channel.id, 0)
        room = sum(place.uncompressed_size for place in self._framing.chunks)
        schema = self._framing.schemas.get(channel.schema_id)
        return Collector(schema, channel.message_encoding, expected, room)

    def _channel(self, topic: str) -> Channel:
        return next(c for c in self._framing.channels.values() if c.topic == topic)

    def _trimmed(self, found: Column) -> Column:
        if self._window is None:
            return found
        first, last = np.searchsorted(found.times, self._window)
        return found.chosen(slice(int(first), int(last)))


def _is_count(text: str) -> bool:
    return text.isdecimal() and len(text) < 20


def _whole_ns(seconds: float) -> int:
    return int(min(max(seconds, -_LONG), _LONG) * _NS)


_RUN_BYTES = 512
"""what a run of messages costs beside its rows"""
_LONG = 9e9
"""s, as far as a log_time in int64 ns reaches"""
