"""Geometry of the robot: cable lengths, structure matrix, pose from lengths.

Convention (docs/control.md): ``u_i`` points from the platform anchor to the frame anchor, so the
cables' wrench on the platform is ``W T`` with columns ``[u_i; r_i x u_i]`` and the cable rates are
``-W^T twist`` (the paper's eq. 1, 2 and 7 with J = -W^T, see docs/paper.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from config.schema.robot import Geometry
from runtime.compiled import correction, geometry, rotate

Array = NDArray[np.float64]


class Kinematics:
    """The geometry of one robot, evaluated at one pose at a time."""

    def __init__(self, robot_geometry: Geometry) -> None:
        self.frame = np.array(robot_geometry.frame, dtype=np.float64)
        self.platform = np.array(robot_geometry.platform, dtype=np.float64)
        cables = len(self.frame)
        self.lengths = np.zeros(cables)
        """m, anchor to anchor"""
        self.matrix = np.zeros((6, cables))
        """structure matrix W"""

    def evaluate(self, position: Array, quaternion: Array) -> None:
        geometry(position, quaternion, self.frame, self.platform, self.lengths, self.matrix)

    def solve(
        self, measured: Array, position: Array, quaternion: Array, *, iterations: int = 20
    ) -> tuple[Array, Array, float]:
        """Pose whose lengths fit ``measured`` best, from a starting pose.

        Returns position, quaternion and the RMS of the remaining length errors.
        """
        for _ in range(iterations):
            self.evaluate(position, quaternion)
            step = correction(self.lengths, self.matrix, measured)
            position = position + step[:3]
            quaternion = rotate(quaternion, step[3:])
            if float(np.abs(step).max()) < 1e-12:
                break
        self.evaluate(position, quaternion)
        residual = float(np.sqrt(np.mean((self.lengths - measured) ** 2)))
        return position, quaternion, residual
