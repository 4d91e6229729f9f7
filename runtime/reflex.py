"""The first milliseconds after a cable has torn: every drum at its limit, with or against the pull
that is missing.

The platform weighs a fifth of what a drum does at the cable, so its speed is decided before any
loop has settled. What is least possible (docs/stop.md) has the drums reel in where a cable pulls
along the lost one, and out where it pulls against it, at full current, for about 15 ms, and brakes
them then.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from config.schema.control import Reflex as Settings
from config.schema.robot import CABLES, Robot

Array = NDArray[np.float64]


class Reflex:
    """Torques (n,) in place of the tension loop's while it lasts."""

    def __init__(self, robot: Robot, settings: Settings, period: float) -> None:
        self._settings, self._period = settings, period
        motor = robot.motor
        limit = motor.current_limit * motor.torque_constant * robot.gearbox.ratio
        self._limit = settings.share * limit
        self._pattern = np.zeros(CABLES)
        self._left = 0

    def reset(self) -> None:
        self._left = 0

    def start(self, matrix: Array, cable: int, tension: float) -> None:
        """For a ``cable`` that had a ``tension`` (N) and has none now; ``matrix`` (6, n)."""
        along = matrix[:3].T @ matrix[:3, cable]
        # Full torque from a quarter of the largest projection on: bang-bang but for those across.
        self._pattern[:] = np.clip(along / self._settings.full_at, -1.0, 1.0)
        self._pattern[cable] = 0.0
        seconds = self._settings.duration * math.sqrt(max(tension, 0.0) / self._settings.tension)
        self._left = round(seconds / self._period)

    def __call__(self, torque: Array, carrying: NDArray[np.bool_]) -> None:
        """In place, on the cables that are ``carrying`` (n,)."""
        if self._left > 0:
            self._left -= 1
            torque[carrying] = self._limit * self._pattern[carrying]
