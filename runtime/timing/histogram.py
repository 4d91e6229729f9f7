"""A histogram of times in fixed memory: whatever comes, adding is one increment."""

from __future__ import annotations

from array import array
from collections.abc import Iterator

_FINE_BITS = 5
_FINE = 1 << _FINE_BITS
_MAGNITUDES = 36
_BINS = _FINE * (_MAGNITUDES + 1)
RESOLUTION = 1.0 / _FINE
"""relative width of a bin, at most"""


class Histogram:
    """Counts of nanoseconds in bins as wide as 1/32 of their magnitude, from 1 ns to half an hour;
    what is longer counts in the last bin, and what is negative in the first."""

    def __init__(self) -> None:
        self.count = 0
        self.largest = 0
        """ns, exact"""
        self._bins = array("q", bytes(8 * _BINS))

    def add(self, nanoseconds: int) -> None:
        self.count += 1
        if nanoseconds > self.largest:
            self.largest = nanoseconds
        if nanoseconds < _FINE:
            self._bins[max(0, nanoseconds)] += 1
            return
        shift = nanoseconds.bit_length() - _FINE_BITS - 1
        place = (shift << _FINE_BITS) + (nanoseconds >> shift)
        self._bins[place if place < _BINS else _BINS - 1] += 1

    def merge(self, other: Histogram) -> None:
        """Take in what another has counted."""
        self.count += other.count
        self.largest = max(self.largest, other.largest)
        for place, count in enumerate(other._bins):
            self._bins[place] += count

    def at(self, share: float) -> int:
        """The least bin's upper end, ns, that ``share`` (0 to 1) of all counts do not exceed; 0
        without any. Never beyond the largest value added."""
        wanted, seen = share * self.count, 0
        for upper, count in self.filled():
            seen += count
            if seen >= wanted:
                return min(upper, self.largest)
        return 0

    def beyond(self, nanoseconds: int) -> int:
        """How many counts lie in bins that begin later."""
        return sum(
            count for place, count in enumerate(self._bins) if count and _lower(place) > nanoseconds
        )

    def filled(self) -> Iterator[tuple[int, int]]:
        """(upper end in ns, count) of every bin that has one, in order."""
        for place, count in enumerate(self._bins):
            if count:
                yield _lower(place + 1) - 1, count


def _lower(place: int) -> int:
    """First value of a bin, ns."""
    shift = max((place >> _FINE_BITS) - 1, 0)
    return (place - (shift << _FINE_BITS)) << shift
