"""Records of a run that stay in memory, each with its time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_FIRST_BYTES = 1 << 22
"""from this size on numpy asks for large pages: with small ones the faults, one or two a tick, take
as long as a stage of control"""


class Kept:
    """Records of one type. Each is copied as its bytes: numpy copies a record field by field, which
    takes a hundred times as long."""

    def __init__(self, dtype: np.dtype[Any], stride_ns: int = 1) -> None:
        """``stride_ns``: only what is published at a multiple of it is kept."""
        self._dtype, self._stride_ns = dtype, stride_ns
        self._room = np.empty(_FIRST_BYTES, np.uint8).data
        self._end = 0
        """bytes in use"""
        self._stamps: list[int] = []
        self._source: NDArray[Any] | None = None
        """what was published last, mostly one array that is written anew each time"""
        self._data = memoryview(b"")
        """its bytes"""

    def publish(self, payload: NDArray[Any], stamp_ns: int) -> None:
        """Keep ``payload``, an array of one."""
        if stamp_ns % self._stride_ns:
            return
        if payload is not self._source:
            self._source, self._data = payload, payload.view(np.uint8).data
        data = self._data
        end = self._end + len(data)
        if end > len(self._room):
            self._grow()
        self._room[self._end : end] = data
        self._end = end
        self._stamps.append(stamp_ns)

    def _grow(self) -> None:
        room = np.empty(2 * len(self._room), np.uint8).data
        room[: self._end] = self._room[: self._end]
        self._room = room

    @property
    def rows(self) -> NDArray[Any]:
        """(n,), read-only"""
        return np.frombuffer(self._room[: self._end].toreadonly(), self._dtype)

    @property
    def last(self) -> np.void | None:
        """The newest record."""
        rows = self.rows
        newest: np.void | None = rows[-1] if len(rows) else None
        return newest

    @property
    def stamps(self) -> NDArray[np.int64]:
        """(n,) ns"""
        return np.array(self._stamps, np.int64)
