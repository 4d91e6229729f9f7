"""Geometry of the robot: cable lengths, structure matrix, pose from lengths.

Convention (docs/control.md): ``u_i`` points from the platform anchor to the frame anchor, so the
cables' wrench on the platform is ``W T`` with columns ``[u_i; r_i x u_i]`` and the cable rates are
``-W^T twist`` (the paper's eq. 1, 2 and 7 with J = -W^T, see docs/paper.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.robot import Geometry
from tonus.runtime.control.compiled import condition, forward, geometry

Array = NDArray[np.float64]


class Kinematics:
    """The geometry of one robot, evaluated at one pose at a time."""

    def __init__(self, robot_geometry: Geometry) -> None:
        self.frame = np.array(robot_geometry.frame, dtype=np.float64)
        self.platform = np.array(robot_geometry.platform, dtype=np.float64)
        self._moment_length = robot_geometry.moment_length
        cables = len(self.frame)
        self._all = np.ones(cables, dtype=bool)
        self.lengths = np.zeros(cables)
        """m, anchor to anchor"""
        self.matrix = np.zeros((6, cables))
        """structure matrix W"""

    def evaluate(self, position: Array, quaternion: Array) -> None:
        geometry(position, quaternion, self.frame, self.platform, self.lengths, self.matrix)

    @property
    def condition(self) -> float:
        """Condition number of the structure matrix, moments scaled: infinite in a singular pose."""
        return float(condition(self.matrix, self._moment_length))

    def fit(
        self,
        measured: Array,
        usable: NDArray[np.bool_],
        position: Array,
        quaternion: Array,
        *,
        iterations: int = 2,
    ) -> float:
        """Forward kinematics from a warm start: moves ``position`` and ``quaternion`` to the pose
        whose lengths fit the ``usable`` ones of ``measured`` (n,) best. Two iterations are enough
        for what a platform does in a tick.

        ``measured`` includes elongation (`Referencing.lengths`). Returns the RMS of the remaining
        length errors (m).
        """
        anchors = (self.frame, self.platform)
        return float(
            forward(
                measured,
                usable,
                anchors,
                position,
                quaternion,
                self.lengths,
                self.matrix,
                iterations,
            )
        )

    def solve(
        self, measured: Array, position: Array, quaternion: Array, *, iterations: int = 50
    ) -> tuple[Array, Array, float]:
        """Forward kinematics from a pose that may be far away: position, quaternion and the RMS of
        the remaining length errors (m)."""
        position, quaternion = position.copy(), quaternion.copy()
        residual = self.fit(measured, self._all, position, quaternion, iterations=iterations)
        return position, quaternion, residual
