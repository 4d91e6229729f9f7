"""A ring in process: what comes out where, when frames go in at either end of a segment."""

from __future__ import annotations

from tonus.sim.ethercat.segment import Segment


class Ring:
    """A segment with both its ends, 0 and 1, at the master."""

    def __init__(self, segment: Segment) -> None:
        self._segment = segment

    def through(self, frame: bytes, at_ns: int, end: int) -> tuple[bytes, int] | None:
        """The answer to a frame that goes in at an end, and the end it comes out at."""
        answer = self._segment.exchange(frame, at_ns, end)
        return None if answer is None else (answer, self._segment.cable.exit(end))

    def around(self, frame: bytes, at_ns: int) -> bytes | None:
        """As a master with two cards does it: what comes back to the end it went in at has not
        been everywhere, and is sent on from the other."""
        back = self.through(frame, at_ns, 0)
        if back is None or back[1]:
            return back and back[0]
        rest = self.through(back[0], at_ns, 1)
        return rest and rest[0]
