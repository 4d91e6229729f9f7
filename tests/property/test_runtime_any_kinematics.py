"""Forward kinematics finds any pose of the workspace again, from far away."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tonus.config import load
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.wrench import rotation_between

ROBOT = load("config/can.yaml")[0].robot
BOX = ROBOT.workspace
TILT = math.radians(BOX.tilt_deg)
within = st.tuples(*[st.floats(low, high) for low, high in (BOX.x, BOX.y, BOX.z)])
tilts = st.tuples(*[st.floats(-TILT, TILT)] * 3)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(within, tilts)
def test_solve_recovers_the_pose_from_its_lengths(
    position: tuple[float, ...], turn: tuple[float, ...]
) -> None:
    kinematics = Kinematics(ROBOT.geometry)
    quaternion = np.roll(Rotation.from_rotvec(turn).as_quat(), 1)
    kinematics.evaluate(np.array(position), quaternion)
    measured = kinematics.lengths.copy()
    found, oriented, residual = kinematics.solve(
        measured, np.array(ROBOT.home), np.array([1.0, 0.0, 0.0, 0.0])
    )
    np.testing.assert_allclose(found, position, atol=1e-9)
    assert np.abs(rotation_between(quaternion, oriented)).max() < 1e-8
    assert residual < 1e-10
