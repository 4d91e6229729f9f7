"""Absolute cable lengths from incremental encoders: the tracker says where the platform lies, the
cells how much each cable is stretched, and the drum angles are counted from there."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.control import Sequence
from tonus.config.schema.robot import Robot
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.control.compiled import rotate, rotation_between
from tonus.runtime.control.kinematics import Kinematics

Array = NDArray[np.float64]


@njit(cache=True)
def _lengths(
    unstretched: Array,
    angle: Array,
    tension: Array,
    radius: Array,
    axial_stiffness: Array,
    wound: Array,
    lengths: Array,
) -> None:
    for i in range(angle.shape[0]):
        wound[i] = unstretched[i] - radius[i] * angle[i]
        lengths[i] = wound[i] * (1.0 + tension[i] / axial_stiffness[i])


class Referencing:
    """Averages while the platform lies still, then fixes the unstretched lengths (n,) at drum angle
    zero, or says why it cannot."""

    def __init__(self, robot: Robot, sequence: Sequence, kinematics: Kinematics) -> None:
        self._robot, self._sequence, self._kinematics = robot, sequence, kinematics
        self._radius, self._axial_stiffness = robot.drum_radius, robot.axial_stiffness
        self.unstretched = np.zeros(robot.cables)
        """m, at drum angle zero"""
        self.wound = np.zeros(robot.cables)
        """m, the same at the present angles"""
        self._lengths = np.zeros(robot.cables)
        self.position = np.zeros(3)
        self.quaternion = np.array([1.0, 0.0, 0.0, 0.0])
        self.poses = 0
        self.reset()

    def reset(self) -> None:
        self.astray: list[int] = []
        """cables whose tension was not that which was asked for"""
        self._angle = np.zeros(self._robot.cables)
        self._tension = np.zeros(self._robot.cables)
        self._ticks = 0
        self._positions: list[Array] = []
        self._turns: list[Array] = []
        self._first = np.array([1.0, 0.0, 0.0, 0.0])

    def collect(self, image: ProcessImage, angle: Array, tension: Array) -> None:
        self._angle += angle
        self._tension += tension
        self._ticks += 1
        if image.tracker["fresh"]:
            quaternion = image.tracker["quaternion"].copy()
            if not self._turns:
                self._first = quaternion
            self._positions.append(image.tracker["position"].copy())
            self._turns.append(rotation_between(self._first, quaternion))

    def conclude(self, wanted_tension: float) -> str:
        """Compute the lengths; an empty string when good, otherwise the reason it is not."""
        sequence, robot = self._sequence, self._robot
        self.poses = len(self._positions)
        if self.poses < sequence.referencing_poses:
            return f"only {self.poses} tracker poses, {sequence.referencing_poses} are needed"
        positions = np.array(self._positions)
        self.position = positions.mean(axis=0)
        self.quaternion = rotate(self._first, np.array(self._turns).mean(axis=0))
        spread = float(np.abs(positions - self.position).max())
        if not spread <= sequence.referencing_spread:
            return f"the tracker's poses spread over {spread * 1e3:.1f} mm"
        distance = float(np.linalg.norm(self.position - np.array(robot.rest)))
        if not distance <= sequence.referencing_distance:
            return f"the platform lies {distance * 1e3:.0f} mm from its cradle"
        angle, tension = self._angle / self._ticks, self._tension / self._ticks
        errors = np.abs(tension - wanted_tension)
        error = float(errors.max())
        if not error <= sequence.referencing_tension_error:
            near = errors <= sequence.referencing_tension_error
            self.astray = np.flatnonzero(~near).tolist()
            return f"a cable's tension is {error:.1f} N away from {wanted_tension:.0f} N"
        self._kinematics.evaluate(self.position, self.quaternion)
        stretch = 1.0 + tension / self._axial_stiffness
        self.unstretched = self._kinematics.lengths / stretch + self._radius * angle
        return ""

    def lengths(self, angle: Array, tension: Array) -> Array:
        """Anchor-to-anchor lengths (n,) in m from drum angles (rad) and tensions (N); they stay
        until the next call, and so do the unstretched ones in `wound`."""
        _lengths(
            self.unstretched,
            angle,
            tension,
            self._radius,
            self._axial_stiffness,
            self.wound,
            self._lengths,
        )
        return self._lengths
