"""Which cable contradicts the others: torn, slack, slipped, jammed, or measured wrongly.

Residuals of each cable; they are small for an intact cable:

- *jump*: its length, elongation included, leaves in one tick what the estimate predicts of it. A
  torn cable's elongation vanishes with its tension; a slip on the drum or of the encoder moves its
  length. The others' innovations stay within their noise, since a platform has mass.
- *tension error*: its tension does not follow its reference: drum jammed, friction, motor weak or
  reversed, or a cell of wrong gain.
- *torque*: its drum's motion does not match torque and tension (`drum_observer`). A drum that
  speeds up or stops in one tick faster than any torque allows has jammed, or its encoder has
  slipped.
- *travel*: its drum does not turn although the platform's motion would turn it. Friction may cause
  that for some millimetres, so it only identifies the cable when lengths contradict each other.
- *drift*: its innovation has a mean: an error grows slowly, and the fault is that of the cable
  whose mean stands out. If none does, the cables contradict each other, and no cable is named.
  What a changing elongation may be wrong by does not count, as long as its cable's compliance is
  not known: at the start of PRETENSION it is known to a seventh, of 2 mm; in HOLD to 0.3 %.

In a descent any length may be wrong by some millimetres, and the estimate has an offset for each. A
cable whose mean offset has changed by more than `innovation_descent` for long and stands out has a
wrong length. That is reported only: its cell still measures its tension.

In a descent a slack cable's drum reels in towards the platform: if it has reeled in more than the
distance to the platform, the cable is torn. A load cell whose reading repeats to the last bit while
its reference moves is frozen; so is, in a descent, one whose reading stays within its noise while
its reference moves far, or the drum of a drive that has failed turns far under such a load.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.robot import Robot
from tonus.config.schema.safety import Isolation as Settings
from tonus.config.schema.safety import Stop
from tonus.runtime.safety.drum_observer import DrumObserver
from tonus.runtime.safety.given_up_drums import GivenUpDrums
from tonus.runtime.states import Fault, StopMode

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
_BY_LENGTH = (Fault.LENGTH_JUMP, Fault.LENGTH_DRIFT)


@njit(cache=True)
def _count(
    innovation: Array,
    doubt: Array,
    reference: Array,
    filtered: Array,
    watched: NDArray[np.bool_],
    limits: tuple[float, float, float, float],
    jumped: Counts,
    astray: Counts,
    drift: Array,
) -> None:
    """``limits``: jump (m), tension error (N), share of a tick in the mean innovation, and how many
    of its ``doubt`` an innovation may have. One that is not a number (no sample) counts for
    nothing."""
    jump, error, share, sigmas = limits
    for i in range(innovation.shape[0]):
        if not watched[i]:
            jumped[i] = astray[i] = 0
            drift[i] = 0.0
            continue
        if math.isfinite(innovation[i]):
            jumped[i] = jumped[i] + 1 if abs(innovation[i]) > jump else 0
            known = max(0.0, abs(innovation[i]) - sigmas * doubt[i])
            drift[i] += share * (math.copysign(min(known, 2.0 * jump), innovation[i]) - drift[i])
        off = abs(reference[i] - filtered[i]) > error
        astray[i] = astray[i] + 1 if off else 0


@njit(cache=True)
def _repeat(
    raw: Array,
    age: NDArray[np.uint16],
    tension: Array,
    reference: Array,
    limits: tuple[float, float],
    loaded: float,
    last: Array,
    then: Array,
    same: Counts,
) -> None:
    """``loaded``: tension of a cable with a load (N). ``then``: the tension references when the
    readings last changed by more than a band; a reading counts as repeated once its reference has
    moved far enough from there. ``limits``: band and change of the reference, N."""
    band, change = limits
    for i in range(reference.shape[0]):
        if age[i] != 0:
            continue
        if not abs(raw[i] - last[i]) <= band or not tension[i] > loaded:
            last[i], then[i], same[i] = raw[i], reference[i], 0
        elif abs(reference[i] - then[i]) > change:
            same[i] += 1


@njit(cache=True)
def _quiet(
    jumped: Counts, astray: Counts, drift: Array, same: Counts, limits: tuple[int, float, int]
) -> bool:
    """Whether no residual of the lengths and cells can be a fault: `limits` of astray ticks, mean
    innovation (m) and repeated readings."""
    for i in range(jumped.shape[0]):
        if jumped[i] > 0 or astray[i] >= limits[0] or not abs(drift[i]) <= limits[1]:
            return False
        if same[i] >= limits[2]:
            return False
    return True


# The rows of what is kept of the residuals, and of their counts.
_DRIFT, _LAST, _THEN, _LEVEL, _ASKED = range(5)
_JUMPED, _ASTRAY, _SAME, _STILL, _REPEATED = range(5)


@njit(cache=True)
def _residuals(
    innovation: Array,
    doubt: Array,
    reference: Array,
    filtered: Array,
    watched: NDArray[np.bool_],
    raw: Array,
    age: NDArray[np.uint16],
    tension: Array,
    kept: Array,
    counts: Counts,
    limits: Array,
    ticks: Counts,
) -> bool:
    """All of a tick; returns whether no residual can be a fault. ``limits``: jump (m), tension
    error (N), share of a tick in the mean innovation, doubts that an innovation may have; tension
    of a cable with a load, frozen change, band and step (N); mean innovation (m). ``ticks``: how
    many may be astray, and repeated."""
    jumped, astray, drift = counts[_JUMPED], counts[_ASTRAY], kept[_DRIFT]
    same, still = counts[_SAME], counts[_STILL]
    taut, change, band, step = limits[4], limits[5], limits[6], limits[7]
    allowed = (limits[0], limits[1], limits[2], limits[3])
    _count(innovation, doubt, reference, filtered, watched, allowed, jumped, astray, drift)
    _repeat(raw, age, tension, reference, (0.0, change), taut, kept[_LAST], kept[_THEN], same)
    _repeat(raw, age, tension, reference, (band, step), taut, kept[_LEVEL], kept[_ASKED], still)
    for i in range(same.shape[0]):
        counts[_REPEATED, i] = max(same[i], still[i])
    return _quiet(jumped, astray, drift, same, (ticks[0], limits[8], ticks[1]))


def _turned(robot: Robot, settings: Settings) -> Array:
    """s (n,) in which the smallest unexplained force turns a drum that is at rest, and free, by two
    increments of its encoder."""
    trains = robot.drive_trains
    turn = [2.0 * math.pi / (t.motor.increments_per_revolution * t.gearbox.ratio) for t in trains]
    way = 2.0 * robot.drum_radius * np.array(turn)
    return np.asarray(np.sqrt(2.0 * way * robot.drum_mass / settings.torque_error))


class Isolation:
    """One tick of residuals; `found` is the first fault they show, and where."""

    def __init__(self, robot: Robot, settings: Settings, stop: Stop, period: float) -> None:
        self._settings, self._taut = settings, stop.taut_tension
        self.drums = DrumObserver(robot, settings)
        self.given_up = GivenUpDrums(robot, settings)
        self._stuck_ticks = np.maximum(_turned(robot, settings) / period, settings.torque_ticks)
        """(n,) in which a drum that stands all the time has contradicted its torque for certain"""
        self._share = 1.0 - math.exp(-period / settings.innovation_s)
        self._astray_ticks = round(settings.tension_error_s / period)
        kept, counts = np.zeros((5, robot.cables)), np.zeros((5, robot.cables), np.int64)
        kept[_LAST] = kept[_LEVEL] = np.nan
        errors = (settings.length_jump, settings.tension_error)
        frozen = (settings.frozen_change, settings.frozen_band, settings.frozen_step)
        doubt = (self._share, settings.elongation_doubt, stop.taut_tension)
        self._kept = (
            kept,
            counts,
            np.array([*errors, *doubt, *frozen, settings.innovation]),
            np.array([self._astray_ticks, settings.frozen_ticks]),
        )
        self._counts = counts
        self._jumped, self._astray, self._same, _, self._repeated = counts
        """ticks (n,); repeated in a descent: a cell is frozen whether its noise is, too, or not"""
        self.drift = kept[_DRIFT]
        """m (n,), mean innovation of each length"""
        self._stray = np.zeros(robot.cables)
        self._stray_ticks = round(settings.innovation_descent_s / period)
        self._strayed, self._straying = 0, -1
        self._overwound = np.zeros(robot.cables, dtype=bool)
        self._radius = robot.drum_radius
        self._shown, self._wound = np.full(robot.cables, np.nan), np.zeros(robot.cables)
        self._unmoved = np.zeros(robot.cables, dtype=bool)
        """(n,) cables whose reading has stayed, though the drum of a failed drive has turned"""
        self._stood = np.zeros(robot.cables, dtype=bool)
        self._stood_at = np.full(robot.cables, np.nan)
        """rad (n,), of drums that were named while they stood against their torque"""
        self._quiet = True
        """no residual of the lengths and cells can be a fault"""

    def reset(self) -> None:
        self._counts[:] = 0
        self.drift[:] = self._stray[:] = 0.0
        self._overwound[:] = self._unmoved[:] = False
        self._stood[:] = False
        self._shown[:] = self._stood_at[:] = np.nan
        self._quiet = True
        self.drums.reset()
        self.given_up.reset()

    def step(
        self,
        innovation: Array,
        doubt: Array,
        reference: Array,
        filtered: Array,
        watched: NDArray[np.bool_],
        raw: Array,
        age: NDArray[np.uint16],
        tension: Array,
    ) -> None:
        """From innovations (n,) in m and the ``doubt`` (n,) m of their elongations, tension
        references and filtered tensions (n,) in N, of the cables that are ``watched`` (n,); and raw
        readings and ages of the cells (n + 1,) with the tensions (n,) made of them: a cell without
        load, or whose load should not change, may well repeat itself."""
        self._quiet = _residuals(
            innovation, doubt, reference, filtered, watched, raw, age, tension, *self._kept
        )

    def descend(self) -> None:
        """A descent begins: the estimate is loosened, and what was learnt before it is void."""
        self._stray[:] = 0.0
        self._strayed = 0

    def lengths(self, stray: Array, believed: NDArray[np.bool_]) -> None:
        """From what lengths have become wrong by (n,) m in a descent, and whose lengths corrected
        the estimate (n,)."""
        self._stray[believed] += self._share * (stray[believed] - self._stray[believed])
        mean = np.abs(self._stray)
        cable, limit = int(mean.argmax()), self._settings.innovation_descent
        second = np.sort(mean)[-2]
        wrong = mean[cable] > max(limit, self._settings.prominence * second)
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

    def unwound(
        self,
        raw: Array,
        age: NDArray[np.uint16],
        tension: Array,
        angle: Array,
        held: NDArray[np.bool_],
    ) -> None:
        """From readings (n,) and ages (n,) of cells, the tensions (n,) N made of them and the
        drums' angles (n,) rad; of cables that are ``held`` (n,) by a drive that has failed. It may
        hold one drum still under a load, or turn without it, but does not pay out at one force."""
        s = self._settings
        loaded = held & (tension > s.torque_error)
        same = loaded & (np.abs(raw - self._shown) <= s.frozen_band)
        moved = ~same & (age == 0)
        self._shown[moved], self._wound[moved] = raw[moved], angle[moved]
        way = np.abs(angle - self._wound) * self._radius
        self._unmoved[:] = same & (way > s.frozen_travel)

    def freed(self, angle: Array) -> NDArray[np.bool_]:
        """Drums (n,) that stood when they were named, and have turned since; from all drums' angles
        (n,) rad."""
        new = self._stood & np.isnan(self._stood_at)
        self._stood_at[new] = angle[new]
        way = np.abs(angle - self._stood_at) * self._radius
        return np.asarray(way > self._settings.freed_travel)

    def found(self, tension: Array) -> tuple[Fault, int]:
        """The first fault there is, and its cable or cell; ``tension`` (n,) N, unfiltered, tells a
        cable that does not pull any more from one whose length is wrong."""
        if self._quiet:
            return Fault.NONE, -1
        fault, place = self._contradiction(tension)
        if fault in _BY_LENGTH:
            stuck = int(np.abs(self.drums.travel).argmax())
            stands = abs(self.drums.travel[stuck]) > self._settings.travel
            if stands and self._explains(stuck, place):
                return Fault.DRUM_STUCK, stuck
        return fault, place

    def _explains(self, stuck: int, place: int) -> bool:
        """Whether a drum that stands can be why the length at ``place`` (-1: nowhere) is wrong.
        One that friction holds for a moment, while its cable gives way, is not: its length is
        right."""
        drift = np.abs(self.drift)
        return place < 0 or bool(self._settings.prominence * drift[stuck] >= drift[place])

    def disobedient(self, mode: StopMode, failed: NDArray[np.bool_]) -> tuple[Fault, int]:
        """The first drum whose motion does not match its torque, independent of the estimate. In a
        stop that leaves the path (``mode``) drums work at their limits, where losses are least
        certain, and slack cables snap taut; but no such drum stands to the last increment. In a
        descent a slack cable may be torn, and a cell
        frozen: of those that have not ``failed`` (n,), since each is named once and would hide the
        next."""
        s = self._settings
        rough = mode > StopMode.ON_PATH
        if mode is StopMode.DESCENT:
            if self._overwound.any():
                return Fault.CABLE_TORN, int(self._overwound.argmax())
            frozen = (self._repeated >= s.frozen_ticks) & ~failed | self._unmoved
            if frozen.any():
                return Fault.CELL_FROZEN, int(frozen.argmax())
        drums, given_up = self.drums, self.given_up.disobedient
        if given_up >= 0:
            return Fault.DRUM_TORQUE, given_up
        if drums.most_misled < s.torque_ticks:
            return Fault.NONE, -1
        stuck = np.minimum(drums.misled, drums.standing) >= self._stuck_ticks
        self._stood |= stuck
        if rough and stuck.any():
            return Fault.DRUM_TORQUE, int(stuck.argmax())
        if rough and drums.most_misled < s.torque_descent_ticks:
            return Fault.NONE, -1
        return Fault.DRUM_TORQUE, int(drums.misled.argmax())

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
            second = np.sort(drift)[-2]
            if largest > s.prominence * second:
                return Fault.LENGTH_DRIFT, int(drift.argmax())
            if largest > s.length_jump:
                return Fault.LENGTH_DRIFT, -1
        if (self._same >= s.frozen_ticks).any():
            return Fault.CELL_FROZEN, int((self._same >= s.frozen_ticks).argmax())
        return Fault.NONE, -1
