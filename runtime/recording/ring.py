"""A ring of fixed-size records in a memory-mapped file, between one writer and one reader.

The writer copies a record and goes on; it never waits and never knows whether anybody reads. A file
because it outlives its processes: whatever was published before a kill is read after it. A slot
carries its position, taken away before the payload is touched and put back after it, so that a slot
caught in mid-write is recognised and never returned.

Layout, little-endian, in 8-byte words: magic, version, payload size, capacity, published count,
reader's cursor, length of the JSON meta, meta; then slots of position + 1, stamp in ns, payload
(padded to a word). Stores must become visible in program order, as they do on x86-64.
"""

from __future__ import annotations

import json
import mmap
import os
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.errors import DaemonError

Meta = dict[str, Any]
"""JSON object; ``kind`` says what the payload is: record, frames or events."""

Buffer = bytes | bytearray | memoryview | NDArray[Any]

Scalar = TypeVar("Scalar", bound=np.generic)

_MAGIC = int.from_bytes(b"TONUSRNG", "little")
_VERSION = 1
_WORD = 8
_MADV_POPULATE_WRITE = 23
"""madvise(2); Python has no name for it"""
_MAGIC_AT, _VERSION_AT, _PAYLOAD_AT, _CAPACITY_AT, PUBLISHED_AT, _CURSOR_AT, _META_AT = range(7)
_META_START = 8 * _WORD
SLOT_HEAD = 2 * _WORD
"""bytes before the payload of a slot"""


class RingError(DaemonError):
    """The file is not a ring, or not one of this version."""


def _padded(size: int, to: int = _WORD) -> int:
    return -(-size // to) * to


def _touch(memory: mmap.mmap) -> None:
    """Bring every page in, writable, so that no record is the first to touch one."""
    try:
        memory.madvise(_MADV_POPULATE_WRITE)
    except OSError:  # a kernel before 5.14
        memory[:: mmap.PAGESIZE] = bytes(len(range(0, len(memory), mmap.PAGESIZE)))


class RingWriter:
    """The one producer. `publish` allocates nothing and makes no system call."""

    def __init__(self, memory: mmap.mmap, path: Path) -> None:
        self.path = path
        self.count = 0
        """records published so far"""
        self._memory = memory
        self._view = memoryview(memory)
        self._words = self._view.cast("q")
        self.payload_size = self._words[_PAYLOAD_AT]
        self.capacity = self._words[_CAPACITY_AT]
        first = _slots_at(self._words[_META_AT])
        self._first = first // _WORD
        self._stride = (SLOT_HEAD + _padded(self.payload_size)) // _WORD
        self._end = self._first + self.capacity * self._stride
        self._slot = self._first

    @classmethod
    def create(
        cls, path: Path, payload_size: int, capacity: int, meta: Meta, *, touched: bool = True
    ) -> Self:
        """A new ring file of ``capacity`` records of ``payload_size`` bytes. It appears complete or
        not at all. ``touched``: its pages are in memory from the start on, which only real time
        needs. Raises FileExistsError: what an earlier run left is never overwritten."""
        if payload_size < 1 or capacity < 1:
            raise ValueError("a ring holds at least one record of at least one byte")
        text = json.dumps(meta, sort_keys=True).encode()
        start = _slots_at(len(text))
        size = start + capacity * (SLOT_HEAD + _padded(payload_size))
        draft = path.with_name(f".{path.name}.draft")
        with draft.open("w+b") as file:
            # Real blocks, not a hole: a full disk shows here and not as SIGBUS in a tick.
            os.posix_fallocate(file.fileno(), 0, size)
            memory = mmap.mmap(file.fileno(), size)
        if touched:
            _touch(memory)
        memory[_META_START : _META_START + len(text)] = text
        with memoryview(memory) as view, view.cast("q") as words:
            words[_VERSION_AT] = _VERSION
            words[_PAYLOAD_AT] = payload_size
            words[_CAPACITY_AT] = capacity
            words[_META_AT] = len(text)
            words[_MAGIC_AT] = _MAGIC
        try:
            os.link(draft, path)
        finally:
            draft.unlink()
        return cls(memory, path)

    def publish(self, payload: Buffer, stamp_ns: int) -> None:
        """Copy ``payload``, exactly `payload_size` bytes in one contiguous buffer."""
        words, slot = self._words, self._slot
        words[slot] = 0
        words[slot + 1] = stamp_ns
        at = slot * _WORD + SLOT_HEAD
        self._memory[at : at + self.payload_size] = payload  # type: ignore[assignment]
        self._release(slot)

    def _release(self, slot: int) -> None:
        """Make the slot just filled readable."""
        self._words[slot] = self.count + 1
        self._publish(1)
        slot += self._stride
        self._slot = slot if slot != self._end else self._first

    def _publish(self, records: int) -> None:
        """Count so many more, whose slots carry their positions."""
        self.count += records
        self._words[PUBLISHED_AT] = self.count

    def close(self) -> None:
        self._words.release()
        self._view.release()
        self._memory.close()


class RingReader:
    """The one consumer: copies what is new and keeps, in the file, how far it has come."""

    def __init__(self, memory: mmap.mmap, path: Path) -> None:
        self.path = path
        self.lost = 0
        """records that were overwritten before they were read"""
        self._memory = memory
        size = len(memory)
        words: NDArray[np.int64] = np.frombuffer(memory, "<i8", count=size // _WORD)
        if size < _META_START or words[_MAGIC_AT] != _MAGIC:
            raise RingError(f"{path}: not a ring file")
        if words[_VERSION_AT] != _VERSION:
            raise RingError(f"{path}: ring version {words[_VERSION_AT]}, known is {_VERSION}")
        self._words = words
        self.payload_size = int(words[_PAYLOAD_AT])
        self.capacity = int(words[_CAPACITY_AT])
        length = int(words[_META_AT])
        slot = np.dtype(
            [
                ("position", "<i8"),
                ("stamp", "<i8"),
                ("payload", "u1", (self.payload_size,)),
                ("padding", "u1", (_padded(self.payload_size) - self.payload_size,)),
            ]
        )
        start = _slots_at(length)
        if size < start + self.capacity * slot.itemsize:
            raise RingError(f"{path}: the ring file is cut short")
        self.meta: Meta = json.loads(memory[_META_START : _META_START + length])
        self._slots: NDArray[np.void] = np.frombuffer(
            memory, slot, count=self.capacity, offset=start
        )
        self._rows = self._slots.view(np.uint8).reshape(self.capacity, slot.itemsize)
        self.position = self.cursor
        """of the next record to read"""
        self.positions: NDArray[np.int64] = np.empty(0, np.int64)
        """of the records that the last `drain` returned"""

    @classmethod
    def open(cls, path: Path) -> RingReader:
        """Resume at the cursor. Raises RingError, or OSError."""
        with path.open("r+b") as file:
            if os.fstat(file.fileno()).st_size < _META_START:
                raise RingError(f"{path}: not a ring file")
            memory = mmap.mmap(file.fileno(), 0)
        return cls(memory, path)

    @classmethod
    def look(cls, path: Path) -> RingReader:
        """Beside the reader whose cursor the file keeps: begins at the next record, and can write
        nothing, so `commit` raises ValueError. Raises RingError, or OSError."""
        with path.open("rb") as file:
            if os.fstat(file.fileno()).st_size < _META_START:
                raise RingError(f"{path}: not a ring file")
            memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        reader = cls(memory, path)
        reader.position = reader.published
        return reader

    @property
    def cursor(self) -> int:
        """Position after the last record that `commit` declared safe."""
        return int(self._words[_CURSOR_AT])

    @property
    def published(self) -> int:
        """Records published so far, with the one whose writer died before it could count it."""
        count = int(self._words[PUBLISHED_AT])
        return count + int(self._slots["position"][count % self.capacity] == count + 1)

    def drain(self, limit: int) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
        """The next ``limit`` records or what there is of them: stamps (n,) in ns and payloads
        (n, payload_size), copies.

        What was overwritten before it could be read counts towards ``limit``, is added to `lost`
        and skipped.
        """
        end = self.published
        start = max(self.position, end - self.capacity)
        stop = max(start, min(end, self.position + limit))
        self.lost += start - self.position
        self.position = stop
        copied = self._copy(self._rows, start, stop).view(self._slots.dtype)[:, 0]
        # The copy comes first, then a second look at the positions: a slot that the writer reached
        # in between no longer carries the position we came for.
        now = self._copy(self._slots["position"], start, stop)
        expected = np.arange(start + 1, stop + 1)
        whole = (copied["position"] == expected) & (now == expected)
        if not whole.all():
            self.lost += int(len(whole) - np.count_nonzero(whole))
            copied, expected = copied[whole], expected[whole]
        self.positions = expected - 1
        return copied["stamp"], copied["payload"]

    def stamps(self, start: int) -> tuple[int, NDArray[np.int64]]:
        """Stamps in ns (n,) of the records from position ``start`` on, read without being taken,
        and the position of the first: later than ``start`` where records were overwritten. One
        that is overwritten meanwhile shows a later record's stamp."""
        end = self.published
        first = max(start, end - self.capacity)
        return first, self._copy(self._slots["stamp"], first, end)

    def newest(self) -> tuple[int, bytes] | None:
        """Stamp and payload of the latest record, read without being taken; None if there is none
        or it is just being overwritten."""
        end = self.published
        slot = self._slots[(end - 1) % self.capacity : (end - 1) % self.capacity + 1].copy()
        if end == 0 or self._slots["position"][(end - 1) % self.capacity] != end:
            return None
        return int(slot["stamp"][0]), slot["payload"].tobytes()

    def _copy(self, column: NDArray[Scalar], start: int, stop: int) -> NDArray[Scalar]:
        """Rows of the positions from ``start`` to ``stop``, unwrapped."""
        first, last = start % self.capacity, (stop - 1) % self.capacity
        if start == stop:
            return column[:0].copy()
        if first <= last:
            return column[first : last + 1].copy()
        return np.concatenate((column[first:], column[: last + 1]))

    def commit(self, position: int | None = None) -> None:
        """Everything before ``position`` (all that was drained, if None) is safely stored: a later
        reader starts there."""
        self._words[_CURSOR_AT] = self.position if position is None else position

    def close(self) -> None:
        """Let go of the file; arrays that `drain` returned stay valid."""
        del self._words, self._slots, self._rows
        self._memory.close()


def _slots_at(meta_length: int) -> int:
    """Offset of the first slot, on a cache line."""
    return _padded(_META_START + meta_length, 64)
