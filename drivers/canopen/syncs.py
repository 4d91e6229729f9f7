"""Which SYNC a PDO answers: the SYNCs of a channel, and each node's account of its answers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from config.schema.bus import Master
from drivers.events import EventLog
from drivers.exchange import NOT_YET

HISTORY = 64
"""SYNCs remembered; more than `Master.late_ticks` may ask for."""
FRAME_BITS = 44
"""A frame without data, and no bit stuffed, up to the end of frame."""
INTERFRAME_BITS = 3


class Syncs:
    """The last SYNCs of one channel, numbered from 1.

    ``stamp_ns`` is when the frame in hand arrived, and ``bit_ns`` the time of a bit where stamps
    are exact, else 0; whoever receives sets them.
    """

    __slots__ = ("bit_ns", "count", "stamp_ns", "ticks", "times_ns")

    def __init__(self) -> None:
        self.count = 0
        self.stamp_ns = 0
        self.bit_ns = 0
        self.ticks = [NOT_YET] * HISTORY
        self.times_ns = [0] * HISTORY

    @property
    def answered_ns(self) -> int:
        """From the last SYNC to the last frame heard since; 0 without one."""
        return max(self.stamp_ns - self.times_ns[self.count % HISTORY], 0) if self.count else 0

    def sent(self, tick: int, now_ns: int) -> None:
        self.count += 1
        place = self.count % HISTORY
        self.ticks[place] = tick
        self.times_ns[place] = now_ns


class Arrival:
    """Books one node's PDOs to the SYNCs they answer.

    A PDO carries no tick. The first of a period answers the SYNC that began it, unless an earlier
    one is open: then every measurement counts as so many periods older as there are open SYNCs,
    and where two arrive in one period, as old as the oldest. A SYNC is no longer open when a second
    PDO in one period has made up for it, when it is ``late_ticks`` SYNCs old, or when
    ``settle_ticks`` periods in a row brought one PDO each: then the gap was a loss and no delay.
    A second PDO with the data of the first may be a copy, and makes up for nothing.
    A PDO that had arrived before a SYNC and itself could have crossed the wire does not answer it,
    however late it is read.

    Never newer than the truth, as long as the node sends its answers in order, a copy right behind
    its original, and trouble does not last longer than ``settle_ticks``. A node that is a whole
    period late for longer is not seen through.
    """

    __slots__ = (
        "_answered", "_bits", "_data", "_events", "_fresh", "_gap", "_late", "_period", "_rows",
        "_settle", "_streak", "_syncs", "_ticks", "_where",
    )  # fmt: skip

    def __init__(
        self,
        rows: tuple[int, ...],
        ticks: NDArray[np.int64],
        size: int,
        syncs: Syncs,
        master: Master,
        events: EventLog,
        where: str,
    ) -> None:
        """``ticks[row]`` for each of ``rows`` gets the tick that was sampled; ``size`` is the PDO's
        in bytes."""
        self._bits = 2 * FRAME_BITS + INTERFRAME_BITS + 8 * size
        self._rows = rows
        self._ticks = ticks
        self._syncs = syncs
        self._late = master.late_ticks
        self._settle = master.settle_ticks
        self._events = events
        self._where = where
        self._answered = self._period = self._gap = self._streak = 0
        self._fresh = False
        self._data: bytes = b""

    def begin(self) -> None:
        """The node was reset: nothing it owed will come, and its next answer is not late."""
        self._answered = self._period = self._syncs.count
        self._gap = self._streak = 0
        self._fresh = True

    @property
    def silence(self) -> int:
        """SYNCs since the last PDO."""
        return self._syncs.count - self._period

    def book(self, data: bytes) -> bool:
        """Account for the frame in hand; False if its data are not to be used."""
        syncs = self._syncs
        newest = syncs.count
        if (
            self._answered + 1 != newest
            or self._period == newest
            or self._fresh
            or syncs.stamp_ns < syncs.times_ns[newest % HISTORY] + self._bits * syncs.bit_ns
        ):
            return self._irregular(newest, data)
        self._answered = self._period = newest
        self._data = data
        tick = syncs.ticks[newest % HISTORY]
        for row in self._rows:
            self._ticks[row] = tick
        return True

    def _irregular(self, newest: int, data: bytes) -> bool:
        """Any PDO but the first in its period from a node that owes no other."""
        syncs, events, where = self._syncs, self._events, self._where
        oldest = max(newest - self._late, 1)
        period = newest
        sent_ns = syncs.stamp_ns - self._bits * syncs.bit_ns
        while period >= oldest and sent_ns < syncs.times_ns[period % HISTORY]:
            period -= 1
        if period < oldest:
            if newest:
                events.counted("late_pdo", where, f"an answer came {self._late} SYNCs late")
            return False
        if self._fresh:
            self._fresh = False
            self._answered = self._period = period - 1
        before, self._period = self._period, max(period, self._period)
        if period <= self._answered or (period <= before and data == self._data):
            events.counted("duplicate_pdo", where, "a second answer to one SYNC")
            return False
        answers = max(self._answered + 1, oldest)
        if period > before + 1:
            text = f"SYNCs without an answer: {period - before - 1}"
            events.counted("missing_pdo", where, text)
            if not self._gap:
                self._gap = before + 1
            self._streak = 0
        elif period <= before:
            events.counted("late_pdo", where, "an answer came after the next SYNC")
            self._streak = 0
        elif self._gap:
            self._streak += 1
            if self._streak >= self._settle:
                answers, self._gap = period, 0
        booked = max(self._gap, oldest) if self._gap and period <= before else answers
        self._answered, self._data = answers, data
        if answers == period:
            self._gap = 0
        tick = syncs.ticks[booked % HISTORY]
        for row in self._rows:
            self._ticks[row] = tick
        return True
