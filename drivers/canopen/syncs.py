"""Which SYNC a PDO answers: the SYNCs of a channel, and each node's account of its answers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.bus import Master
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import NOT_YET

HISTORY = 64
"""SYNCs remembered; more than `Master.late_ticks` may ask for."""
FRAME_BITS = 44
"""A frame without data, and no bit stuffed, up to the end of frame."""
INTERFRAME_BITS = 3
ANSWER = np.dtype(
    [
        ("answered", "i8"),  # newest SYNC that has been
        ("period", "i8"),  # newest SYNC after which an answer came
        ("fresh", "i8"),  # the node was reset, and has not answered since
        ("data", "i8"),  # of the last answer
        ("stamp_ns", "i8"),  # when it came
        ("bits", "i8"),  # of a SYNC and an answer, in a row
        ("size", "i8"),  # bytes of an answer
        ("first", "i8"),  # of its fields
        ("fields", "i8"),
    ]
)
"""What is known of a node's answers; the last three are for who takes them apart."""
_PERIOD = 1
"""place of the period among them"""


class SyncTable:
    """The `Syncs` of several channels, a row each, where compiled code reads them."""

    def __init__(self, channels: int) -> None:
        self.counts = np.zeros(channels, np.int64)
        self.stamps_ns = np.zeros(channels, np.int64)
        self.bits_ns = np.zeros(channels, np.int64)
        self.ticks = np.full((channels, HISTORY), NOT_YET)
        self.times_ns = np.zeros((channels, HISTORY), np.int64)
        self.doubts_ns = np.zeros((channels, HISTORY), np.int64)


class Syncs:
    """The last SYNCs of one channel, numbered from 1."""

    __slots__ = (
        "_bits",
        "_counts",
        "_doubts",
        "_of_ticks",
        "_row",
        "_sent_ns",
        "_stamps",
        "doubts_ns",
        "ticks",
        "times_ns",
    )  # fmt: skip

    def __init__(self, table: SyncTable | None = None, row: int = 0) -> None:
        """``row`` of ``table``; None: of one by itself."""
        table = table or SyncTable(1)
        self._row = row
        self.ticks, self.times_ns = table.ticks[row], table.times_ns[row]
        self.doubts_ns = table.doubts_ns[row]
        # Python reads and writes single words of a memoryview in a third of an array's time.
        self._of_ticks: memoryview[int] = self.ticks.data
        self._sent_ns: memoryview[int] = self.times_ns.data
        self._doubts: memoryview[int] = self.doubts_ns.data
        self._counts: memoryview[int] = table.counts.data
        self._stamps: memoryview[int] = table.stamps_ns.data
        self._bits: memoryview[int] = table.bits_ns.data

    @property
    def count(self) -> int:
        """of the newest"""
        return self._counts[self._row]

    @property
    def stamp_ns(self) -> int:
        """when the frame in hand arrived; whoever receives sets it"""
        return self._stamps[self._row]

    @stamp_ns.setter
    def stamp_ns(self, stamp_ns: int) -> None:
        self._stamps[self._row] = stamp_ns

    @property
    def bit_ns(self) -> int:
        """time of a bit where stamps are exact, else 0; whoever sends sets it"""
        return self._bits[self._row]

    @bit_ns.setter
    def bit_ns(self, bit_ns: int) -> None:
        self._bits[self._row] = bit_ns

    @property
    def answered_ns(self) -> int:
        """From the last SYNC to the last frame heard since; 0 without one."""
        count = self.count
        return max(self.stamp_ns - self._sent_ns[count % HISTORY], 0) if count else 0

    def of(self, tick: int) -> tuple[int, int, int]:
        """``tick``, and time and doubt (ns) of its SYNC: 0 for one that is no longer known."""
        for place in np.flatnonzero(self.ticks == tick).tolist():
            return tick, int(self.times_ns[place]), int(self.doubts_ns[place])
        return tick, 0, 0

    def sent(self, tick: int, now_ns: int, doubt_ns: int = 0) -> None:
        """At ``now_ns`` or up to ``doubt_ns`` later: a host may take the processor meanwhile."""
        count = self._counts[self._row] = self.count + 1
        place = count % HISTORY
        self._of_ticks[place] = tick
        self._sent_ns[place] = now_ns
        self._doubts[place] = doubt_ns


class Arrival:
    """Books one node's PDOs to the SYNCs they answer.

    A PDO carries no tick. The first of a period answers the SYNC that began it, unless an earlier
    one is open: then every measurement counts as so many periods older as there are open SYNCs,
    and where two arrive in one period, as old as the oldest. A SYNC is no longer open when a second
    PDO in one period has made up for it, when it is ``late_ticks`` SYNCs old, or when
    ``settle_ticks`` periods in a row brought one PDO each: then the gap was a loss and no delay.
    A second PDO with the data of the first and less than ``copy_us`` behind it may be a copy, and
    makes up for nothing.
    A PDO that had arrived before a SYNC and itself could have crossed the wire does not answer it,
    however late it is read.

    Never newer than the truth, as long as the node sends its answers in order, a copy right behind
    its original, and trouble does not last longer than ``settle_ticks``. A node that is a whole
    period late for longer is not seen through.
    """

    __slots__ = (
        "_answer", "_bits", "_copy_ns", "_events", "_gap", "_late", "_period", "_settle", "_streak",
        "_syncs", "_where", "frame_bits",
    )  # fmt: skip

    def __init__(
        self,
        size: int,
        syncs: Syncs,
        master: Master,
        events: EventLog,
        where: str,
        answer: np.void | None = None,
    ) -> None:
        """``size`` is the PDO's in bytes. ``answer`` (`ANSWER`) is kept where compiled code, which
        books regular answers itself (`Reception`), sees it."""
        self._bits = 2 * FRAME_BITS + INTERFRAME_BITS + 8 * size
        self._answer = np.zeros(1, ANSWER)[0] if answer is None else answer
        self._answer["bits"] = self._bits
        # Python reads single words of a memoryview in a fifth of a record's time.
        words: NDArray[np.int64] = np.asarray(self._answer).reshape(1).view(np.int64)
        self._period: memoryview[int] = words[_PERIOD : _PERIOD + 1].data
        self.frame_bits = FRAME_BITS + INTERFRAME_BITS + 8 * size
        self._syncs = syncs
        self._late = master.late_ticks
        self._settle = master.settle_ticks
        self._copy_ns = master.copy_us * 1000
        self._events = events
        self._where = where
        self._gap = self._streak = 0

    def begin(self) -> None:
        """The node was reset: nothing it owed will come, and its next answer is not late."""
        self._keep(self._syncs.count, self._syncs.count)
        self._gap = self._streak = 0
        self._answer["fresh"] = 1

    @property
    def silence(self) -> int:
        """SYNCs since the last PDO."""
        return self._syncs.count - self._period[0]

    def book(self, data: bytes) -> int | None:
        """Account for the frame in hand: the tick its data were sampled in, or None if they are not
        to be used."""
        syncs, events, where = self._syncs, self._events, self._where
        answer = self._answer
        newest = syncs.count
        oldest = max(newest - self._late, 1)
        period = newest
        sent_ns = syncs.stamp_ns - self._bits * syncs.bit_ns
        while period >= oldest and sent_ns < syncs.times_ns[period % HISTORY]:
            period -= 1
        if period < oldest:
            if newest:
                events.counted("late_pdo", where, f"an answer came {self._late} SYNCs late")
            return None
        if answer["fresh"]:
            answer["fresh"] = 0
            self._keep(period - 1, period - 1)
        answered, before, word = int(answer["answered"]), int(answer["period"]), word_of(data)
        self._keep(answered, max(period, before))
        stamp_ns, last_ns = syncs.stamp_ns, int(answer["stamp_ns"])
        again = word == answer["data"] and stamp_ns - last_ns < self._copy_ns
        if period <= answered or (period <= before and again):
            events.counted("duplicate_pdo", where, "a second answer to one SYNC")
            return None
        answers = max(answered + 1, oldest)
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
        answer["answered"], answer["data"], answer["stamp_ns"] = answers, word, stamp_ns
        if answers == period:
            self._gap = 0
        return int(syncs.ticks[booked % HISTORY])

    def _keep(self, answered: int, period: int) -> None:
        self._answer["answered"], self._answer["period"] = answered, period


def word_of(data: bytes) -> int:
    """Up to eight bytes as one signed number, little-endian."""
    return int.from_bytes(data.ljust(8, b"\0"), "little", signed=True)
