"""Geometry against a second derivation: plain numpy, finite differences, scipy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from tonus.config import load
from tonus.runtime.control.compiled import rotate
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.wrench import rotation_between

CONFIG, _ = load("config/can.yaml")
GEOMETRY = CONFIG.robot.geometry
FRAME, PLATFORM = np.array(GEOMETRY.frame), np.array(GEOMETRY.platform)
POSES = [
    ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ((0.2, -0.15, 0.1), (0.1, -0.08, 0.12)),
    ((-0.25, 0.25, -0.2), (-0.17, 0.0, 0.17)),
]
Array = NDArray[np.float64]


def scalar_first(rotation: Rotation) -> Array:
    return np.asarray(np.roll(rotation.as_quat(), 1))


def from_scalar_first(quaternion: Array) -> Rotation:
    return Rotation.from_quat(np.roll(quaternion, -1))


def lengths_at(position: Array, rotation: Rotation) -> Array:
    return np.asarray(np.linalg.norm(FRAME - position - rotation.apply(PLATFORM), axis=1))


@pytest.mark.parametrize(("position", "turn"), POSES)
def test_lengths_are_the_distances_between_anchors(
    position: tuple[float, ...], turn: tuple[float, ...]
) -> None:
    rotation = Rotation.from_rotvec(turn)
    kinematics = Kinematics(GEOMETRY)
    kinematics.evaluate(np.array(position), scalar_first(rotation))
    expected = lengths_at(np.array(position), rotation)
    np.testing.assert_allclose(kinematics.lengths, expected, rtol=1e-14)


@pytest.mark.parametrize(("position", "turn"), POSES)
def test_the_structure_matrix_is_minus_the_lengths_jacobian(
    position: tuple[float, ...], turn: tuple[float, ...]
) -> None:
    """Lengths change by -W^T times the twist: differentiated numerically, without our rotations."""
    point, rotation, h = np.array(position), Rotation.from_rotvec(turn), 1e-6
    slope = np.zeros((8, 6))
    for axis in range(3):
        step = h * np.eye(3)[axis]
        slope[:, axis] = lengths_at(point + step, rotation) - lengths_at(point - step, rotation)
        ahead, behind = Rotation.from_rotvec(step), Rotation.from_rotvec(-step)
        slope[:, 3 + axis] = lengths_at(point, ahead * rotation) - lengths_at(
            point, behind * rotation
        )
    kinematics = Kinematics(GEOMETRY)
    kinematics.evaluate(point, scalar_first(rotation))
    np.testing.assert_allclose(-kinematics.matrix.T, slope / (2 * h), atol=1e-8)


def test_even_tensions_at_home_pull_nowhere_sideways() -> None:
    kinematics = Kinematics(GEOMETRY)
    kinematics.evaluate(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    wrench = kinematics.matrix @ np.full(8, 45.0)
    np.testing.assert_allclose(wrench[[0, 1, 3, 4, 5]], 0.0, atol=1e-12)


def test_solve_reports_what_no_pose_explains() -> None:
    kinematics = Kinematics(GEOMETRY)
    level = np.array([1.0, 0.0, 0.0, 0.0])
    kinematics.evaluate(np.zeros(3), level)
    null = np.linalg.svd(kinematics.matrix)[2][-1]
    measured = kinematics.lengths + 1e-3 * null
    position, _, residual = kinematics.solve(measured, np.array([0.01, 0.0, 0.0]), level)
    assert np.abs(position).max() < 1e-5
    assert residual == pytest.approx(1e-3 / np.sqrt(8), rel=1e-2)


@pytest.mark.parametrize(("position", "turn"), POSES)
@pytest.mark.parametrize("lost", [(), (3,), (6,)])
def test_forward_kinematics_is_the_least_squares_pose(
    position: tuple[float, ...], turn: tuple[float, ...], lost: tuple[int, ...]
) -> None:
    """Against scipy's solver on rotation vectors, from lengths that no pose has: 2 mm of error."""
    random, usable = np.random.default_rng(4), np.ones(8, dtype=bool)
    usable[list(lost)] = False
    true = lengths_at(np.array(position), Rotation.from_rotvec(turn))
    measured = true + 2e-3 * random.normal(size=8)

    def errors(pose: Array) -> Array:
        found = lengths_at(pose[:3], Rotation.from_rotvec(pose[3:]))
        return np.asarray((found - measured)[usable])

    best = least_squares(errors, np.zeros(6), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    point, quaternion = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    kinematics = Kinematics(GEOMETRY)
    residual = kinematics.fit(measured, usable, point, quaternion, iterations=50)
    np.testing.assert_allclose(point, best.x[:3], atol=1e-8)
    away = from_scalar_first(quaternion) * Rotation.from_rotvec(best.x[3:]).inv()
    assert away.magnitude() < 1e-7
    assert residual == pytest.approx(np.sqrt(2.0 * best.cost / usable.sum()), rel=1e-6, abs=1e-12)


def test_two_iterations_are_enough_for_what_a_platform_does_in_a_tick() -> None:
    """At 1 m/s and 5 rad/s, four times and more of what the envelope lets pass."""
    point, rotation = np.array(POSES[1][0]), Rotation.from_rotvec(POSES[1][1])
    position, quaternion = point.copy(), scalar_first(rotation)
    ahead = Rotation.from_rotvec([0.003, -0.004, 0.0]) * rotation
    moved = point + np.array([0.0006, 0.0, -0.0008])
    kinematics = Kinematics(GEOMETRY)
    kinematics.fit(lengths_at(moved, ahead), np.ones(8, dtype=bool), position, quaternion)
    np.testing.assert_allclose(position, moved, atol=1e-9)


def test_lengths_that_are_none_give_no_pose_and_no_exception() -> None:
    kinematics, position = Kinematics(GEOMETRY), np.zeros(3)
    level = np.array([1.0, 0.0, 0.0, 0.0])
    assert np.isnan(kinematics.fit(np.full(8, np.nan), np.ones(8, dtype=bool), position, level))
    np.testing.assert_array_equal(position, 0.0)
    assert kinematics.fit(np.zeros(8), np.zeros(8, dtype=bool), position, level) == 0.0


@pytest.mark.parametrize(("position", "turn"), POSES)
def test_the_condition_number_is_that_of_the_scaled_matrix(
    position: tuple[float, ...], turn: tuple[float, ...]
) -> None:
    kinematics = Kinematics(GEOMETRY)
    kinematics.evaluate(np.array(position), scalar_first(Rotation.from_rotvec(turn)))
    scaled = kinematics.matrix / np.array([1.0] * 3 + [GEOMETRY.moment_length] * 3)[:, None]
    assert kinematics.condition == pytest.approx(np.linalg.cond(scaled), rel=1e-9)


def test_a_robot_whose_cables_all_meet_in_one_point_is_singular() -> None:
    """They exert no moment about it."""
    points = ((0.0, 0.0, 0.0),) * 8
    kinematics = Kinematics(GEOMETRY.model_copy(update={"platform": points}))
    kinematics.evaluate(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    assert kinematics.condition > 1e7


def test_rotate_turns_in_the_base_frame_and_keeps_unit_length() -> None:
    random = np.random.default_rng(1)
    for size in (1e-12, 1e-5, 1e-4, 0.3, 3.0):
        start, turn = Rotation.random(random_state=random), random.normal(size=3) * size
        turned = rotate(scalar_first(start), turn)
        expected = Rotation.from_rotvec(turn) * start
        assert (from_scalar_first(turned) * expected.inv()).magnitude() < 1e-14 + 1e-9 * size
        assert np.linalg.norm(turned) == pytest.approx(1.0, abs=1e-15)


def test_rotation_between_takes_the_short_way_whatever_the_signs() -> None:
    random = np.random.default_rng(2)
    for _ in range(50):
        start = Rotation.random(random_state=random)
        turn = random.normal(size=3)
        turn *= random.uniform(0.0, 3.1) / np.linalg.norm(turn)
        end = scalar_first(Rotation.from_rotvec(turn) * start)
        for sign in (1.0, -1.0):
            found = rotation_between(scalar_first(start), sign * end)
            np.testing.assert_allclose(found, turn, atol=1e-12)
