"""Whether each drum's motion matches its torque and its cable's tension, independent of the pose.

An observer of the drum's momentum gives the force that torque and tension leave unexplained (De
Luca and Mattone, ICRA 2005). Only drums are observed whose torque and motion are of one time: after
a missed tick, or a sample that is late or of uncertain time, a drum waits for `_EVEN_TICKS`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.robot import Robot
from tonus.config.schema.safety import Isolation as Settings
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.control.sensing import ANGLE, INTERVAL, RATE, Sensing, Table

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
_CERTAIN = 1000
"""ticks: more than any number that is waited for"""
_UNDER_WAY = 2
"""ticks from a torque to the sample that it has made"""
_EVEN_TICKS = _UNDER_WAY + 1

# The rows of what is kept of the drums: constants, then the observer's state; and of its counts.
(
    _RADIUS,
    _MASS,
    _FASTEST,
    _EXPLAINED,
    _UNEXPLAINED,
    _MEAN,
    _TRAVEL,
    _LAST,
    _BEFORE,
    _SINCE,
) = range(10)
_ROWS = _SINCE + 1
_EVEN, _UNOBSERVED, _MISLED, _STANDING = range(4)


@njit(cache=True)
def _observe(
    axes: Table,
    usable: NDArray[np.bool_],
    failed: NDArray[np.bool_],
    sensed: Array,
    torque: Array,
    following: Array,
    tension: Array,
    enabled: bool,
    skipped: bool,
    drums: Array,
    counts: Counts,
    torques: Array,
    limits: Array,
) -> tuple[int, int]:
    """Returns the most ticks that any drum is misled, and is unobserved.

    Of the axes' samples the doubt (ns) and age; drums that are ``usable`` and have ``failed``; what
    is ``sensed`` of them, as `Sensing.drums` has it; the last tick's ``torque`` (N m), and the rate
    (rad/s) at which the drum would be ``following`` the platform. Rows of ``drums``: radius, mass
    at the cable, and the fastest acceleration (m/s2); momentum that is explained, force that is
    unexplained, mean force of the torque; travel (m); last angles, speeds before, intervals since.
    Rows of ``counts``: ticks that were even, unobserved, misled, and in which the
    angle stayed as it was. ``torques`` (`_UNDER_WAY`, n),
    those on their way. ``limits``: largest doubt (ns), the observer's time (s), force (N) and share
    of the torque's that may be unexplained.
    """
    doubt_ns, age = axes.doubt_ns, axes.age
    angle, rate, interval = sensed[ANGLE], sensed[RATE], sensed[INTERVAL]
    radius, mass, fastest = drums[_RADIUS], drums[_MASS], drums[_FASTEST]
    explained, unexplained, mean = drums[_EXPLAINED], drums[_UNEXPLAINED], drums[_MEAN]
    last, before, since, travel = drums[_LAST], drums[_BEFORE], drums[_SINCE], drums[_TRAVEL]
    even, unobserved, misled = counts[_EVEN], counts[_UNOBSERVED], counts[_MISLED]
    standing = counts[_STANDING]
    largest_doubt_ns, time, force, share = limits[0], limits[1], limits[2], limits[3]
    most = longest = 0
    for i in range(tension.shape[0]):
        uncertain = skipped or doubt_ns[i] > largest_doubt_ns or age[i] > 0
        even[i] = 0 if uncertain else even[i] + 1
        wanted = usable[i] and not failed[i] and enabled
        watched = wanted and even[i] >= _EVEN_TICKS
        unobserved[i] = unobserved[i] + 1 if wanted and not watched else 0
        longest = max(longest, unobserved[i])
        acted = torques[_UNDER_WAY - 1, i]
        for k in range(_UNDER_WAY - 1, 0, -1):
            torques[k, i] = torques[k - 1, i]
        torques[0, i] = torque[i]
        speed, pull, ahead = radius[i] * rate[i], acted / radius[i], radius[i] * following[i]
        known = explained[i] + mean[i]  # no number after a sample that was none: begin anew
        if not (watched and math.isfinite(speed + pull + tension[i] + ahead + known)):
            explained[i], unexplained[i], mean[i] = mass[i] * speed, 0.0, abs(pull)
            misled[i], travel[i], last[i], before[i] = 0, 0.0, angle[i], speed
            standing[i], since[i] = 0, interval[i]
            continue
        period = interval[i]
        explained[i] += period * (pull - tension[i] + unexplained[i])
        unexplained[i] = (mass[i] * speed - explained[i]) / time
        mean[i] += period / time * (abs(pull) - mean[i])
        beyond = abs(unexplained[i]) > force + share * mean[i]
        misled[i] = misled[i] + 1 if beyond else 0
        if abs(speed - before[i]) > fastest[i] * 0.5 * (period + since[i]):
            misled[i] = _CERTAIN
        before[i], since[i] = speed, period
        stands = angle[i] == last[i]
        standing[i] = standing[i] + 1 if stands else 0
        travel[i] = travel[i] + period * ahead if stands else 0.0
        last[i] = angle[i]
        most = max(most, misled[i])
    return most, longest


class DrumObserver:
    """One tick of each drum's momentum."""

    def __init__(self, robot: Robot, settings: Settings) -> None:
        cables, radius, mass = robot.cables, robot.drum_radius, robot.drum_mass
        strongest = robot.torque_limit / radius
        self._drums, self._counts = np.zeros((_ROWS, cables)), np.zeros((4, cables), np.int64)
        self._torques = np.zeros((_UNDER_WAY, cables))
        self._drums[_RADIUS], self._drums[_MASS] = radius, mass
        self._drums[_FASTEST] = settings.acceleration * strongest / mass
        doubt_ns = settings.sample_doubt * 1e9
        allowed = (settings.torque_s, settings.torque_error, settings.torque_share)
        self._limits = np.array([doubt_ns, *allowed])
        self.unobserved = self._counts[_UNOBSERVED]
        """(n,) ticks in a row in which a drum's motion could not be held against its torque"""
        self.misled = self._counts[_MISLED]
        """(n,) ticks in a row in which it did not match"""
        self.standing = self._counts[_STANDING]
        """(n,) ticks in a row in which its encoder showed no motion at all"""
        self.travel = self._drums[_TRAVEL]
        """(n,) m that a standing drum should have wound, by the platform's motion"""
        self.most_misled = self.longest_unobserved = 0
        """ticks, of the drum that has been misled or unobserved for longest"""

    def reset(self) -> None:
        """What is counted of the samples goes on."""
        self.misled[:] = 0
        self.most_misled = 0
        self._drums[_EXPLAINED:_LAST] = 0.0
        self._torques[:] = 0.0
        self._drums[_BEFORE] = np.nan

    def step(
        self,
        image: ProcessImage,
        sensing: Sensing,
        failed: NDArray[np.bool_],
        torque: Array,
        following: Array,
        *,
        skipped: bool,
        enabled: bool,
    ) -> None:
        """From the samples' times in ``image``, what ``sensing`` has of them, the drums that have
        ``failed`` (n,), the last tick's torques (n,) N m, and the rates (n,) rad/s at which they
        would follow the platform; ``skipped``: ticks before this one were missed."""
        self.most_misled, self.longest_unobserved = _observe(
            image.axes,
            sensing.usable,
            failed,
            sensing.drums,
            torque,
            following,
            sensing.tension,
            enabled,
            skipped,
            self._drums,
            self._counts,
            self._torques,
            self._limits,
        )
