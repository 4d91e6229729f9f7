"""A bus's times of reception, on our clock."""

from __future__ import annotations

SAME_CLOCK_NS = 1_000_000_000
"""A stamp further than this from our clock comes from another clock."""
WINDOW_NS = 1_000_000_000
"""How long the least delay is looked for: two clocks drift apart by some 50 us in it."""


class Stamps:
    """The lab stamps with the loop's own clock, which is taken as it is. Other interfaces have a
    clock of their own, for which the least delay seen lately stands for the difference of the two;
    some stamp nothing, and a frame counts as arriving when it is read.
    """

    __slots__ = ("_least_ns", "_offset_ns", "_window_ns", "exact")

    def __init__(self) -> None:
        self.exact = False
        """the bus's clock is ours"""
        self._offset_ns: int | None = None
        self._least_ns = SAME_CLOCK_NS
        self._window_ns = 0

    def of(self, stamp: int, now_ns: int) -> int:
        """When a frame with this time stamp (ns) arrived, ns; never later than ``now_ns``."""
        if not stamp:
            return now_ns
        if self.exact:
            return min(stamp, now_ns)
        if self._offset_ns is None:
            self.exact = abs(now_ns - stamp) <= SAME_CLOCK_NS
            self._offset_ns = 0
            if self.exact:
                return min(stamp, now_ns)
        stamp += self._offset_ns
        delay = now_ns - stamp
        if not 0 <= delay <= SAME_CLOCK_NS:
            self._offset_ns += delay
            self._least_ns, self._window_ns = SAME_CLOCK_NS, now_ns + WINDOW_NS
            return now_ns
        self._least_ns = min(self._least_ns, delay)
        if now_ns >= self._window_ns:
            self._offset_ns += self._least_ns
            self._least_ns, self._window_ns = SAME_CLOCK_NS, now_ns + WINDOW_NS
        return stamp
