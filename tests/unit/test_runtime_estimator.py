"""The pose estimator on motions known in advance: cables that are wrong, a tracker that is late,
blind or mad, and loads nobody announced."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from config import load
from runtime.compiled import rotate, rotation_between
from runtime.estimator import PoseEstimator
from runtime.kinematics import Kinematics

CONFIG, _ = load("config/can.yaml")
ROBOT, TRACKER = CONFIG.robot, CONFIG.tracker
PERIOD = CONFIG.control.rates.period
MASS = ROBOT.platform.mass
GRAVITY = np.array([0.0, 0.0, -ROBOT.gravity])
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
ALL = np.ones(8, dtype=bool)
POSE_TICKS = 8
Array = NDArray[np.float64]
Path = Callable[[float], Array]


def still(_: float) -> Array:
    return np.array([0.02, -0.01, 0.03])


def sine(t: float) -> Array:
    """30 mm at 0.5 Hz along x: up to 94 mm/s."""
    return np.array([0.03 * np.sin(np.pi * t), 0.0, 0.0])


class Flight:
    """A platform on a path, its cables and its tracker, in ticks.

    ``bias``: what the cables' pose is wrong by. The inputs of a tick are a tick old.
    """

    def __init__(self, path: Path, bias: Array | None = None, tilt: Array | None = None) -> None:
        self.path = path
        self.bias = np.zeros(3) if bias is None else bias
        self.quaternion = rotate(LEVEL, np.zeros(3) if tilt is None else tilt)
        self.external = np.zeros(6)
        self.usable = ALL
        self.delay_ticks = 8.0
        self.tick = 0
        self.accepted: list[bool] = []
        self._true = Kinematics(ROBOT.geometry)
        self.estimator = PoseEstimator(
            ROBOT, CONFIG.control.estimator, TRACKER, Kinematics(ROBOT.geometry), PERIOD
        )
        _, tensions = self._cables(0.0)
        self.estimator.start(path(0.0), self.quaternion, self._true.matrix @ tensions, 60)

    def run(self, ticks: int, *, tracked: bool = True) -> Flight:
        for _ in range(ticks):
            self.tick += 1
            lengths, tensions = self._cables((self.tick - 1) * PERIOD)
            self.estimator.step(lengths, tensions, self.usable)
            if tracked and self.tick % POSE_TICKS == 0 and self.tick > 20:
                exposed = (self.tick - self.delay_ticks) * PERIOD
                delay = self.delay_ticks * PERIOD
                self.accepted.append(
                    self.estimator.track(self.path(exposed), self.quaternion, delay)
                )
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
        lengths = self._true.lengths.copy()
        self._true.evaluate(self.path(t), self.quaternion)
        wrench = np.concatenate([MASS * (bend - GRAVITY), np.zeros(3)]) - self.external
        even = np.full(8, 45.0)
        matrix = self._true.matrix
        return lengths, even + np.linalg.pinv(matrix) @ (wrench - matrix @ even)


def test_at_rest_with_perfect_cables_nothing_drifts() -> None:
    flight = Flight(still, tilt=np.array([0.05, 0.0, -0.03])).run(3000, tracked=False)
    estimate = flight.estimator.estimate
    assert np.abs(flight.error).max() < 1e-7
    assert np.abs(estimate.velocity).max() < 1e-6
    assert np.abs(rotation_between(flight.quaternion, estimate.quaternion)).max() < 1e-6
    assert np.abs(estimate.external).max() < 1e-3
    assert flight.estimator.residual < 1e-9


def test_the_tracker_takes_the_cables_bias_out() -> None:
    flight = Flight(still, bias=np.array([3e-4, 0.0, -2e-4]))
    flight.run(20, tracked=False)
    assert np.abs(flight.error).max() > 1e-4
    flight.run(4000)
    assert all(flight.accepted)
    assert np.abs(flight.error).max() < 1.5e-5
    np.testing.assert_allclose(flight.estimator.bias, flight.bias, atol=1.5e-5)


@pytest.mark.parametrize("delay_ticks", [3.0, 8.0, 12.5])
def test_a_late_tracker_does_not_make_a_moving_platform_lag(delay_ticks: float) -> None:
    """8 ms at 94 mm/s are 0.75 mm, if the delay were not accounted for."""
    flight = Flight(sine)
    flight.delay_ticks = delay_ticks
    flight.run(1000)
    worst = 0.0
    for _ in range(200):
        flight.run(10)
        worst = max(worst, float(np.abs(flight.error).max()))
    assert all(flight.accepted)
    assert worst < 2e-5
    assert np.abs(flight.estimator.bias).max() < 1e-5


def test_velocity_follows_without_lag() -> None:
    flight = Flight(sine).run(1500)
    errors = []
    for _ in range(100):
        flight.run(10)
        speed = 0.03 * np.pi * np.cos(np.pi * flight.tick * PERIOD)
        errors.append(flight.estimator.estimate.velocity[0] - speed)
    assert np.abs(errors).max() < 1e-3


def test_a_jump_beyond_the_gate_is_not_believed() -> None:
    flight = Flight(still).run(500)
    before = flight.estimator.estimate.position.copy()
    jump = flight.path(0.0) + np.array([0.05, 0.0, 0.0])
    assert not flight.estimator.track(jump, flight.quaternion, 0.008)
    turned = rotate(flight.quaternion, np.array([0.0, 0.1, 0.0]))
    assert not flight.estimator.track(flight.path(0.0), turned, 0.008)
    np.testing.assert_array_equal(flight.estimator.estimate.position, before)
    assert flight.estimator.track(flight.path(0.0), flight.quaternion, 0.008)


@pytest.mark.parametrize("delay", [-0.01, 0.0, 0.5, np.nan])
def test_a_pose_from_outside_the_memory_is_refused(delay: float) -> None:
    flight = Flight(still).run(500)
    assert not flight.estimator.track(flight.path(0.0), flight.quaternion, delay)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_pose_that_is_not_finite_is_refused(bad: float) -> None:
    flight = Flight(still).run(500)
    before = flight.estimator.estimate.position.copy()
    assert not flight.estimator.track(np.array([bad, 0.0, 0.0]), flight.quaternion, 0.008)
    np.testing.assert_array_equal(flight.estimator.estimate.position, before)


def test_a_silent_tracker_leaves_the_bias_and_is_welcome_back() -> None:
    flight = Flight(sine, bias=np.array([0.0, 2e-4, 0.0])).run(4000)
    flight.run(1000, tracked=False)
    assert np.abs(flight.error).max() < 2e-5
    flight.accepted.clear()
    flight.run(200)
    assert all(flight.accepted)


@pytest.mark.parametrize("lost", [0, 5])
def test_a_cable_without_a_measurement_says_nothing(lost: int) -> None:
    flight = Flight(sine).run(1000)
    flight.usable = ALL.copy()
    flight.usable[lost] = False
    flight.run(300)
    assert np.abs(flight.error).max() < 1e-4


def test_an_external_load_is_found() -> None:
    flight = Flight(still).run(500)
    flight.external = np.array([10.0, 0.0, -4.0, 0.0, 0.2, 0.0])
    flight.run(2000)
    np.testing.assert_allclose(flight.estimator.estimate.external, flight.external, atol=0.05)
    assert np.abs(flight.error).max() < 2e-5
