"""Trajectories as a user writes them, for the tests."""

from __future__ import annotations

import math


class Rise:
    """Up by a smooth step over ``length`` s."""

    def __init__(self, height: float, length: float) -> None:
        self._height, self._length = height, length

    def __call__(self, t: float) -> tuple[float, float, float]:
        s = t / self._length
        return 0.0, 0.0, self._height * s * s * (3.0 - 2.0 * s)


class Broken:
    """Is no number after a while."""

    def __call__(self, t: float) -> list[float]:
        return [math.nan if t > 0.5 else 0.0] * 3
