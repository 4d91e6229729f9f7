"""The compiled filter against filterpy's dense predict and update on the same numbers, with
Jacobians from finite differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from filterpy.kalman import predict, update
from numpy.typing import NDArray

from tonus.config import load
from tonus.runtime.control.compiled import filter_tick, rotate, track
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.wrench import rotation_between

ROBOT = load("config/can.yaml")[0].robot
EA, PERIOD = ROBOT.axial_stiffness, 1e-3
BODY = (ROBOT.platform.mass, np.array(ROBOT.platform.inertia), ROBOT.gravity, EA)
LENGTH_VARIANCE = 4e-10
SIZE = 34
CREEP = 1e-6
"""what the compliances have in common"""
USABLE = np.array([True, True, False, True, True, True, True, True])
Array = NDArray[np.float64]
State = tuple[Array, Array, Array, Array, Array]


def some_state(seed: int) -> State:
    """A pose off the middle, moving, loaded, miscalibrated, with a full covariance."""
    random = np.random.default_rng(seed)
    turned = rotate(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.1, -0.05, 0.08]))
    scale = np.repeat([1e-4, 1e-3, 1e-2, 1e-1, 1.0, 0.1], 3)
    scale = np.concatenate([scale, np.full(8, 1e-4), np.full(8, 0.05)])
    root = scale[:, None] * random.normal(size=(SIZE, SIZE))
    rest = scale[6:] * random.normal(size=SIZE - 6)
    mean = np.full(8, 0.0144)
    return np.array([0.08, -0.05, 0.1]), turned, rest, root @ root.T, mean


def moved(state: State, error: Array) -> State:
    position, quaternion, rest, covariance, mean = state
    return (
        position + error[:3],
        rotate(quaternion, error[3:6]),
        rest + error[6:],
        covariance,
        mean,
    )


def difference(end: State, start: State) -> Array:
    """(34,) error state that leads from ``start`` to ``end``."""
    turn = rotation_between(start[1], end[1])
    return np.concatenate([end[0] - start[0], turn, end[2] - start[2]])


def slopes(function: Callable[[Array], Array]) -> Array:
    """Central differences in each of the 34 directions."""
    steps = 1e-5 * np.eye(SIZE)
    return np.array([(function(step) - function(-step)) / 2e-5 for step in steps]).T


def flown(state: State, tensions: Array) -> State:
    """Rigid-body motion over a period under tensions that act as at the start; no gyroscopic
    moment."""
    position, quaternion, rest, covariance, mean = state
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(*some_state(0)[:2])
    wrench = kinematics.matrix @ tensions + rest[6:12]
    axes = np.array([_turned(quaternion, axis) for axis in np.eye(3)]).T
    linear = wrench[:3] / BODY[0] - np.array([0.0, 0.0, BODY[2]])
    angular = axes @ ((axes.T @ wrench[3:]) / BODY[1])
    h = PERIOD
    after = rest.copy()
    after[:3] += h * linear
    after[3:6] += h * angular
    there = position + h * rest[:3] + h * h / 2 * linear
    return there, rotate(quaternion, h * rest[3:6] + h * h / 2 * angular), after, covariance, mean


def _turned(quaternion: Array, vector: Array) -> Array:
    """A vector of the platform in the base frame: q v q*."""
    w, u = quaternion[0], quaternion[1:]
    return np.asarray(vector + 2.0 * np.cross(u, np.cross(u, vector) + w * vector))


def predicted_lengths(state: State) -> Array:
    """What the cables will report: true length less offset and excess elongation."""
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(state[0], state[1])
    return np.asarray(kinematics.lengths - state[2][12:20] - state[2][20:] * state[4])


@pytest.mark.parametrize("seed", range(4))
def test_a_tick_is_filterpys_predict_and_update(seed: int) -> None:
    """To a thousandth of a sigma: how the moment arms turn within a tick is left out of F."""
    tensions = np.array([50.0, 48.0, 45.0, 52.0, 40.0, 44.0, 46.0, 43.0])
    noise = np.linspace(1e-10, 1e-6, SIZE)
    state, start = some_state(seed), some_state(seed)
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(*state[:2])
    # Another part of each tension stretches its cable. The lengths' own elongation is the mean
    # one, so that both say the same about the excess.
    elastic = tensions * np.linspace(0.5, 1.2, 8)
    reported = predicted_lengths(start) + 1e-4 * np.sin(np.arange(8) + seed)
    mean = reported * elastic / (EA + elastic)
    state[4][:] = start[4][:] = mean
    innovations = np.zeros(8)
    filter_tick(
        state,
        BODY,
        PERIOD,
        (noise, LENGTH_VARIANCE, 0.5, CREEP),
        (kinematics.frame, kinematics.platform),
        (reported, tensions, elastic, USABLE),
        (0.0, np.inf),
        kinematics.lengths,
        kinematics.matrix,
        innovations,
        np.zeros(8),
        np.zeros(8, dtype=bool),
    )

    after = flown(start, tensions)
    transition = slopes(lambda e: difference(flown(moved(start, e), tensions), after))
    common = np.arange(SIZE) >= 26
    grown = np.diag(noise) + CREEP * np.outer(common, common)
    _, covariance = predict(np.zeros((SIZE, 1)), start[3], F=transition, Q=grown)
    observed = slopes(lambda e: predicted_lengths(moved(after, e)))[USABLE]
    innovation = (reported - predicted_lengths(after))[USABLE]
    np.testing.assert_allclose(innovations[USABLE], innovation, atol=1e-6)
    error, covariance = update(
        np.zeros((SIZE, 1)),
        covariance,
        innovation[:, None],
        LENGTH_VARIANCE * np.eye(USABLE.sum()),
        observed,
    )
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(difference(state, after) / scale, error[:, 0] / scale, atol=1e-3)
    np.testing.assert_allclose(
        state[3] / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=1e-3
    )


def test_a_tracker_pose_is_filterpys_update_with_the_constants() -> None:
    tensions = np.full(8, 45.0)
    variances = (3.6e-9, 1.44e-6, LENGTH_VARIANCE)
    state, start = some_state(7), some_state(7)
    kinematics = Kinematics(ROBOT.geometry)
    seen = (np.array([0.05, 0.02, 0.06]), np.array([1.0, 0.0, 0.0, 0.0]))
    kinematics.evaluate(*seen)
    there, turned = kinematics.lengths.copy(), kinematics.matrix.copy()
    then = there - start[2][12:20] - 2e-4 * np.cos(np.arange(8))
    mean = then * tensions / (EA + tensions)
    state[4][:] = start[4][:] = mean
    innovation = np.zeros(8)
    anchors = (kinematics.frame, kinematics.platform)
    chi_square = track(
        state,
        seen,
        variances,
        (then, tensions, np.ones(8, dtype=bool)),
        anchors,
        EA,
        np.inf,
        innovation,
        kinematics.matrix,
    )

    observed = np.zeros((8, SIZE))
    observed[:, 18:26], observed[:, 26:] = np.eye(8), np.diag(mean)
    spread = turned.T @ np.diag(np.repeat(variances[:2], 3)) @ turned + variances[2] * np.eye(8)
    expected = there - then - start[2][12:20] - start[2][20:] * mean
    error, covariance = update(np.zeros((SIZE, 1)), start[3], expected[:, None], spread, observed)
    total = observed @ start[3] @ observed.T + spread
    np.testing.assert_allclose(innovation, expected, atol=1e-15)
    assert np.isclose(chi_square, expected @ np.linalg.solve(total, expected), rtol=1e-9)
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(difference(state, start) / scale, error[:, 0] / scale, atol=1e-6)
    np.testing.assert_allclose(
        state[3] / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=1e-6
    )
