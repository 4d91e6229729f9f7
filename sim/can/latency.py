"""How long frames take from their queue to the end of frame, by identifier."""

from __future__ import annotations

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

_BATCH = 4096
_PER_OCTAVE = 16
_FIRST_OCTAVE = 14
"""2^14 ns: shorter than any frame at 1 Mbit/s."""
_OCTAVES = 20
_BINS = _PER_OCTAVE * _OCTAVES
_EDGES_NS = 2.0 ** (_FIRST_OCTAVE + np.arange(1, _BINS + 1) / _PER_OCTAVE)
"""Upper edges: 16 to the octave, so a quantile is at most 4.5 % too high; to 17 s."""
_P99 = 0.99


class Summary(TypedDict):
    """Microseconds."""

    count: int
    mean_us: float
    p99_us: float
    max_us: float


class _Histogram:
    def __init__(self) -> None:
        self.count = 0
        self.sum_ns = 0
        self.max_ns = 0
        self.bins = np.zeros(_BINS, np.int64)

    def add(self, spans_ns: NDArray[np.int64]) -> None:
        self.count += len(spans_ns)
        self.sum_ns += int(spans_ns.sum())
        self.max_ns = max(self.max_ns, int(spans_ns.max()))
        places = np.minimum(np.searchsorted(_EDGES_NS, spans_ns), _BINS - 1)
        self.bins += np.bincount(places, minlength=_BINS)

    def summary(self) -> Summary:
        place = int(np.searchsorted(np.cumsum(self.bins), _P99 * self.count))
        return Summary(
            count=self.count,
            mean_us=self.sum_ns / self.count / 1e3,
            p99_us=min(float(_EDGES_NS[place]), self.max_ns) / 1e3,
            max_us=self.max_ns / 1e3,
        )


class Latency:
    """Collects cheaply, sorts in batches; holds one histogram for each identifier seen."""

    def __init__(self) -> None:
        self._identifiers: list[int] = []
        self._spans_ns: list[int] = []
        self._histograms: dict[int, _Histogram] = {}

    def add(self, identifier: int, span_ns: int) -> None:
        self._identifiers.append(identifier)
        self._spans_ns.append(span_ns)
        if len(self._spans_ns) >= _BATCH:
            self._sort()

    def _sort(self) -> None:
        identifiers = np.array(self._identifiers, np.int64)
        spans_ns = np.array(self._spans_ns, np.int64)
        self._identifiers.clear()
        self._spans_ns.clear()
        for identifier in np.unique(identifiers):
            histogram = self._histograms.setdefault(int(identifier), _Histogram())
            histogram.add(spans_ns[identifiers == identifier])

    def summary(self) -> dict[int, Summary]:
        """By identifier with the flags of `sim.can.timing`."""
        self._sort()
        return {name: self._histograms[name].summary() for name in sorted(self._histograms)}
