"""Records of a run that stay in memory, each with its time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


class Kept:
    """Records of one type. Each is kept as its bytes: numpy copies a record field by field, which
    takes a hundred times as long."""

    def __init__(self, dtype: np.dtype[Any], stride_ns: int = 1) -> None:
        """``stride_ns``: only what is published at a multiple of it is kept."""
        self._dtype, self._stride_ns = dtype, stride_ns
        self._rows: list[bytes] = []
        self._stamps: list[int] = []

    def publish(self, payload: NDArray[Any], stamp_ns: int) -> None:
        """Keep ``payload``, an array of one."""
        data = payload.tobytes()
        if stamp_ns % self._stride_ns == 0 and self._wanted(data):
            self._rows.append(data)
            self._stamps.append(stamp_ns)

    def _wanted(self, data: bytes) -> bool:
        """Whether a record is one of those to be kept: all are."""
        del data
        return True

    @property
    def rows(self) -> NDArray[Any]:
        """(n,), read-only"""
        return np.frombuffer(b"".join(self._rows), self._dtype)

    @property
    def last(self) -> np.void | None:
        """The newest record."""
        newest: np.void | None = (
            np.frombuffer(self._rows[-1], self._dtype)[0] if self._rows else None
        )
        return newest

    @property
    def stamps(self) -> NDArray[np.int64]:
        """(n,) ns"""
        return np.array(self._stamps, np.int64)
