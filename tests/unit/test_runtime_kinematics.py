"""Geometry against a second derivation: plain numpy, finite differences, scipy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from config import load
from runtime.compiled import rotate, rotation_between
from runtime.kinematics import Kinematics

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
