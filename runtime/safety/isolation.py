"""Which cable contradicts the others: torn, slack, slipped, jammed, or measured wrongly.

Residuals of each cable; they are small for an intact cable:

- *jump*: its length, elongation included, leaves in one tick what the estimate predicts of it. A
  torn cable's elongation vanishes with its tension; a slip on the drum or of the encoder moves its
  length. The others' innovations stay within their noise, since a platform has mass.
- *tension error*: its tension does not follow its reference: drum jammed, friction, motor weak or
  reversed, or a cell of wrong gain.
- *torque*: its drum's motion does not match torque and tension; an observer of the drum's momentum
  gives the unexplained torque (De Luca and Mattone, ICRA 2005). A drum that speeds up or stops in
  one tick faster than any torque allows has jammed, or its encoder has slipped.
- *travel*: its drum does not turn although the platform's motion would turn it. Friction may cause
  that for some millimetres, so it only identifies the cable when lengths contradict each other.
- *drift*: its innovation has a mean: an error grows slowly, and the fault is that of the cable
  whose mean stands out. If none does, the cables contradict each other, and no cable is named.

In a descent the estimate is loose and innovations of 2 mm are usual. A cable whose mean innovation
is beyond `innovation_descent` for long and stands out has a wrong length. That is reported only:
its cell still measures its tension, and the estimate is loose enough not to follow one length.

In a descent a slack cable's drum reels in towards the platform: if it has reeled in more than the
distance to the platform, the cable is torn. A load cell whose reading repeats to the last bit while
its reference moves is frozen.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.robot import Robot
from tonus.config.schema.safety import Isolation as Settings
from tonus.config.schema.safety import Stop
from tonus.runtime.states import Fault

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
_BY_LENGTH = (Fault.LENGTH_JUMP, Fault.LENGTH_DRIFT)
_CERTAIN = 1000
"""ticks: more than any number that is waited for"""
_UNDER_WAY = 2
"""ticks from a torque to the sample that it has made"""


@njit(cache=True)
def _count(
    innovation: Array,
    tension: tuple[Array, Array],
    watched: NDArray[np.bool_],
    limits: tuple[float, float, float],
    jumped: Counts,
    astray: Counts,
    drift: Array,
) -> None:
    """``tension``: reference and filtered; ``limits``: jump (m), tension error (N), share of a tick
    in the mean innovation. An innovation that is not a number (no sample) counts for nothing."""
    jump, error, share = limits
    for i in range(innovation.shape[0]):
        if not watched[i]:
            jumped[i] = astray[i] = 0
            drift[i] = 0.0
            continue
        if math.isfinite(innovation[i]):
            jumped[i] = jumped[i] + 1 if abs(innovation[i]) > jump else 0
            bounded = min(max(innovation[i], -2.0 * jump), 2.0 * jump)
            drift[i] += share * (bounded - drift[i])
        off = abs(tension[0][i] - tension[1][i]) > error
        astray[i] = astray[i] + 1 if off else 0


@njit(cache=True)
def _turn(
    drums: tuple[Array, Array, Array],
    tension: Array,
    following: Array,
    watched: NDArray[np.bool_],
    interval: Array,
    drives: tuple[Array, Array, Array],
    limits: tuple[float, float, float],
    observed: tuple[Array, Array, Array],
    misled: Counts,
    past: tuple[Array, Array, Array],
    travel: Array,
) -> None:
    """``drums``: angles (rad), rates (rad/s) and the torques (N m) that made them; ``following``:
    m/s that the cables shorten by the platform's motion; ``interval``: s that a rate is the mean
    of; ``drives`` (n,): drum radius, its mass at the cable, and the largest acceleration (m/s2);
    ``limits``: observer time, force (N) and share of the torque's that may be unexplained;
    ``observed``: explained momentum, unexplained force, mean force of the torque; ``past``: last
    angles, speeds, intervals.
    """
    radius, mass, fastest = drives
    time, force, share = limits
    explained, unexplained, mean = observed
    last, before, since = past
    for i in range(tension.shape[0]):
        speed, pull = radius[i] * drums[1][i], drums[2][i] / radius[i]
        if not (watched[i] and math.isfinite(speed + pull + tension[i] + following[i])):
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
        travel[i] = travel[i] + period * following[i] if drums[0][i] == last[i] else 0.0
        last[i] = drums[0][i]


@njit(cache=True)
def _repeat(
    raw: Array,
    age: NDArray[np.uint16],
    reference: Array,
    change: float,
    loaded: NDArray[np.bool_],
    last: Array,
    then: Array,
    same: Counts,
) -> None:
    """``then``: the tension references when the readings last changed; a reading counts as repeated
    once its reference has moved by ``change`` (N) from there."""
    for i in range(reference.shape[0]):
        if age[i] != 0:
            continue
        if raw[i] != last[i] or not loaded[i]:
            last[i], then[i], same[i] = raw[i], reference[i], 0
        elif abs(reference[i] - then[i]) > change:
            same[i] += 1


class Isolation:
    """One tick of residuals; `found` is the first fault they show, and where."""

    def __init__(self, robot: Robot, settings: Settings, stop: Stop, period: float) -> None:
        self._settings, self._taut = settings, stop.taut_tension
        radius, mass = robot.drum_radius, robot.drum_mass
        strongest = robot.torque_limit / radius
        self._drives = (radius, mass, settings.acceleration * strongest / mass)
        self._turning = (settings.torque_s, settings.torque_error, settings.torque_share)
        self._observed = (np.zeros(robot.cables), np.zeros(robot.cables), np.zeros(robot.cables))
        self._torques = np.zeros((_UNDER_WAY, robot.cables))
        self._misled = np.zeros(robot.cables, dtype=np.int64)
        self._past = (np.zeros(robot.cables), np.zeros(robot.cables), np.zeros(robot.cables))
        self._travel = np.zeros(robot.cables)
        self._limits = (
            settings.length_jump,
            settings.tension_error,
            1.0 - math.exp(-period / settings.innovation_s),
        )
        self._astray_ticks = round(settings.tension_error_s / period)
        self._jumped = np.zeros(robot.cables, dtype=np.int64)
        self._astray = np.zeros(robot.cables, dtype=np.int64)
        self.drift = np.zeros(robot.cables)
        """m (n,), mean innovation of each length"""
        self._stray = np.zeros(robot.cables)
        self._stray_ticks = round(settings.innovation_descent_s / period)
        self._strayed, self._straying = 0, -1
        self._last, self._then = np.full(robot.cables, np.nan), np.zeros(robot.cables)
        self._same = np.zeros(robot.cables, dtype=np.int64)
        self._loaded = np.zeros(robot.cables, dtype=bool)
        self._overwound = np.zeros(robot.cables, dtype=bool)

    def reset(self) -> None:
        self._jumped[:] = self._astray[:] = self._same[:] = self._misled[:] = 0
        for each in (*self._observed, self._torques, self._travel, self.drift, self._stray):
            each[:] = 0.0
        self._overwound[:] = False
        self._past[1][:] = np.nan

    def step(
        self, innovation: Array, reference: Array, filtered: Array, watched: NDArray[np.bool_]
    ) -> None:
        """From innovations (n,) in m, tension references and filtered tensions (n,) in N, of the
        cables that are ``watched`` (n,)."""
        _count(
            innovation,
            (reference, filtered),
            watched,
            self._limits,
            self._jumped,
            self._astray,
            self.drift,
        )

    def drums(
        self,
        angle: Array,
        rate: Array,
        commanded: Array,
        tension: Array,
        following: Array,
        watched: NDArray[np.bool_],
        interval: Array,
    ) -> None:
        """From drum angles and rates (n,), the last tick's torques (n,) N m, tensions (n,), what
        the platform's motion shortens each cable by, (n,) m/s, and the s that each rate is the mean
        of (n,)."""
        acted = self._torques[-1].copy()
        self._torques[1:] = self._torques[:-1].copy()
        self._torques[0] = commanded
        _turn(
            (angle, rate, acted),
            tension,
            following,
            watched,
            interval,
            self._drives,
            self._turning,
            self._observed,
            self._misled,
            self._past,
            self._travel,
        )

    def descend(self) -> None:
        """A descent begins: the estimate is loosened, and what was learnt before it is void."""
        self._stray[:] = 0.0
        self._strayed = 0

    def lengths(self, innovation: Array, believed: NDArray[np.bool_]) -> None:
        """From innovations (n,) m of a descent, and whose lengths corrected the estimate (n,)."""
        told = believed & np.isfinite(innovation)
        self._stray[told] += self._limits[2] * (innovation[told] - self._stray[told])
        stray = np.abs(self._stray)
        cable, limit = int(stray.argmax()), self._settings.innovation_descent
        second = np.partition(stray, -2)[-2]
        wrong = stray[cable] > max(limit, self._settings.prominence * second)
        self._strayed = self._strayed + 1 if wrong and cable == self._straying else int(wrong)
        self._straying = cable

    @property
    def misread(self) -> int:
        """The cable whose length is wrong in a descent, or -1."""
        return self._straying if self._strayed >= self._stray_ticks else -1

    def reeled(self, distance: Array, length: Array, slack: NDArray[np.bool_]) -> None:
        """From the distances (n,) m between a cable's anchors as the pose has them, and the lengths
        (n,) m that the drums have left it; of cables that are ``slack`` (n,)."""
        self._overwound[:] = slack & (distance - length > self._settings.overwound)

    def cells(self, raw: Array, age: NDArray[np.uint16], tension: Array, reference: Array) -> None:
        """From raw readings and ages of the cells, tensions and their references (n,): a cell
        without load, or whose load should not change, may well repeat itself."""
        self._loaded[:] = tension > self._taut
        _repeat(
            raw,
            age,
            reference,
            self._settings.frozen_change,
            self._loaded,
            self._last,
            self._then,
            self._same,
        )

    def found(self, tension: Array) -> tuple[Fault, int]:
        """The first fault there is, and its cable or cell; ``tension`` (n,) N, unfiltered, tells a
        cable that does not pull any more from one whose length is wrong."""
        fault, place = self._contradiction(tension)
        if fault in _BY_LENGTH:
            stuck = int(np.abs(self._travel).argmax())
            if abs(self._travel[stuck]) > self._settings.travel:
                return Fault.DRUM_STUCK, stuck
        return fault, place

    def disobedient(self, *, descending: bool) -> tuple[Fault, int]:
        """The first drum whose motion does not match its torque, independent of the estimate. While
        ``descending`` drums work at their limits, where losses are least certain; then a slack
        cable may be torn, and a cell frozen."""
        s = self._settings
        if descending and self._overwound.any():
            return Fault.CABLE_TORN, int(self._overwound.argmax())
        if descending and (self._same >= s.frozen_ticks).any():
            return Fault.CELL_FROZEN, int((self._same >= s.frozen_ticks).argmax())
        if (self._misled >= (s.torque_descent_ticks if descending else s.torque_ticks)).any():
            return Fault.DRUM_TORQUE, int(self._misled.argmax())
        return Fault.NONE, -1

    def _contradiction(self, tension: Array) -> tuple[Fault, int]:
        s = self._settings
        jumped = self._jumped >= s.jump_ticks
        if jumped.any():
            cable = int(jumped.argmax())
            torn = tension[cable] < self._taut
            return (Fault.CABLE_TORN if torn else Fault.LENGTH_JUMP), cable
        if (self._astray >= self._astray_ticks).any():
            return Fault.TENSION_ERROR, int(self._astray.argmax())
        if (self._jumped > 0).any():
            return Fault.NONE, -1  # a jump moves the mean too, and is named by itself
        drift = np.abs(self.drift)
        largest = drift.max()
        if largest > s.innovation:
            second = np.partition(drift, -2)[-2]
            if largest > s.prominence * second:
                return Fault.LENGTH_DRIFT, int(drift.argmax())
            if largest > s.length_jump:
                return Fault.LENGTH_DRIFT, -1
        if (self._same >= s.frozen_ticks).any():
            return Fault.CELL_FROZEN, int((self._same >= s.frozen_ticks).argmax())
        return Fault.NONE, -1
