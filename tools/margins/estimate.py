"""The estimator along one axis: what of `tonus.runtime.control.estimator` is fast.

Place, speed and external force, predicted with the measured pull of the cables and corrected with
their measured lengths, at the stationary Kalman gain of the configured noise; and the part of a
tension that stretches its cable, as `tonus.runtime.control.referencing` takes it out of a length.
Turned off are the tracker and the calibration, which are slow: an offset of the lengths only adds
its drift to that of the place that the lengths tell.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from tonus.config.schema.root import Config

Array = NDArray[np.float64]
STATES = 5
PLACE, SPEED, EXTERNAL, _ELASTIC, _LAST = range(STATES)
_MOVING = 3


class AxisEstimator:
    """A linear system, round rest."""

    def __init__(self, config: Config, gather: float, stiffness: float, damping: float) -> None:
        """``gather``: the sum of the squares of the cables' directions along the axis;
        ``stiffness`` (N/m) and ``damping`` (N s/m) of a cable, as the estimator knows them."""
        noise, h = config.control.estimator, config.control.rates.period
        mass = config.robot.platform.mass
        self._gather, self._stiffness = gather, stiffness
        time = damping / stiffness
        self._kept = math.exp(-h / time) if time else 0.0
        self._mean = (1.0 - self._kept) * time / h
        self._flow = np.array([[1.0, h, 0.5 * h**2 / mass], [0.0, 1.0, h / mass], [0.0, 0.0, 1.0]])
        self._pulled = self._flow[:, EXTERNAL] - np.array([0.0, 0.0, 1.0])
        # In sigmas of what the lengths say of the place; else the numbers are too small to solve.
        sigma = noise.length_sigma / np.sqrt(gather)
        drift = noise.offset_drift / np.sqrt(gather)
        grown = np.array([drift, noise.acceleration_sigma, noise.force_drift]) / sigma
        seen = np.array([[1.0], [0.0], [0.0]])
        spread = solve_discrete_are(self._flow.T, seen, np.diag(grown**2 * h), np.eye(1))
        self.gain = spread[:, PLACE] / (spread[PLACE, PLACE] + 1.0)
        """(3,) of an innovation in m, in m, m/s and N"""

    def step(self, state: Array, drum: float, tension: float) -> tuple[Array, Array]:
        """The state (5,) at this sampling instant, from the one before, the cable that the drums
        have wound (m) and the tension (N), each along the pattern of the axis; and place, speed and
        external force (3,) a period on, as they are published."""
        elastic = self._kept * state[_ELASTIC] + (self._mean - self._kept) * state[_LAST]
        elastic += (1.0 - self._mean) * tension
        pull = self._gather * tension
        now = self._flow @ state[:_MOVING] + self._pulled * pull
        now = now + self.gain * (drum - elastic / self._stiffness - now[PLACE])
        return np.array([*now, elastic, tension]), self._flow @ now + self._pulled * pull
