"""What a host has received and not taken yet: rows of an array, as they travel."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tonus.sim.can.wire.frame import REMOTE, Frame

FRAME = struct.Struct("<QIBB2x8s")
"""Time (ns), identifier with flags, DLC, 1 for one's own, data."""
FRAMES = np.dtype(
    [
        ("stamp_ns", "<i8"),
        ("identifier", "<u4"),
        ("dlc", "u1"),
        ("own", "u1"),
        ("padding", "<u2"),
        ("data", "<i8"),  # the eight bytes
    ]
)
"""`FRAME` again, for many at once."""
WORDS = FRAMES.itemsize // 8
"""64-bit words of a frame"""
_FIRST_SIZE = 256


class Received(NamedTuple):
    """A frame as a host has it."""

    stamp_ns: int
    identifier: int
    """with flags"""
    dlc: int
    own: bool
    data: bytes


class Inbox:
    """A host's receive queue: of finite depth, what does not fit is missed, and counted."""

    def __init__(self, depth: int | None) -> None:
        self.missed = 0
        """frames that did not fit"""
        self._depth = depth
        self._begin = self._end = 0
        self._hold(_FIRST_SIZE)

    def _hold(self, size: int) -> None:
        self._frames = np.zeros(size, FRAMES)
        self._rows = self._frames.view(np.int64).reshape(size, WORDS)
        self._memory = self._frames.view(np.uint8).data

    def __len__(self) -> int:
        return self._end - self._begin

    def _make_room(self, count: int) -> None:
        """Let ``count`` more rows fit behind the last."""
        if self._begin == self._end:
            self._begin = self._end = 0
        if self._end + count <= len(self._frames):
            return
        kept = self._frames[self._begin : self._end].copy()
        if len(kept) + count > len(self._frames) // 2:
            self._hold(2 * len(self._frames) + count)
        self._begin, self._end = 0, len(kept)
        self._frames[: self._end] = kept

    def append(self, frame: Frame, *, own: bool = False) -> None:
        if self._depth is not None and len(self) >= self._depth:
            self.missed += 1
            return
        self._make_room(1)
        at = self._end * FRAME.size
        identifier, dlc, data = frame.identifier, frame.dlc, frame.data
        FRAME.pack_into(self._memory, at, frame.stamp_ns, identifier, dlc, own, data)
        self._end += 1

    def extend(self, rows: NDArray[np.int64]) -> None:
        """Append frames, (n, `WORDS`)."""
        count = len(rows)
        if self._depth is not None and len(self) + count > self._depth:
            fit = max(self._depth - len(self), 0)
            self.missed += count - fit
            rows, count = rows[:fit], fit
        self._make_room(count)
        self._rows[self._end : self._end + count] = rows
        self._end += count

    def __iter__(self) -> Iterator[Received]:
        """Every frame, oldest first; none is taken."""
        return map(self._received, range(self._begin, self._end))

    def pop(self) -> Received:
        """Take the oldest frame. Raises IndexError if there is none."""
        if self._begin == self._end:
            raise IndexError("the inbox is empty")
        self._begin += 1
        return self._received(self._begin - 1)

    def _received(self, row: int) -> Received:
        at = row * FRAME.size
        stamp_ns, identifier, dlc, own, data = FRAME.unpack_from(self._memory, at)
        length = 0 if identifier & REMOTE else min(dlc, 8)
        return Received(stamp_ns, identifier, dlc, bool(own), data[:length])

    def take(self, limit: int) -> NDArray[np.void]:
        """The oldest frames, ``limit`` at most, as a copy: (n,) of `FRAMES`."""
        end = min(self._end, self._begin + limit)
        taken: NDArray[np.void] = self._frames[self._begin : end].copy()
        self._begin = end
        return taken

    def clear(self) -> None:
        self._begin = self._end = 0
