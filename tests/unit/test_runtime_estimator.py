"""The pose estimator on motions known in advance: cables that are wrong, a tracker that is late,
blind or mad, and loads nobody announced."""

from __future__ import annotations

import numpy as np
import pytest
from flight import (
    ALL,
    EA,
    INERTIA,
    MASS,
    PERIOD,
    POSE_TICKS,
    ROBOT,
    SETTINGS,
    TRACKER,
    Array,
    Flight,
    sine,
    still,
)

from tonus.runtime.control.compiled import rotate
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.wrench import rotation_between
from tonus.runtime.signals import Consistency


def test_at_rest_with_perfect_cables_nothing_drifts() -> None:
    flight = Flight(still, tilt=np.array([0.05, 0.0, -0.03])).run(3000, tracked=False)
    estimate = flight.estimator.estimate
    assert np.abs(flight.error).max() < 1e-7
    assert np.abs(estimate.velocity).max() < 1e-6
    assert np.abs(rotation_between(flight.quaternion, estimate.quaternion)).max() < 1e-6
    assert np.abs(estimate.external).max() < 1e-3
    assert flight.estimator.residual < 1e-9


def test_the_tracker_takes_the_cables_bias_out() -> None:
    """Cables that creep by a few tenths of a millimetre in two seconds."""
    flight = Flight(still).run(200)
    for _ in range(200):
        flight.bias += np.array([1.5e-6, 0.0, -1e-6])
        flight.run(10, tracked=False)
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
        speed = 0.03 * np.pi * np.sin(np.pi * flight.tick * PERIOD)
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


@pytest.mark.parametrize(("softness", "share"), [(1.12, 1.0), (1.0, 0.9)])
def test_the_cables_compliance_is_found_while_the_tensions_grow(
    softness: float, share: float
) -> None:
    """A cable 12 % softer than its data sheet is 1.1 mm longer at 45 N than at 12 N, and not where
    it seems to be; nor is one of whose tension only a share counts as elongation."""
    flight = Flight(still, level=12.0, softness=softness, share=share)
    for _ in range(100):
        flight.level += 0.33
        flight.run(10)
    flight.run(1000)
    assert all(flight.accepted)
    assert flight.estimator.compliance == pytest.approx(softness / share, abs=0.01)
    assert np.abs(flight.error).max() < 3e-5
    assert flight.estimator.consistency is Consistency.GOOD


def test_each_cables_own_compliance_is_found_while_the_tensions_grow() -> None:
    """Eight cables of different softness contradict each other by millimetres while they stretch,
    in directions in which no pose moves them; the tracker must not be refused for it."""
    softness = 1.0 + 0.1 * np.array([1.0, -0.9, 0.4, -0.3, -1.0, 0.8, -0.5, 0.6])
    flight = Flight(still, level=12.0, softness=softness)
    worst = 0.0
    for _ in range(100):
        flight.level += 0.33
        flight.run(10)
        worst = max(worst, flight.estimator.inconsistency)
    flight.run(1000)
    assert all(flight.accepted)
    assert worst < SETTINGS.consistency_limit
    assert flight.estimator.disagreement.learnt == 0
    np.testing.assert_allclose(flight.estimator.compliances, softness, atol=0.01)
    assert np.abs(flight.error).max() < 3e-5


EXACT = SETTINGS.model_copy(update={"acceleration_sigma": 5e-4, "angular_acceleration_sigma": 5e-3})
"""Wrench noise so small that the cables' elongation does not notice it."""


class Drawn(Flight):
    """Everything uncertain is drawn from what the filter is told about it."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng(seed)
        common = SETTINGS.compliance_sigma * random.normal()
        softness = 1.0 + common + SETTINGS.compliance_spread * random.normal(size=8)
        super().__init__(still, softness=softness, noise=random, settings=EXACT)
        self.noise = None
        _, tensions = self._cables(0.0)
        self.noise = random
        # The lengths are referenced at a pose that is a little wrong, with the nominal compliance.
        seen = self.path(0.0) + TRACKER.position_sigma / np.sqrt(60.0) * random.normal(size=3)
        turned = TRACKER.rotation_sigma / np.sqrt(60.0) * random.normal(size=3)
        kinematics = Kinematics(ROBOT.geometry)
        kinematics.evaluate(seen, rotate(self.quaternion, turned))
        wound = kinematics.lengths / (1.0 + tensions / EA)
        self._true.evaluate(self.path(0.0), self.quaternion)
        self.slip = wound - self._true.lengths / (1.0 + softness * tensions / EA)
        self.estimator.start(seen, rotate(self.quaternion, turned), tensions, 60)

    def _cables(self, t: float) -> tuple[Array, Array]:
        lengths, tensions = super()._cables(t)
        if self.noise is None:
            return lengths, tensions
        self.softness += np.sqrt(PERIOD) * SETTINGS.compliance_drift * self.noise.normal()
        draw, root = self.noise.normal, np.sqrt(PERIOD)
        drift = np.repeat([SETTINGS.force_drift, SETTINGS.moment_drift], 3)
        self.external = self.external + root * drift * draw(size=6)
        self.slip = self.slip + root * SETTINGS.offset_drift * draw(size=8)
        pushed = np.concatenate(
            [
                MASS * EXACT.acceleration_sigma / root * draw(size=3),
                INERTIA * EXACT.angular_acceleration_sigma / root * draw(size=3),
            ]
        )
        said = tensions + np.linalg.pinv(self._true.matrix) @ pushed
        return lengths + SETTINGS.length_sigma * draw(size=8), said

    @property
    def errors(self) -> Array:
        """(34,) true minus estimated, at the present tick."""
        estimate, estimator = self.estimator.estimate, self.estimator
        lengths, tensions = Flight._cables(self, 0.0)
        self._true.evaluate(self.path(0.0), self.quaternion)
        stretch = lengths * tensions / (EA + tensions)
        offsets = self._true.lengths - lengths - (self.softness - 1.0) * stretch
        return np.concatenate(
            [
                self.path(0.0) - estimate.position,
                rotation_between(estimate.quaternion, self.quaternion),
                -estimate.velocity,
                -estimate.angular_velocity,
                self.external - estimate.external,
                offsets - estimator.offsets,
                self.softness - estimator.compliances,
            ]
        )


@pytest.mark.wide
def test_the_covariance_is_that_of_the_errors() -> None:
    """The squared error in its own covariance averages to the number of states, and a little more
    here: the estimate is a tick further on, and the lengths of an exposure count twice."""
    parts = {"pose": range(6), "wrench": range(12, 18), "constants": range(18, 34)}
    squares: dict[str, list[float]] = {name: [] for name in parts}
    for seed in range(16):
        flight = Drawn(seed)
        flight.run(1200)
        for name, part in parts.items():
            error = flight.errors[part]
            covariance = flight.estimator.covariance[np.ix_(part, part)]
            squares[name].append(float(error @ np.linalg.solve(covariance, error)))
    for name, part in parts.items():
        assert np.mean(squares[name]) == pytest.approx(1.1 * len(part), rel=0.45), name


def test_the_covariance_stays_one_and_grows_only_while_the_tracker_is_silent() -> None:
    flight = Flight(sine, noise=np.random.default_rng(3)).run(6000)
    settled = flight.estimator.sigma
    flight.run(6000)
    assert flight.estimator.sigma == pytest.approx(settled, rel=0.02)
    flight.run(2000, tracked=False)
    assert flight.estimator.sigma > 1.5 * settled
    covariance = flight.estimator.covariance
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    np.testing.assert_allclose(covariance, covariance.T, rtol=0.0, atol=1e-15)


def test_no_cable_at_all_is_flight_by_tensions_alone() -> None:
    flight = Flight(still).run(500)
    flight.usable = ~ALL
    flight.run(300, tracked=False)
    assert np.abs(flight.error).max() < 1e-4
    assert np.isfinite(flight.estimator.covariance).all()


def moved(flight: Flight, away: Array, poses: int, scatter: float = 0.0) -> list[bool]:
    """What becomes of so many tracker poses that lie beside the platform."""
    random, answers = np.random.default_rng(5), []
    for _ in range(poses):
        flight.run(POSE_TICKS, tracked=False)
        seen = flight.path(0.0) + away + scatter * random.normal(size=3)
        answers.append(flight.estimator.track(seen, flight.quaternion, POSE_TICKS * PERIOD))
    return answers


def test_a_lasting_disagreement_of_one_opinion_is_learnt_and_counted() -> None:
    flight = Flight(still).run(500)
    away = np.array([0.002, 0.0, -0.001])
    needed = SETTINGS.refused_poses
    answers = moved(flight, away, needed + 4)
    assert answers == [False] * needed + [True] * 4
    disagreement = flight.estimator.disagreement
    assert disagreement.learnt == 1
    np.testing.assert_allclose(flight.error, away, atol=1e-4)
    assert flight.estimator.consistency is Consistency.GOOD


def test_what_is_learnt_is_as_large_as_the_disagreement_also_with_lengths_that_contradict() -> None:
    """A pose cannot move the lengths along the null space of the structure matrix; what contradicts
    there must not move the pose."""
    flight = Flight(still).run(500)
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(flight.path(0.0), flight.quaternion)
    contradiction = np.linalg.svd(kinematics.matrix)[2][-1]
    true, turn = flight.quaternion, np.array([0.002, -0.003, 0.001])
    largest = 0.0
    for _ in range((SETTINGS.refused_poses + 8) * POSE_TICKS):
        flight.slip = flight.slip + 2e-6 * contradiction
        flight.run(1, tracked=False)
        estimator = flight.estimator
        if flight.tick % POSE_TICKS == 0:
            # Seen where it is, and turned a little.
            estimator.track(flight.path(0.0), rotate(true, 4.0 * turn), POSE_TICKS * PERIOD)
        turned = rotation_between(true, estimator.estimate.quaternion)
        largest = max(largest, float(np.linalg.norm(turned)))
    assert estimator.disagreement.learnt >= 1
    assert largest < 1.3 * float(np.linalg.norm(4.0 * turn))
    np.testing.assert_allclose(turned, 4.0 * turn, atol=2e-3)


def test_too_large_a_disagreement_is_named_and_never_learnt() -> None:
    flight = Flight(still).run(500)
    assert not any(moved(flight, np.array([0.02, 0.0, 0.0]), 3 * SETTINGS.refused_poses))
    estimator = flight.estimator
    assert estimator.consistency is Consistency.TRACKER
    assert estimator.disagreement.distance == pytest.approx(0.02, rel=0.01)
    assert np.abs(flight.error).max() < 1e-5
    assert all(moved(flight, np.zeros(3), 2))
    assert estimator.consistency is Consistency.GOOD


def test_poses_that_contradict_each_other_are_never_learnt() -> None:
    flight = Flight(still).run(500)
    away = np.array([0.003, 0.0, 0.0])
    moved(flight, away, 3 * SETTINGS.refused_poses, scatter=5e-4)
    assert flight.estimator.disagreement.learnt == 0
    assert np.abs(flight.error).max() < 1e-4


def test_a_cable_that_slips_makes_the_lengths_inconsistent() -> None:
    flight = Flight(still).run(500)
    assert flight.estimator.consistency is Consistency.GOOD
    flight.slip[5] = 0.002
    flight.run(100)
    assert flight.estimator.consistency is Consistency.CABLES
    assert flight.estimator.residual > 10.0 * SETTINGS.length_sigma
