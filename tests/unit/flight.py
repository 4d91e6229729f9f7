"""A platform on a path known in advance, its cables and its tracker, for the estimator."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tonus.config import load
from tonus.config.schema.control import Estimator
from tonus.runtime.control.compiled import rotate
from tonus.runtime.control.estimator import PoseEstimator
from tonus.runtime.control.kinematics import Kinematics

CONFIG, _ = load("config/can.yaml")
ROBOT, TRACKER = CONFIG.robot, CONFIG.tracker
PERIOD = CONFIG.control.rates.period
SETTINGS = CONFIG.control.estimator
INERTIA = np.array(ROBOT.platform.inertia)
MASS, EA = ROBOT.platform.mass, ROBOT.cable.axial_stiffness
GRAVITY = np.array([0.0, 0.0, -ROBOT.gravity])
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
ALL = np.ones(8, dtype=bool)
POSE_TICKS = 8
Array = NDArray[np.float64]
Path = Callable[[float], Array]


def still(_: float) -> Array:
    return np.array([0.02, -0.01, 0.03])


def sine(t: float) -> Array:
    """30 mm at 0.5 Hz along x, from rest: up to 94 mm/s."""
    return np.array([0.03 * (1.0 - np.cos(np.pi * t)), 0.0, 0.0])


class Flight:
    """A platform on a path, its cables and its tracker, in ticks.

    ``bias``: what the cables' pose is wrong by; ``softness``: their true compliance over the
    nominal one, of all or of each (n,); ``level``: even part of the tensions; ``share``: part of
    their change since the start that counts as elongation. The inputs of a tick are a tick old.
    """

    def __init__(
        self,
        path: Path,
        bias: Array | None = None,
        tilt: Array | None = None,
        *,
        level: float = 45.0,
        softness: float | Array = 1.0,
        share: float = 1.0,
        noise: np.random.Generator | None = None,
        settings: Estimator = SETTINGS,
    ) -> None:
        self.path, self.noise = path, noise
        """noise: of the tracker; none sees exactly"""
        self.bias = np.zeros(3) if bias is None else bias
        self.quaternion = rotate(LEVEL, np.zeros(3) if tilt is None else tilt)
        self.external = np.zeros(6)
        self.level, self.softness, self.share = level, softness, share
        self.slip = np.zeros(8)
        self.usable = ALL
        self.delay_ticks = 8.0
        self.tick = 0
        self.accepted: list[bool] = []
        self._true = Kinematics(ROBOT.geometry)
        self.estimator = PoseEstimator(ROBOT, settings, TRACKER, Kinematics(ROBOT.geometry), PERIOD)
        self._first = np.full(8, np.nan)
        _, self._first = self._cables(0.0)
        self.estimator.start(path(0.0), self.quaternion, self._first, 60)

    def run(self, ticks: int, *, tracked: bool = True) -> Flight:
        for _ in range(ticks):
            self.tick += 1
            lengths, tensions = self._cables((self.tick - 1) * PERIOD)
            self.estimator.step(lengths, tensions, self._elastic(tensions), self.usable)
            if tracked and self.tick % POSE_TICKS == 0 and self.tick > 20:
                exposed = (self.tick - self.delay_ticks) * PERIOD
                delay = self.delay_ticks * PERIOD
                seen, turned = self.path(exposed), self.quaternion
                if self.noise is not None:
                    seen = seen + TRACKER.position_sigma * self.noise.normal(size=3)
                    turned = rotate(turned, TRACKER.rotation_sigma * self.noise.normal(size=3))
                self.accepted.append(self.estimator.track(seen, turned, delay))
        return self

    @property
    def error(self) -> Array:
        """m, of the estimate at the present tick."""
        return np.asarray(self.estimator.estimate.position - self.path(self.tick * PERIOD))

    def _cables(self, t: float) -> tuple[Array, Array]:
        """Lengths and tensions at an instant; the tensions move the platform along its path."""
        h = 1e-4
        bend = (self.path(t + h) - 2.0 * self.path(t) + self.path(t - h)) / h**2
        self._true.evaluate(self.path(t) + self.bias, self.quaternion)
        strained = self._true.lengths.copy()
        self._true.evaluate(self.path(t), self.quaternion)
        wrench = np.concatenate([MASS * (bend - GRAVITY), np.zeros(3)]) - self.external
        even = np.full(8, self.level)
        matrix = self._true.matrix
        tensions = even + np.linalg.pinv(matrix) @ (wrench - matrix @ even)
        # What the drums gave out, stretched by the nominal compliance.
        wound = strained / (1.0 + self.softness * tensions / EA) + self.slip
        return wound * (1.0 + self._elastic(tensions) / EA), tensions

    def _elastic(self, tensions: Array) -> Array:
        return np.asarray(self._first + self.share * (tensions - self._first))
