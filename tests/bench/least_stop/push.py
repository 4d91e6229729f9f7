"""A push from outside beside the break: known to the optimum in advance, as everything else is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_STEP_S = 1e-6
"""s that a step of force takes"""


@dataclass(frozen=True)
class Push:
    """A force on a point of the platform, which rises, stays and falls. Times in s."""

    force: tuple[float, float, float]
    """N, base frame"""
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """m, platform frame"""
    begin: float = 0.0
    """after the break"""
    rise: float = 0.0
    """in which it rises, and in the end falls"""
    duration: float = np.inf
    """from its begin until it falls"""

    def means(self, times: Array) -> Array:
        """N (intervals, 3): over each interval between ``times`` (s)."""
        rise = max(self.rise, _STEP_S)
        top = min(1.0, self.duration / rise)
        # A load that stays, stays for as long as anybody looks.
        end = min(self.duration, max(rise, float(times[-1]) - self.begin + _STEP_S))
        knots = self.begin + np.array([0.0, min(rise, end), end, end + rise])
        every = np.union1d(times, knots)
        share = np.interp(every, knots, [0.0, top, top, 0.0])
        parts = 0.5 * (share[1:] + share[:-1]) * np.diff(every)
        area = np.interp(times, every, np.concatenate([[0.0], np.cumsum(parts)]))
        return np.outer(np.diff(area) / np.diff(times), self.force)


NO_PUSH = Push((0.0, 0.0, 0.0))
