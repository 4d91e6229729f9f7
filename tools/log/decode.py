"""From the encoded messages of a topic to one array."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mcap.records import Schema
from numpy.typing import NDArray

from tools.log.chunks import Run
from tools.log.schema import body_dtype, smallest_dtype

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
    found = Column(messages, times, sequence)
    return found.chosen(np.argsort(times, kind="stable")) if (np.diff(times) < 0).any() else found


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
