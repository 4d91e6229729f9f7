"""From slack cables to straight ones, before their lengths are referenced: tensions grow together,
and wait for a cable that stays slack."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.control import Control


class Straightening:
    """Times are s since `begin`, when the drives were enabled."""

    def __init__(self, control: Control) -> None:
        sequence, tension = control.sequence, control.tension
        self._settle = sequence.referencing_settle_s
        self._rise = 0.5 * self._settle
        self._tolerated, self._longest = sequence.slack_s, sequence.take_up_s
        self._period, self._taut = control.rates.period, 0.5 * tension.slack
        self._low = tension.slack / tension.referencing
        self.begin()

    def begin(self) -> None:
        """Anew, with cables of any slack."""
        self._late = self._slack = 0.0
        """s by which tensions grow later, and for which a cable has been slack"""
        self.share = 0.0
        """of the referencing tension that is asked of each cable on its own, 0 to 1"""
        self.waits_for: list[int] = []
        """cables that are slack, while the others wait for them"""

    def grow(self, time: float) -> float:
        """Gives the `share`."""
        self.share = min(1.0, (time - self._late) / self._rise)
        return self.share

    def settled(self, time: float) -> float:
        """For how long tensions have settled, s; negative before that."""
        return time - self._late - self._settle

    def take_up(self, time: float, tension: NDArray[np.float64]) -> list[int]:
        """Let the others wait at `tension.slack` for cables that stay slack, since without those
        more would tilt the platform out of its cups. ``tension`` (n,) in N. Gives the cables that
        have been slack for too long."""
        slack = tension < self._taut
        self.waits_for = []
        if not slack.any() or not self._longest:
            self._slack = 0.0
            return []
        if self._slack > 0.0 or self.share >= self._low:
            self._slack += self._period
        if self._slack > self._tolerated:
            self._late = time - self._low * self._rise
            self.waits_for = np.flatnonzero(slack).tolist()
        return self.waits_for if self._slack > self._longest else []
