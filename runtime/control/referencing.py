"""Absolute cable lengths from incremental encoders: the tracker says where the platform lies, the
cells how much each cable is stretched, and the drum angles are counted from there.

A cable has damping too: of a tension that changes, only a part stretches it yet. Taken as spring
alone, its length would be told 2 ms early, and at some tens of hertz that passes for a load.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.control import Sequence
from tonus.config.schema.robot import Robot
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.control.compiled import rotate
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.wrench import rotation_between

Array = NDArray[np.float64]


# The rows of what is kept of the cables: what they are, then their state.
(
    _UNSTRETCHED,
    _RADIUS,
    _AXIAL_STIFFNESS,
    _DAMPING,
    _WOUND,
    _LAST,
    _ELASTIC,
    _MEASURED,
) = range(8)
_ROWS = _MEASURED + 1


@njit(cache=True)
def _lengths(cables: Array, slack: float, angle: Array, tension: Array, passed: float) -> None:
    """Of a cable that is a spring and a damper side by side, `c de/dt + k e = T` with the tension
    linear from sample to sample, ``passed`` s apart; the elastic row is k e. Below ``slack``
    nothing holds a cable stretched that its damper could delay."""
    unstretched, radius = cables[_UNSTRETCHED], cables[_RADIUS]
    axial_stiffness, damping = cables[_AXIAL_STIFFNESS], cables[_DAMPING]
    wound, last, elastic, lengths = (
        cables[_WOUND],
        cables[_LAST],
        cables[_ELASTIC],
        cables[_MEASURED],
    )
    for i in range(angle.shape[0]):
        wound[i] = unstretched[i] - radius[i] * angle[i]
        time = damping[i] * wound[i] / axial_stiffness[i]
        if tension[i] <= slack or not time > 0.0:
            elastic[i] = tension[i]
        else:
            kept = math.exp(-passed / time)
            mean = (1.0 - kept) * time / passed
            elastic[i] = kept * elastic[i] + (mean - kept) * last[i] + (1.0 - mean) * tension[i]
        last[i] = tension[i]
        lengths[i] = wound[i] * (1.0 + elastic[i] / axial_stiffness[i])


def turn_deg(quaternion: Array) -> float:
    """By how much a platform is turned from level."""
    return math.degrees(2.0 * math.atan2(float(np.linalg.norm(quaternion[1:])), abs(quaternion[0])))


class Referencing:
    """Averages while the platform lies still, then fixes the unstretched lengths (n,) at drum angle
    zero, or says why it cannot."""

    def __init__(
        self,
        robot: Robot,
        sequence: Sequence,
        kinematics: Kinematics,
        slack: float,
        period: float,
    ) -> None:
        """``slack``: N up to which a cable does not pull."""
        self._robot, self._sequence, self._kinematics = robot, sequence, kinematics
        self._radius, self._axial_stiffness = robot.drum_radius, robot.axial_stiffness
        self._period = period
        self._cables = cables = np.zeros((_ROWS, robot.cables))
        cables[_RADIUS], cables[_AXIAL_STIFFNESS] = self._radius, self._axial_stiffness
        cables[_DAMPING] = robot.cable_damping
        self._slack = slack
        self.unstretched = cables[_UNSTRETCHED]
        """m, at drum angle zero"""
        self.wound = cables[_WOUND]
        """m, the same at the present angles"""
        self.elastic = cables[_ELASTIC]
        """N (n,), the part of the tensions that stretches the cables"""
        self._last = cables[_LAST]
        self.measured: Array = cables[_MEASURED]
        """m (n,), the last `lengths`"""
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
        turn = turn_deg(self.quaternion)
        if not turn <= sequence.referencing_turn_deg:
            return f"the platform lies askew, turned by {turn:.1f} deg"
        angle, tension = self._angle / self._ticks, self._tension / self._ticks
        errors = np.abs(tension - wanted_tension)
        error = float(errors.max())
        if not error <= sequence.referencing_tension_error:
            near = errors <= sequence.referencing_tension_error
            self.astray = np.flatnonzero(~near).tolist()
            return f"a cable's tension is {error:.1f} N away from {wanted_tension:.0f} N"
        self._kinematics.evaluate(self.position, self.quaternion)
        self.rest(self._kinematics.lengths, angle, tension)
        return ""

    def rest(self, lengths: Array, angle: Array, tension: Array) -> None:
        """The cables are ``lengths`` (n,) m long, at drum angles (n,) rad and with tensions (n,) N
        that have not changed for a while."""
        stretch = 1.0 + tension / self._axial_stiffness
        self.unstretched[:] = lengths / stretch + self._radius * angle
        self.elastic[:] = self._last[:] = tension

    def lengths(self, angle: Array, tension: Array, skipped: int = 0) -> Array:
        """Anchor-to-anchor lengths (n,) in m from drum angles (rad) and tensions (N) of a tick,
        before which so many were ``skipped``; they stay until the next call, and so do the
        unstretched ones in `wound` and the tensions in `elastic`."""
        _lengths(self._cables, self._slack, angle, tension, self._period * (1 + skipped))
        return self.measured
