"""Refused tracker poses: one is an outlier; many in a row that agree are right, or the tracker has
been moved. Both cases are reported."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.control import Estimator as Settings
from tonus.config.schema.tracker import Tracker

Array = NDArray[np.float64]


class Disagreement:
    """The refused poses since the last accepted one."""

    def __init__(self, settings: Settings, tracker: Tracker) -> None:
        self._settings = settings
        sigma = np.array([tracker.position_sigma] * 3 + [tracker.rotation_sigma] * 3)
        self._narrow = settings.refused_spread * sigma
        self.learnt = 0
        """how often the estimator has followed the tracker after a disagreement"""
        self.reset()

    def reset(self) -> None:
        """A new reference."""
        self.learnt = 0
        self.end()

    def end(self) -> None:
        """A pose was accepted."""
        self.shift = np.zeros(6)
        """m and rad, mean difference between the refused poses and the estimate"""
        self.poses = 0

    def learn(self) -> None:
        """The estimator follows; the difference stays readable until the next pose."""
        self.learnt += 1
        self.poses = 0

    def add(self, shift: Array) -> None:
        """Add a refused pose with its distance ``shift`` from the estimate (Welford's moments)."""
        if not self.poses:
            self.shift, self._squares = np.zeros(6), np.zeros(6)
        self.poses += 1
        away = shift - self.shift
        self.shift += away / self.poses
        self._squares += away * (shift - self.shift)

    @property
    def distance(self) -> float:
        """m"""
        x, y, z = self.shift.tolist()[:3]
        return math.sqrt(x * x + y * y + z * z)

    @property
    def lasting(self) -> bool:
        """Too many in a row to be outliers."""
        return self.poses >= self._settings.refused_poses

    @property
    def learnable(self) -> bool:
        """Lasting, consistent with each other, and near enough to be an error of the cables."""
        if not self.lasting or self.distance > self._settings.relearn_limit:
            return False
        return bool((self._squares <= self.poses * self._narrow**2).all())
