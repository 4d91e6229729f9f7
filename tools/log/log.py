"""A log, read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.errors import ToolError
from tools.log.chunks import Framing, Run, content, runs, scan
from tools.log.schema import body_dtype

EVENTS = "/tonus/events"
_CDR_HEADER = 4
_CONFIG_NAMES = ("config.yaml", "config.json")


@dataclass(frozen=True)
class Event:
    """Something that happened, for a person."""

    time_ns: int
    tick: int
    level: int
    name: str
    where: str
    text: str


@dataclass(frozen=True)
class _Column:
    """All messages of a topic."""

    messages: NDArray[Any]
    times: NDArray[np.int64]
    sequence: NDArray[np.int64]


def open(path: str | Path) -> Log:  # noqa: A001  # as in wave.open: read as log.open(path)
    """Open a log. Raises ToolError when the file is not a log at all."""
    return Log(Path(path))


class Log:
    """Topics of one file as structured arrays, decoded when they are first asked for."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._framing: Framing = scan(path)
        self._columns: dict[str, _Column] = {}
        self._damage = self._framing.damage
        self._usable = len(self._framing.chunks)

    @property
    def topics(self) -> tuple[str, ...]:
        """Names of all topics, in the file's order; some may hold no message."""
        return tuple(channel.topic for channel in self._framing.channels.values())

    @property
    def metadata(self) -> dict[str, str]:
        """What the recorder was told about the run: versions, seed, host."""
        return self._framing.metadata.get("tonus", {})

    @property
    def recorded(self) -> dict[str, str]:
        """Records lost before they were recorded, by ring; empty if the file was not finished."""
        return self._framing.metadata.get("tonus.recorded", {})

    @property
    def attachments(self) -> dict[str, bytes]:
        return self._framing.attachments

    @property
    def config_text(self) -> str | None:
        """The configuration of the run."""
        for name in _CONFIG_NAMES:
            if name in self.attachments:
                return self.attachments[name].decode()
        return None

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """First and last log_time, None without messages."""
        chunks = self._framing.chunks[: self._usable]
        if not chunks:
            return None
        return min(c.start_ns for c in chunks), max(c.end_ns for c in chunks)

    @property
    def damage(self) -> str | None:
        """What is missing, None for a whole file. Content is judged when it is decoded."""
        return self._damage

    def __contains__(self, topic: str) -> bool:
        return topic in self.topics

    def __getitem__(self, topic: str) -> NDArray[np.void]:
        """All messages of a topic, a structured array (n,) in order of time."""
        self.load([topic])
        return self._columns[topic].messages

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
        names = self.topics if topics is None else topics
        for name in names:
            if name not in self.topics:
                raise ToolError(f"{self.path}: there is no topic {name}")
        wanted = {name for name in names if name not in self._columns}
        if not wanted:
            return
        found: dict[str, list[Run]] = {name: [] for name in wanted}
        for index, place in enumerate(self._framing.chunks[: self._usable]):
            data = content(self.path, place)
            if data is None:
                self._usable = index
                self._damage = f"the chunk at byte {place.offset} is damaged"
                break
            for run in runs(data, self._framing):
                channel = self._framing.channels.get(run.channel)
                if channel is not None and channel.topic in wanted:
                    # A copy lets go of the rest of the chunk.
                    found[channel.topic].append(Run(run.channel, run.rows.copy()))
        for name, parts in found.items():
            self._columns[name] = self._decode(name, parts)

    def events(self) -> list[Event]:
        if EVENTS not in self:
            return []
        rows = self[EVENTS]
        return [
            Event(int(time), *row)
            for time, row in zip(self.times(EVENTS), rows.tolist(), strict=True)
        ]

    def _decode(self, topic: str, parts: list[Run]) -> _Column:
        channel = next(c for c in self._framing.channels.values() if c.topic == topic)
        schema = self._framing.schemas.get(channel.schema_id)
        name = schema.name if schema else ""
        definition = schema.data.decode(errors="replace") if schema else ""
        if name == "tonus_msgs/msg/Event":
            messages: NDArray[Any] = _events(parts)
        else:
            messages = _fixed(name, definition, parts)
        times = _joined([part.log_time for part in parts])
        sequence = _joined([part.sequence for part in parts])
        if (np.diff(times) < 0).any():
            order = np.argsort(times, kind="stable")
            messages, times, sequence = messages[order], times[order], sequence[order]
        return _Column(messages, times, sequence)


def _fixed(name: str, definition: str, parts: list[Run]) -> NDArray[Any]:
    """Messages of one size; anything else stays a row of bytes, or an object."""
    sizes = {part.data.shape[1] - _CDR_HEADER for part in parts}
    size = sizes.pop() if len(sizes) == 1 else 0
    dtype = body_dtype(name, definition, size)
    if dtype is None and not parts:
        dtype = _empty_dtype(name, definition)
    if dtype is None:
        each = [bytes(row) for part in parts for row in part.data]
        unknown = np.empty(len(each), object)
        unknown[:] = each
        return unknown
    rows = np.empty((sum(len(part.rows) for part in parts), size), np.uint8)
    at = 0
    for part in parts:
        rows[at : at + len(part.rows)] = part.data[:, _CDR_HEADER:]
        at += len(part.rows)
    if not len(rows):
        return np.empty(0, dtype)
    return rows.view(dtype)[:, 0]


def _empty_dtype(name: str, definition: str) -> np.dtype[np.void] | None:
    """Of a topic without messages, whose size is not known: try what its members add up to."""
    fits = (body_dtype(name, definition, size) for size in range(1, 1 << 12))
    return next((dtype for dtype in fits if dtype is not None), None)


def _events(parts: list[Run]) -> NDArray[Any]:
    rows = [_event(bytes(row)) for part in parts for row in part.data]
    kinds = ("<u8", "u1", object, object, object)
    names = ("tick", "level", "name", "where", "text")
    return np.array(rows, np.dtype(list(zip(names, kinds, strict=True))))


def _event(data: bytes) -> tuple[int, int, str, str, str]:
    tick = int.from_bytes(data[4:12], "little")
    texts = _strings(data[_CDR_HEADER:], 9)
    return tick, data[12], next(texts), next(texts), next(texts)


def _strings(body: bytes, at: int) -> Iterator[str]:
    while True:
        at += -at % 4
        size = int.from_bytes(body[at : at + 4], "little")
        yield body[at + 4 : at + 3 + size].decode(errors="replace")
        at += 4 + size


def _joined(parts: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    return np.concatenate([np.empty(0, np.int64), *parts])
