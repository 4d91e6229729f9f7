"""The estimator along one axis: what of `tonus.runtime.control.estimator` is fast.

Place, speed and external force, predicted with the measured pull of the cables and corrected with
their measured lengths, at the stationary Kalman gain of the configured noise. Turned off are the
tracker and the calibration, which are slow: an offset of the lengths only adds its drift to that of
the place that the lengths tell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from tonus.config.schema.root import Config

Array = NDArray[np.float64]
STATES = 3
PLACE, SPEED, EXTERNAL = range(STATES)


class AxisEstimator:
    """A linear system, round rest."""

    def __init__(self, config: Config, gather: float) -> None:
        """``gather``: the sum of the squares of the cables' directions along the axis."""
        noise, h = config.control.estimator, config.control.rates.period
        mass = config.robot.platform.mass
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

    def step(self, state: Array, seen: float, pull: float) -> tuple[Array, Array]:
        """The state (3,) at this sampling instant, from the one before, the place (m) that the
        lengths tell and the cables' pull (N); and the same a period on, as it is published."""
        state = self._flow @ state + self._pulled * pull
        state = state + self.gain * (seen - state[PLACE])
        return state, self._flow @ state + self._pulled * pull
