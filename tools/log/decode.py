"""From the encoded messages of a topic to one array."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mcap.records import Schema
from numpy.typing import NDArray

from tonus.tools.log.chunks import Run
from tonus.tools.log.schema import body_dtype, smallest_dtype

EVENT_MESSAGE = "tonus_msgs/msg/Event"
KEYFRAME_MESSAGE = "tonus_msgs/msg/Keyframe"
_CDR = b"\x00\x01\x00\x00"
"""encapsulation: plain CDR, little-endian"""
_EVENT = np.dtype([("tick", "<u8"), ("level", "u1"), ("name", "O"), ("where", "O"), ("text", "O")])
_KEYFRAME = np.dtype([("tick", "<u8"), ("state", "O")])


@dataclass(frozen=True)
class Column:
    """All messages of a topic."""

    messages: NDArray[Any]
    times: NDArray[np.int64]
    sequence: NDArray[np.int64]

    def chosen(self, which: NDArray[Any] | slice) -> Column:
        """Some of them, by mask, order or slice."""
        return Column(self.messages[which], self.times[which], self.sequence[which])


def column(schema: Schema | None, encoding: str, parts: Sequence[Run]) -> Column:
    """The messages of ``parts`` in order of time: of one size and in plain CDR they become records;
    what else there is stays as bytes, one object each."""
    ros = schema is not None and schema.encoding == "ros2msg" and encoding == "cdr"
    plain = ros and all(bytes(part.data[0, : len(_CDR)]) == _CDR for part in parts)
    messages: NDArray[Any] | None = None
    if schema is not None and plain:
        if schema.name == EVENT_MESSAGE:
            messages = _rows(_event, _EVENT, parts)
        elif schema.name == KEYFRAME_MESSAGE:
            messages = _rows(_keyframe, _KEYFRAME, parts)
        else:
            messages = _fixed(schema, parts)
    if messages is None:
        each = [bytes(row) for part in parts for row in part.data]
        messages = np.empty(len(each), object)
        messages[:] = each
    times = _joined([part.log_time for part in parts])
    sequence = _joined([part.sequence for part in parts])
    return in_order(Column(messages, times, sequence))


def in_order(found: Column) -> Column:
    """By time; those of one time as they came."""
    backwards = (found.times[1:] < found.times[:-1]).any()
    return found.chosen(np.argsort(found.times, kind="stable")) if backwards else found


class Collector:
    """The messages of a topic as they come, chunk after chunk. Those of one size are copied once,
    to where they stay."""

    def __init__(self, schema: Schema | None, encoding: str, expected: int, room: int) -> None:
        """``expected``: how many messages there will be, if the file tells; ``room``: bytes that
        all of the file's chunks hold."""
        self._schema, self._encoding = schema, encoding
        self._expected, self._room = expected, room
        self._dtype: np.dtype[np.void] | None = None
        self._rows: NDArray[np.void] = np.empty(0, "V1")
        """bodies, as lumps: numpy copies those faster than rows of bytes"""
        self._times = np.empty(0, np.int64)
        self._sequence = np.empty(0, np.int64)
        self._count = 0
        self._others: list[Run] = []
        """of another size, or before it was known that all are alike"""

    def add(self, run: Run) -> None:
        if self._dtype is None and not self._others:
            self._dtype = self._fixed(run)
        if self._dtype is None or run.data.shape[1] - len(_CDR) != self._dtype.itemsize:
            # A copy lets go of the rest of the chunk.
            self._others.append(Run(run.channel, run.rows.copy()))
            return
        start, end = self._count, self._count + len(run.rows)
        if end > len(self._times):
            told = min(self._expected, self._room // run.rows.shape[1])
            self._grow(max(end, told, 2 * start))
        self._rows[start:end] = run.data[:, len(_CDR) :].view(self._rows.dtype)[:, 0]
        self._times[start:end], self._sequence[start:end] = run.log_time, run.sequence
        self._count = end

    def column(self) -> Column:
        if self._others or self._dtype is None:
            return column(self._schema, self._encoding, [*self._as_run(), *self._others])
        end = self._count
        rows = self._rows[:end].view(self._dtype)
        return in_order(Column(rows, self._times[:end], self._sequence[:end]))

    def _fixed(self, run: Run) -> np.dtype[np.void] | None:
        sample = column(self._schema, self._encoding, [Run(run.channel, run.rows[:1])])
        dtype = sample.messages.dtype
        return None if dtype.hasobject else dtype

    def _grow(self, size: int) -> None:
        assert self._dtype is not None
        rows: NDArray[np.void] = np.empty(size, f"V{self._dtype.itemsize}")
        times, sequence = np.empty(size, np.int64), np.empty(size, np.int64)
        if self._count:
            rows[: self._count] = self._rows[: self._count]
            times[: self._count] = self._times[: self._count]
            sequence[: self._count] = self._sequence[: self._count]
        self._rows, self._times, self._sequence = rows, times, sequence

    def _as_run(self) -> list[Run]:
        """What was taken for fixed, back in its first form."""
        if not self._count:
            return []
        size, head = self._rows.dtype.itemsize, 9 + 22
        rows = np.zeros((self._count, head + len(_CDR) + size), np.uint8)
        numbers = self._sequence[: self._count, None].astype("<u4")
        rows[:, 11:15] = numbers.view("u1")
        rows[:, 15:23] = self._times[: self._count, None].view("u1")
        rows[:, head : head + len(_CDR)] = np.frombuffer(_CDR, np.uint8)
        rows[:, head + len(_CDR) :] = self._rows[: self._count, None].view("u1")
        return [Run(0, rows)]


def joined(columns: Sequence[Column]) -> Column:
    """Several of one topic, one after the other."""
    return Column(
        np.concatenate([each.messages for each in columns]),
        _joined([each.times for each in columns]),
        _joined([each.sequence for each in columns]),
    )


def _fixed(schema: Schema, parts: Sequence[Run]) -> NDArray[Any] | None:
    """Messages of one size, None if they are not."""
    definition = schema.data.decode(errors="replace")
    sizes = {part.data.shape[1] - len(_CDR) for part in parts}
    if not parts:
        dtype = smallest_dtype(schema.name, definition)
        return None if dtype is None else np.empty(0, dtype)
    size = sizes.pop()
    dtype = None if sizes else body_dtype(schema.name, definition, size)
    if dtype is None:
        return None
    rows = np.empty((sum(len(part.rows) for part in parts), size), np.uint8)
    at = 0
    for part in parts:
        rows[at : at + len(part.rows)] = part.data[:, len(_CDR) :]
        at += len(part.rows)
    return rows.view(dtype)[:, 0]


def _rows(decode: Any, dtype: np.dtype[np.void], parts: Sequence[Run]) -> NDArray[Any] | None:
    try:
        rows = [decode(bytes(row)) for part in parts for row in part.data]
    except (struct.error, IndexError):
        return None
    return np.array(rows, dtype)


def _event(data: bytes) -> tuple[int, int, str, str, str]:
    tick, level = struct.unpack_from("<QB", data, len(_CDR))
    texts = _strings(data[len(_CDR) :], 9)
    return tick, level, next(texts), next(texts), next(texts)


def _keyframe(data: bytes) -> tuple[int, bytes]:
    tick, size = struct.unpack_from("<QI", data, len(_CDR))
    at = len(_CDR) + 12
    return tick, data[at : at + size]


def _strings(body: bytes, at: int) -> Iterator[str]:
    while True:
        at += -at % 4
        (size,) = struct.unpack_from("<I", body, at)
        yield body[at + 4 : at + 3 + size].decode(errors="replace")
        at += 4 + size


def _joined(parts: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    return np.concatenate([np.empty(0, np.int64), *parts])
