"""Where the platform is, how fast it moves, and what pushes it.

Two sources that fail differently: the cables (each tick, precise, but wrong by what calibration
missed) and the optical tracker (its own rate and latency, coarse, but right). So there are two
Kalman filters, for translation and for rotation alike, whose three axes share one covariance:

- the *motion* filter runs each tick on the pose solved from the cables; its state is position,
  velocity and the acceleration by external forces, and the measured cable wrench drives it as an
  accelerometer would, so that velocity needs no differentiation. Its measurements never change in
  kind or rate, so it runs on the gains its covariance settles at;
- the *bias* filter runs when a tracker pose arrives, on the difference between that pose and the
  cables' pose of the same instant. Its covariance grows while the tracker is silent.

The algebra of both is filterpy's. Rotation lives on the manifold: its state is the error of a
quaternion that carries it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from filterpy.kalman import predict, update
from numpy.typing import NDArray

from config.schema.bus import Tracker
from config.schema.control import Estimator as Settings
from config.schema.robot import Robot
from runtime.compiled import carry_forward, motion_tick, rotate, rotation_between
from runtime.kinematics import Kinematics

Array = NDArray[np.float64]
_ZERO, _ONE = np.zeros((1, 1)), np.ones((1, 1))


def _settled_gain(period: float, sigma: float, acceleration: float, drift: float) -> Array:
    """Gain (3,) of the motion filter: its covariance iterated until it stands still. Updating a
    zero state with a unit innovation yields the gain."""
    h, a, d = period, acceleration**2, drift**2
    transition = np.array([[1.0, h, h * h / 2], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
    noise = a * np.array([[h**3 / 3, h**2 / 2, 0], [h**2 / 2, h, 0], [0, 0, 0]])
    noise += d * np.array(
        [
            [h**5 / 20, h**4 / 8, h**3 / 6],
            [h**4 / 8, h**3 / 3, h**2 / 2],
            [h**3 / 6, h**2 / 2, h],
        ]
    )
    observed, measured = np.array([[1.0, 0.0, 0.0]]), np.array([[sigma * sigma]])
    state, covariance = np.zeros((3, 1)), np.eye(3)
    gain, settled = np.zeros((3, 1)), np.ones((3, 1))
    while not np.allclose(gain, settled, rtol=1e-12, atol=0.0):
        settled = gain
        _, covariance = predict(state, covariance, F=transition, Q=noise)
        gain, covariance = update(state, covariance, 1.0, measured, observed)
    return np.ascontiguousarray(gain[:, 0])


class _Bias:
    """Kalman filter of a slowly drifting offset (3,) with one variance for its axes."""

    def __init__(self, sigma: float, drift: float) -> None:
        self._measured, self._drift = sigma * sigma, drift * drift
        self.value = np.zeros(3)
        self._variance = 0.0
        self._silent = 0.0

    def start(self, samples: int) -> None:
        """The lengths were referenced with the mean of so many poses: what was wrong in it is the
        first bias."""
        self.value[:] = 0.0
        self._variance = self._measured / samples
        self._silent = 0.0

    def wait(self, seconds: float) -> None:
        self._silent += seconds

    def sigmas(self, innovation: Array) -> float:
        """Largest component of an innovation, in its own standard deviations."""
        variance = self._variance + self._drift * self._silent + self._measured
        return float(np.abs(innovation).max() / np.sqrt(variance))

    def correct(self, innovation: Array) -> None:
        variance = self._variance + self._drift * self._silent
        gain, settled = update(_ZERO, variance * _ONE, 1.0, self._measured * _ONE, _ONE)
        self._variance = float(settled[0, 0])
        self.value = self.value + gain[0, 0] * innovation
        self._silent = 0.0


@dataclass
class Estimate:
    """The platform at the present tick, base frame."""

    position: Array
    quaternion: Array
    velocity: Array
    angular_velocity: Array
    external: Array
    """(6,) force and moment that the cables and gravity do not explain"""


class PoseEstimator:
    """Fuses cable lengths and tensions with tracker poses. The inputs of a tick are of one sampling
    instant, a period ago; the estimate is carried forward to the present."""

    def __init__(
        self,
        robot: Robot,
        settings: Settings,
        tracker: Tracker,
        kinematics: Kinematics,
        period: float,
    ) -> None:
        self._settings, self._period = settings, period
        self._kinematics = kinematics
        inertia = np.array(robot.platform.inertia)
        self._body = (robot.platform.mass, inertia, robot.gravity)
        self._anchors = (kinematics.frame, kinematics.platform)
        self._translation, self._rotation = np.zeros((3, 3)), np.zeros((3, 3))
        """rows: position, velocity, external acceleration; the rotation's position is its error"""
        self._gains = (
            _settled_gain(
                period,
                settings.cable_position_sigma,
                settings.acceleration_sigma,
                settings.force_drift / robot.platform.mass,
            ),
            _settled_gain(
                period,
                settings.cable_rotation_sigma,
                settings.angular_acceleration_sigma,
                settings.moment_drift / float(inertia.mean()),
            ),
        )
        self._offset = _Bias(tracker.position_sigma, settings.bias_drift)
        self._twist = _Bias(tracker.rotation_sigma, settings.rotation_bias_drift)
        depth = int(np.ceil(tracker.maximum_age_ms * 1e-3 / period)) + 2
        self._past_position = np.zeros((depth, 3))
        self._past_quaternion = np.zeros((depth, 4))
        self._count = 0
        self._quaternion = np.array([1.0, 0.0, 0.0, 0.0])
        """orientation as the cables see it"""
        self.cable_position = np.zeros(3)
        self.residual = 0.0
        """m, RMS disagreement of the eight lengths"""
        self.estimate = Estimate(
            np.zeros(3), self._quaternion.copy(), np.zeros(3), np.zeros(3), np.zeros(6)
        )

    @property
    def bias(self) -> Array:
        """(3,) m, what the cables' position is wrong by."""
        return self._offset.value

    def start(self, position: Array, quaternion: Array, wrench: Array, samples: int) -> None:
        """Begin at rest at a referenced pose, the mean of ``samples`` tracker poses, where the
        cables exert ``wrench``: whatever else holds the platform is the first external load."""
        mass, inertia, gravity = self._body
        translation, rotation = self._translation, self._rotation
        translation[:] = position, np.zeros(3), -wrench[:3] / mass
        translation[2, 2] += gravity
        rotation[:] = np.zeros(3), np.zeros(3), -wrench[3:] / inertia
        self._offset.start(samples)
        self._twist.start(samples)
        self._quaternion[:] = quaternion
        self._count = 0
        self._publish()

    def step(self, lengths: Array, tensions: Array, usable: NDArray[np.bool_]) -> Estimate:
        """One tick with measured cable lengths (8,), elongation included, and tensions (8,); a
        cable that is not ``usable`` says nothing about the pose."""
        kinematics = self._kinematics
        self.residual = motion_tick(
            self._translation,
            self._rotation,
            self._quaternion,
            self._gains,
            self._body,
            self._period,
            self._anchors,
            (lengths, tensions, usable),
            kinematics.lengths,
            kinematics.matrix,
            self.cable_position,
        )
        slot = self._count % len(self._past_position)
        self._past_position[slot] = self._translation[0]
        self._past_quaternion[slot] = self._quaternion
        self._count += 1
        self._offset.wait(self._period)
        self._twist.wait(self._period)
        return self._publish()

    def track(self, position: Array, quaternion: Array, delay: float) -> bool:
        """Use a tracker pose taken ``delay`` s before this tick, against what the cables said then:
        the cost does not grow with the delay.

        Returns False, and changes nothing, when the pose is too old or beyond the gate.
        """
        # What the cables say lags the tick by one period: the newest entry is that far back.
        back = delay / self._period - 1.0
        depth = len(self._past_position)
        if not 0.0 <= back <= min(self._count, depth) - 2:
            return False
        whole = int(back)
        share = back - whole
        newer = (self._count - 1 - whole) % depth
        older = (newer - 1) % depth
        then = (1.0 - share) * self._past_position[newer] + share * self._past_position[older]
        turn = rotation_between(self._past_quaternion[newer], self._past_quaternion[older])
        oriented = rotate(self._past_quaternion[newer], share * turn)
        offset = then - position - self._offset.value
        twist = rotation_between(quaternion, oriented) - self._twist.value
        beyond = max(self._offset.sigmas(offset), self._twist.sigmas(twist))
        if not beyond <= self._settings.gate:
            return False
        self._offset.correct(offset)
        self._twist.correct(twist)
        self._publish()
        return True

    def _publish(self) -> Estimate:
        """The estimate one period on, the bias taken out."""
        estimate, kinematics = self.estimate, self._kinematics
        carry_forward(
            self._translation,
            self._rotation,
            self._quaternion,
            (self._offset.value, self._twist.value),
            self._body,
            self._period,
            self._anchors,
            kinematics.lengths,
            kinematics.matrix,
            (
                estimate.position,
                estimate.quaternion,
                estimate.velocity,
                estimate.angular_velocity,
                estimate.external,
            ),
        )
        return estimate
