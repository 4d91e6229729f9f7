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
from tonus.runtime.control.sensing import Sensing

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
_CERTAIN = 1000
"""ticks: more than any number that is waited for"""
_UNDER_WAY = 2
"""ticks from a torque to the sample that it has made"""
_EVEN_TICKS = _UNDER_WAY + 1


@njit(cache=True)
def _observe(
    samples: tuple[NDArray[np.int64], NDArray[np.uint16], float],
    due: tuple[NDArray[np.bool_], NDArray[np.bool_], bool],
    skipped: bool,
    drums: tuple[Array, Array, Array, Array],
    tension: Array,
    interval: Array,
    drives: tuple[Array, Array, Array],
    limits: tuple[float, float, float],
    counts: tuple[Counts, Counts, Counts],
    observed: tuple[Array, Array, Array],
    past: tuple[Array, Array, Array],
    torques: Array,
    travel: Array,
) -> None:
    """``samples``: the axes' doubt (ns) and age, and the largest doubt; ``due``: usable, given up,
    enabled; ``drums``: angles (rad), rates (rad/s), the last tick's torques (N m), and rates that
    the platform's motion asks for; ``interval``: s that a rate is the mean of; ``drives`` (n,):
    drum radius, its mass at the cable, and the largest acceleration (m/s2); ``limits``: observer
    time, force (N) and share of the torque's that may be unexplained; ``counts``: ticks that were
    even, that were unobserved, that were misled; ``observed``: explained momentum, unexplained
    force, mean force of the torque; ``past``: last angles, speeds, intervals; ``torques``
    (`_UNDER_WAY`, n), those on their way.
    """
    radius, mass, fastest = drives
    time, force, share = limits
    even, unobserved, misled = counts
    explained, unexplained, mean = observed
    last, before, since = past
    for i in range(tension.shape[0]):
        uncertain = skipped or samples[0][i] > samples[2] or samples[1][i] > 0
        even[i] = 0 if uncertain else even[i] + 1
        wanted = due[0][i] and not due[1][i] and due[2]
        watched = wanted and even[i] >= _EVEN_TICKS
        unobserved[i] = unobserved[i] + 1 if wanted and not watched else 0
        acted = torques[_UNDER_WAY - 1, i]
        for k in range(_UNDER_WAY - 1, 0, -1):
            torques[k, i] = torques[k - 1, i]
        torques[0, i] = drums[2][i]
        speed, pull, following = radius[i] * drums[1][i], acted / radius[i], radius[i] * drums[3][i]
        if not (watched and math.isfinite(speed + pull + tension[i] + following)):
            explained[i], unexplained[i], mean[i] = mass[i] * speed, 0.0, abs(pull)
            misled[i], travel[i], last[i], before[i] = 0, 0.0, drums[0][i], speed
            since[i] = interval[i]
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
        travel[i] = travel[i] + period * following if drums[0][i] == last[i] else 0.0
        last[i] = drums[0][i]


class DrumObserver:
    """One tick of each drum's momentum."""

    def __init__(self, robot: Robot, settings: Settings) -> None:
        cables, radius, mass = robot.cables, robot.drum_radius, robot.drum_mass
        strongest = robot.torque_limit / radius
        self._drives = (radius, mass, settings.acceleration * strongest / mass)
        self._limits = (settings.torque_s, settings.torque_error, settings.torque_share)
        self._doubt_ns = settings.sample_doubt * 1e9
        self.unobserved = np.zeros(cables, dtype=np.int64)
        """(n,) ticks in a row in which a drum's motion could not be held against its torque"""
        self.misled = np.zeros(cables, dtype=np.int64)
        """(n,) ticks in a row in which it did not match"""
        self.travel = np.zeros(cables)
        """(n,) m that a standing drum should have wound, by the platform's motion"""
        self._counts = (np.zeros(cables, dtype=np.int64), self.unobserved, self.misled)
        self._observed = (np.zeros(cables), np.zeros(cables), np.zeros(cables))
        self._torques = np.zeros((_UNDER_WAY, cables))
        self._past = (np.zeros(cables), np.zeros(cables), np.zeros(cables))

    def reset(self) -> None:
        """What is counted of the samples goes on."""
        self.misled[:] = 0
        for each in (*self._observed, self._torques, self.travel):
            each[:] = 0.0
        self._past[1][:] = np.nan

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
        axes = image.axes
        _observe(
            (axes["doubt_ns"], axes["age"], self._doubt_ns),
            (sensing.usable, failed, enabled),
            skipped,
            (sensing.angle, sensing.rate, torque, following),
            sensing.tension,
            sensing.interval,
            self._drives,
            self._limits,
            self._counts,
            self._observed,
            self._past,
            self._torques,
            self.travel,
        )
