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
        ("channel", "<u2"),  # of frames of several channels in one array, counted from the first
        ("data", "<i8"),  # the eight bytes
    ]
)
"""`FRAME` again, for many at once."""
WORDS = FRAMES.itemsize // 8
"""64-bit words of a frame"""
_SIZE = FRAMES.itemsize
_unpack = FRAME.unpack_from
_FIRST_SIZE = 256


RawFrame = tuple[int, int, int, bool, bytes]
"""Time (ns), identifier with flags, DLC, whether it is one's own, data."""


class Received(NamedTuple):
    """A frame as a host has it; the fields of a `RawFrame`."""

    stamp_ns: int
    identifier: int
    dlc: int
    own: bool
    data: bytes


def pack(frame: Frame, *, own: bool = False) -> bytes:
    """A frame that has ended, as a row."""
    return FRAME.pack(frame.stamp_ns, frame.identifier, frame.dlc, own, frame.data)


class Inbox:
    """A host's receive queue: of finite depth, what does not fit is missed, and counted."""

    def __init__(self, depth: int | None) -> None:
        self.missed = 0
        """frames that did not fit"""
        self._depth = depth
        self._begin = self.end = 0
        """rows of the oldest frame, and behind the newest"""
        self._hold(_FIRST_SIZE)

    def _hold(self, size: int) -> None:
        self._frames = np.zeros(size, FRAMES)
        self.rows = self._frames.view(np.int64).reshape(size, WORDS)
        self._memory = self._frames.view(np.uint8).data

    def __len__(self) -> int:
        return self.end - self._begin

    def _make_room(self, count: int) -> None:
        """Let ``count`` more rows fit behind the last."""
        kept = self._frames[self._begin : self.end].copy()
        if len(kept) + count > len(self._frames) // 2:
            self._hold(2 * len(self._frames) + count)
        self._begin, self.end = 0, len(kept)
        self._frames[: self.end] = kept

    def holds(self, count: int) -> bool:
        """Whether ``count`` more frames may be written into `rows` from `end` on."""
        if self._depth is not None and len(self) + count > self._depth:
            return False
        if self.end + count > self.rows.shape[0]:
            self._make_room(count)
        return True

    def append(self, row: bytes) -> None:
        """A frame as `pack` gives it."""
        if self._depth is not None and len(self) >= self._depth:
            self.missed += 1
            return
        end = self.end
        if end == self.rows.shape[0]:
            self._make_room(1)
            end = self.end
        self._memory[end * _SIZE : end * _SIZE + _SIZE] = row
        self.end = end + 1

    def extend(self, rows: NDArray[np.int64]) -> None:
        """Frames as rows (n, `WORDS`)."""
        count = len(rows)
        if self._depth is not None and len(self) + count > self._depth:
            fit = max(self._depth - len(self), 0)
            self.missed += count - fit
            rows, count = rows[:fit], fit
        if self.end + count > len(self._frames):
            self._make_room(count)
        self.rows[self.end : self.end + count] = rows
        self.end += count

    def __iter__(self) -> Iterator[Received]:
        """Every frame, oldest first; none is taken."""
        begin, frames = self._begin, []
        while (frame := self.pop()) is not None:
            frames.append(Received(*frame))
        self._begin = begin
        return iter(frames)

    def pop(self) -> RawFrame | None:
        """Take the oldest frame; None if there is none."""
        begin = self._begin
        if begin == self.end:
            return None
        self._begin = begin + 1
        stamp_ns, identifier, dlc, own, data = _unpack(self._memory, begin * _SIZE)
        if identifier & REMOTE:
            data = b""
        elif dlc < 8:
            data = data[:dlc]
        return stamp_ns, identifier, dlc, own != 0, data

    def take(self, limit: int) -> NDArray[np.void]:
        """The oldest frames, ``limit`` at most, as a copy: (n,) of `FRAMES`."""
        begin = self._begin
        self._begin = end = min(self.end, begin + limit)
        taken = np.frombuffer(self._memory[begin * _SIZE : end * _SIZE].tobytes(), FRAMES)
        if end == self.end:
            self._begin = self.end = 0
        return taken

    def clear(self) -> None:
        self._begin = self.end = 0
