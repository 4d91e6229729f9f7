"""The supervisor's heartbeats on one channel, and those that wait there in a transmit queue."""

from __future__ import annotations

from tonus.runtime.supervisor.commands import Own
from tonus.runtime.supervisor.listener import Heard

_ONE_OF = 16
"""heartbeats, of which one may be lost"""


class Beats(Own):
    """Those that wait hold the drives when the supervisor has decided, so that two wait at most, on
    an interface that tells what it has sent. It tells of each, in their order: those that it has
    not told of wait, or were lost."""

    def __init__(self, identifier: int, heard: Heard, period_ms: int, timeout_ms: int) -> None:
        """``timeout_ms``: how long whoever watches waits for the next one."""
        self._silent_looks = max(1, timeout_ms // (2 * period_ms) - 1)
        """that show that nothing waits: with the one before, half of that time"""
        self._left_out = 0
        """looks in a row that sent none, to see whether any comes"""
        super().__init__(identifier, heard)

    def begin(self) -> None:
        """What was heard and sent so far is over."""
        super().begin()
        self._counted = self._told = self.heard.count
        """heartbeats but for those that were lost, and those of them that the last look found"""
        self._prompt = _ONE_OF
        """looks in a row that found all of them; since one may be lost, at least"""
        self._doubted = False
        """the one that was lost last may wait after all"""

    def send(self) -> None:
        """One is sent."""
        super().send()
        self._counted += 1

    @property
    def waits(self) -> bool:
        """One that was sent has not gone out, as far as the interface tells."""
        return 0 < self.heard.count < self._counted

    def give_up(self) -> None:
        """What waits was lost."""
        self._counted = self.heard.count

    def follows(self) -> bool:
        """Whether to send one, asked once a look. While one waits a second may follow, since that
        may be lost, where `_ONE_OF` before it went out at once. It was, if the second is told of
        and none is in the looks after that, which send none. As many looks prove it once more after
        `_ONE_OF`, before the next one may be lost."""
        heard = self.heard.count
        came, self._told = heard > self._told, heard
        left_out, self._left_out = self._left_out, 0
        if heard > self._counted:  # one that was given up, or the bus has repeated one
            self.give_up()
            self._doubted = False
        waiting = self._counted - heard
        if not heard:
            return True
        if not waiting:
            self._prompt += 1
            if self._prompt < _ONE_OF or not self._doubted:
                return True
        elif waiting > 1 or not (came or left_out):
            second = waiting == 1 and self._prompt >= _ONE_OF
            self._prompt = 0
            return second
        if left_out < self._silent_looks:
            self._left_out = left_out + 1
            return False
        self._doubted = waiting > 0
        self.give_up()
        return True
