"""Where a frame stands against the slaves' common clock and its SYNC0."""

from __future__ import annotations

from collections import deque

from tonus.config.schema.bus import DistributedClocks

_FITS_TICKS = 4
"""The reference clock in a frame may be off by so much: a frame can leave late, and indices repeat
after 16."""
_REMEMBERED = 64


class Phase:
    """Times are ns; ``reference`` is the reference clock when it was passed by the frame, which we
    sent at ``sent`` by our own."""

    def __init__(self, clocks: DistributedClocks, period_ns: int) -> None:
        self.sync0_ns = 0
        """SYNC0 comes whenever the common time is this after a multiple of the period"""
        self._period_ns = period_ns
        self._shift_ns = round(clocks.shift_us * 1e3)
        self._guard_ns = clocks.guard_us * 1e3
        self._ahead_ns: int | None = None
        self._known_ahead_ns: int | None = None
        self._pulses: deque[int] = deque(maxlen=_REMEMBERED)
        """SYNC0's number less the tick's: the least is that of a frame that was on time"""
        self._continues = False
        """the last sample's time is on the same clock as the next one's"""

    @property
    def known(self) -> bool:
        """The last frame told how far the reference clock is ahead of ours."""
        return self._ahead_ns is not None

    def align(self, ahead_ns: int) -> None:
        """The clocks have been set, so far ahead of ours."""
        self.sync0_ns = (ahead_ns + self._shift_ns) % self._period_ns

    def forget(self) -> None:
        """What frames have told so far was told by other clocks."""
        self._known_ahead_ns = None
        self._pulses.clear()
        self._continues = False

    def count_anew(self) -> None:
        """Ticks begin again, from another number."""
        self._pulses.clear()

    def lose(self) -> None:
        """The last frame did not come back."""
        self._ahead_ns = None

    def fits(self, reference_ns: int, sent_ns: int) -> bool:
        """Whether the reference clock in a frame is that of when it was sent. Frame indices repeat
        every 16, so an answer that is late by as many looks like the one that is awaited."""
        ahead = reference_ns - sent_ns
        known = self._known_ahead_ns
        if known is not None and abs(ahead - known) > _FITS_TICKS * self._period_ns:
            return False
        self._ahead_ns = self._known_ahead_ns = ahead
        return True

    def error_ns(self, due_ns: int) -> int | None:
        """How much later a tick is due than it should be for SYNC0 to come ``shift_us`` after it,
        within half a period either way; None unless the last frame came back."""
        if self._ahead_ns is None:
            return None
        period = self._period_ns
        late = due_ns + self._ahead_ns + self._shift_ns - self.sync0_ns
        return (late + period // 2) % period - period // 2

    def sampled(self, reference_ns: int, tick: int, sent: int) -> tuple[int, int, int]:
        """Of the sample in the frame that tick ``sent`` published: the tick whose SYNC0 took it,
        before ``tick``; when that was by the reference clock, 0 for the first by another clock; and
        by how much that may be wrong. It is another tick when the host delayed the frame."""
        pulse = (reference_ns - self.sync0_ns) // self._period_ns
        self._pulses.append(pulse - sent)
        number = min(pulse - min(self._pulses), tick - 1)
        time_ns = self.sync0_ns + pulse * self._period_ns if self._continues else 0
        self._continues = True
        doubtful = self.near_sync0_ns(reference_ns) is not None
        return number, time_ns, self._period_ns if doubtful else 0

    def near_sync0_ns(self, reference_ns: int) -> int | None:
        """How long after SYNC0 a frame passed that passed together with it, so that it carries one
        sample or the next, nobody knows; None for any other."""
        after = (reference_ns - self.sync0_ns) % self._period_ns
        clear = self._guard_ns <= after <= self._period_ns - self._guard_ns
        return None if clear else after
