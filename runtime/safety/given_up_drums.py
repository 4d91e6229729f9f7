"""Whether the drum of a given-up cable still does what its torque says.

`drum_observer` leaves such drums out, since their cells may be what is wrong. A passive stop gives
them torque all the same, and a motor that is reversed then is driven by its own damping. Without a
cell the tension is known to lie between nothing and the most that a cable may carry: what neither
explains is the drum's or its motor's. The residual is that of `drum_observer`, of a drum whose
tension counts as unexplained.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.robot import Robot
from tonus.config.schema.safety import Isolation as Settings
from tonus.drivers.process_image import AxisState, ProcessImage
from tonus.runtime.control.sensing import INTERVAL, RATE, Sensing

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# The rows of what is kept of the drums: constants, then the observer's state.
_RADIUS, _MASS, _EXPLAINED, _UNEXPLAINED, _MEAN = range(5)
_ROWS = _MEAN + 1


@njit(cache=True)
def _watch(
    sensed: Array,
    watched: Mask,
    acted: Array,
    drums: Array,
    limits: Array,
    astray: NDArray[np.int64],
) -> None:
    """One tick of the drums ``watched`` (n,); the others begin anew. Of what is ``sensed``, as
    `Sensing.drums` has it, and the torque (n,) N m that ``acted`` on it. ``limits``: the observer's
    time (s), force (N), share of the torque's, and largest tension (N). ``astray`` (n,): ticks in a
    row."""
    time, force, share, tension = limits
    radius, mass = drums[_RADIUS], drums[_MASS]
    explained, unexplained, mean = drums[_EXPLAINED], drums[_UNEXPLAINED], drums[_MEAN]
    for i in range(watched.shape[0]):
        speed, pull = radius[i] * sensed[RATE, i], acted[i] / radius[i]
        period = sensed[INTERVAL, i]
        if not (watched[i] and math.isfinite(speed + pull + explained[i])):
            explained[i], unexplained[i], mean[i] = mass[i] * speed, 0.0, abs(pull)
            astray[i] = 0
            continue
        explained[i] += period * (pull + unexplained[i])
        unexplained[i] = (mass[i] * speed - explained[i]) / time
        mean[i] += period / time * (abs(pull) - mean[i])
        allowed = force + share * mean[i]
        beyond = unexplained[i] > allowed or unexplained[i] < -tension - allowed
        astray[i] = astray[i] + 1 if beyond else 0


class GivenUpDrums:
    """Call `step` in each tick in which a cable is given up."""

    def __init__(self, robot: Robot, settings: Settings) -> None:
        self._drums = np.zeros((_ROWS, robot.cables))
        self._drums[_RADIUS], self._drums[_MASS] = robot.drum_radius, robot.drum_mass
        self._acted, self._sent = np.zeros(robot.cables), np.zeros(robot.cables)
        """N m (n,): a torque makes its motion two ticks later"""
        allowed = (settings.torque_s, settings.torque_error, settings.torque_share)
        self._limits = np.array([*allowed, settings.given_up_tension])
        self._ticks = settings.torque_descent_ticks
        self._astray = np.zeros(robot.cables, np.int64)

    def reset(self) -> None:
        """No cable is given up."""
        self._astray[:] = 0
        self._acted[:] = self._sent[:] = 0.0
        self._drums[_EXPLAINED:] = np.nan

    def step(self, image: ProcessImage, sensing: Sensing, watched: Mask, torque: Array) -> None:
        """Drums that are ``watched`` (n,), and the last tick's torques (n,) N m."""
        powered = image.axes["state"] == AxisState.OPERATION_ENABLED
        now = watched & powered & (image.axis.age == 0)
        _watch(sensing.drums, now, self._acted, self._drums, self._limits, self._astray)
        self._acted[:], self._sent[:] = self._sent, torque

    @property
    def disobedient(self) -> int:
        """The first that does not; -1: none."""
        place = int(self._astray.argmax())
        return place if self._astray[place] >= self._ticks else -1
