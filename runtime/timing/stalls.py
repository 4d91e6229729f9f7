"""Times for which the whole host stood still, seen by a second process on another processor.

A hypervisor that stops a virtual machine, or firmware that stops every processor (SMI), need not
tell: the clock of a thread that computes runs on meanwhile. A watch that does nothing but wake up
every half millisecond is late by the same time, and by nothing that the computing thread does.
"""

from __future__ import annotations

import ctypes
import mmap
import struct

from tonus.runtime.timing.clock import Stopwatch

BYTES = 16
_SHARED = struct.Struct("qq")
"""when the watch is due (ns), how late it has been so far (ns)"""
_TIMESPEC = struct.Struct("qq")
_CLOCK_MONOTONIC, _TIMER_ABSTIME = 1, 1
_SECOND_NS = 1_000_000_000
_LATE_NS = 200_000
"""Below it the watch was only kept waiting, by a kernel or by other threads."""
_MOST_NS = 100_000_000
"""A watch that is later than that is no witness any more: it has ended."""


class Stalls:
    """What the watch has seen, for who is to be judged by it; ``shared`` holds `BYTES`."""

    def __init__(self, shared: mmap.mmap) -> None:
        self._shared = shared

    def until(self, now_ns: int) -> int:
        """ns so far, with a stall that may not have ended yet. At most the watch's period less than
        there were."""
        # One copy of 16 bytes, which the watch writes as one.
        due_ns, stalled_ns = _SHARED.unpack(self._shared[:BYTES])
        late_ns = now_ns - due_ns
        return int(stalled_ns + min(late_ns, _MOST_NS) if late_ns > _LATE_NS else stalled_ns)


class StallWatch:
    """The watch itself, in a process and on a processor of its own."""

    def __init__(self, shared: mmap.mmap, period_ns: int) -> None:
        self._shared, self._period_ns = shared, period_ns
        self._libc = ctypes.CDLL(None)
        self._until = ctypes.create_string_buffer(_TIMESPEC.size)
        self._now_ns = Stopwatch(running=True).wall_ns
        self._stalled_ns = 0
        self._next(self._now_ns())

    def wait(self) -> None:
        """Until it is due, and count by how much that was late."""
        _TIMESPEC.pack_into(self._until, 0, *divmod(self._due_ns, _SECOND_NS))
        # A signal may end it early, which counts as no stall.
        self._libc.clock_nanosleep(_CLOCK_MONOTONIC, _TIMER_ABSTIME, self._until, None)
        now_ns = self._now_ns()
        late_ns = now_ns - self._due_ns
        if late_ns > _LATE_NS:
            self._stalled_ns += min(late_ns, _MOST_NS)
        self._next(now_ns)

    def _next(self, now_ns: int) -> None:
        self._due_ns = now_ns + self._period_ns
        self._shared[:BYTES] = _SHARED.pack(self._due_ns, self._stalled_ns)
