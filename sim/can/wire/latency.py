"""How long frames take from their queue to the end of frame, by identifier."""

from __future__ import annotations

from array import array
from typing import TypedDict

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.sim.can.wire.frame import BASE_ID

_BATCH = 512
"""frames, some seventy ticks: few enough for the lab not to be late by their sorting"""
_MORE = 32
_PER_OCTAVE = 16
_FIRST_OCTAVE = 14
"""2^14 ns: shorter than any frame at 1 Mbit/s."""
_OCTAVES = 20
_BINS = _PER_OCTAVE * _OCTAVES
_EDGES_NS = 2.0 ** (_FIRST_OCTAVE + np.arange(1, _BINS + 1) / _PER_OCTAVE)
"""Upper edges: 16 to the octave, so a quantile is at most 4.5 % too high; to 17 s."""
_P99 = 0.99
_IDENTIFIER = 1
"""column of a row of an inbox whose lowest bits it is"""


class Summary(TypedDict):
    """Microseconds."""

    count: int
    mean_us: float
    p99_us: float
    max_us: float


@njit(cache=True)
def _add(
    row: int,
    span_ns: int,
    edges_ns: NDArray[np.float64],
    bins: NDArray[np.int64],
    sums: NDArray[np.int64],
) -> None:
    """A span to its row of the bins, and of the sums: count, total, longest."""
    bins[row, min(int(np.searchsorted(edges_ns, span_ns)), _BINS - 1)] += 1
    sums[row, 0] += 1
    sums[row, 1] += span_ns
    sums[row, 2] = max(sums[row, 2], span_ns)


@njit(cache=True)
def _count(
    rows: NDArray[np.int64],
    spans_ns: NDArray[np.int64],
    edges_ns: NDArray[np.float64],
    bins: NDArray[np.int64],
    sums: NDArray[np.int64],
) -> None:
    """`_add` each."""
    for i in range(rows.shape[0]):
        _add(rows[i], spans_ns[i], edges_ns, bins, sums)


@njit(
    "int64(int64, int64, int64[:, ::1], int64, int64[::1], float64[::1], int64[:, ::1],"
    " int64[:, ::1])",
    cache=True,
)
def _count_rows(
    first: int,
    count: int,
    frames: NDArray[np.int64],
    column: int,
    rows: NDArray[np.int64],
    edges_ns: NDArray[np.float64],
    bins: NDArray[np.int64],
    sums: NDArray[np.int64],
) -> int:
    """`_add` the times of the frames from number ``first`` on. ``rows``: (2048,) by identifier, -1
    where there is none. Returns the number of the first frame without one, or ``count``."""
    for i in range(first, count):
        row = rows[frames[i, _IDENTIFIER] & BASE_ID]
        if row < 0:
            return i
        _add(row, frames[i, column], edges_ns, bins, sums)
    return count


class Latency:
    """Collects cheaply, sorts in batches; holds one histogram for each identifier seen."""

    def __init__(self) -> None:
        self._rows: dict[int, int] = {}
        self._bins = np.zeros((0, _BINS), np.int64)
        self._sums = np.zeros((0, 3), np.int64)
        self._of = array("q")
        self._spans_ns = array("q")
        self._plain = np.full(BASE_ID + 1, -1, np.int64)
        """row by identifier, of those that `add_rows` has met"""
        self._sort()  # compiles it while nobody waits

    def add(self, identifier: int, span_ns: int) -> None:
        row = self._rows.get(identifier)
        self._of.append(self._new(identifier) if row is None else row)
        self._spans_ns.append(span_ns)
        if len(self._spans_ns) >= _BATCH:
            self._sort()

    def add_rows(self, frames: NDArray[np.int64], count: int, column: int) -> None:
        """`add` of the first ``count`` data frames with base identifiers: rows as an inbox has
        them, their times, ns, in a ``column`` behind."""
        number = 0
        while True:
            number = _count_rows(
                number, count, frames, column, self._plain, _EDGES_NS, self._bins, self._sums
            )
            if number == count:
                return
            identifier = int(frames[number, _IDENTIFIER]) & BASE_ID
            row = self._rows.get(identifier)
            self._plain[identifier] = self._new(identifier) if row is None else row

    def _new(self, identifier: int) -> int:
        row = self._rows[identifier] = len(self._rows)
        if row >= len(self._bins):
            self._bins = np.concatenate((self._bins, np.zeros((_MORE, _BINS), np.int64)))
            self._sums = np.concatenate((self._sums, np.zeros((_MORE, 3), np.int64)))
        return row

    def _sort(self) -> None:
        rows, spans_ns = np.array(self._of, np.int64), np.array(self._spans_ns, np.int64)
        _count(rows, spans_ns, _EDGES_NS, self._bins, self._sums)
        del self._of[:], self._spans_ns[:]

    def summary(self) -> dict[int, Summary]:
        """By identifier with the flags of `tonus.sim.can.wire.timing`."""
        self._sort()
        return {name: self._summary(self._rows[name]) for name in sorted(self._rows)}

    def _summary(self, row: int) -> Summary:
        count, total_ns, max_ns = self._sums[row].tolist()
        place = int(np.searchsorted(np.cumsum(self._bins[row]), _P99 * count))
        return Summary(
            count=count,
            mean_us=total_ns / count / 1e3,
            p99_us=min(float(_EDGES_NS[place]), max_ns) / 1e3,
            max_us=max_ns / 1e3,
        )
