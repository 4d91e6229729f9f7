"""Where the platform is, how fast it moves, and what pushes it.

Two sources that fail differently: the cables (each tick, precise, but wrong by what calibration
missed) and the optical tracker (its own rate and latency, coarse, but right). One error-state
extended Kalman filter holds both, 18 + 2n states: pose, twist, external wrench, and the constants
of calibration, an offset of each cable's length and the excess of its compliance over the nominal
one. The orientation is a quaternion; only its error, a rotation vector in the base frame,
has a covariance. Predict and correct are filterpy's algebra, compiled
(`tonus.runtime.control.compiled`) and held against filterpy by test.

- The measured cable wrench drives the prediction as an accelerometer would, so that velocity needs
  no differentiation; what it leaves unexplained is the external wrench.
- The lengths correct each tick, one after the other, a cable without a measurement left out.
- A tracker pose is compared with what the cables said at its exposure. In that difference the pose
  itself cancels and only constants of calibration are left, so that its age matters neither to the
  result nor to the cost.

While the tracker is silent the offsets drift, and the covariance says by how much.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.control import Control
from tonus.config.schema.control import Estimator as Settings
from tonus.config.schema.robot import Robot
from tonus.config.schema.tracker import Tracker
from tonus.runtime.control.compiled import (
    AXIAL_STIFFNESS,
    DOUBT,
    EXTERNAL,
    INNOVATION,
    OFFSETS,
    POSE,
    PUBLISHED,
    PUSH,
    STRETCH,
    TURNING,
    TWIST,
    VELOCITY,
    carry_forward,
    elongation,
    error_size,
    estimate_tick,
    rotate,
    track,
)
from tonus.runtime.control.disagreement import Disagreement
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.wrench import rotation_between
from tonus.runtime.signals import Consistency

Array = NDArray[np.float64]
_FIT_ITERATIONS = 2
"""Enough for what a platform does in a tick."""
_CONDITION_TICKS = 8
"""The condition number, which changes as slowly as the pose, is computed once in so many ticks."""


@dataclass
class Estimate:
    """The platform at the present tick, base frame."""

    position: Array
    quaternion: Array
    velocity: Array
    angular_velocity: Array
    external: Array
    """(6,) force and moment that the cables and gravity do not explain"""


@dataclass(frozen=True)
class Doubts:
    """When a length is not believed, and what is less certain once the estimate is loosened."""

    slack: float = 0.0
    """N below which a cable has no length to tell"""
    jump: float = math.inf
    """m of innovation beyond which a length is left out"""
    unrest: float = 1.0
    """process noise, in times the usual one"""
    length_sigma: float = 1.0e-3
    """m"""
    offset_sigma: float = 0.0
    """m by which any length may be wrong from then on"""
    offset_drift: float = 0.0
    """m per sqrt(s) by which that changes"""
    leap: float = math.inf
    """m/s by which the tracker may move faster than the estimate, else it was moved itself"""
    load_unrest: float = 1.0
    """drift of the load from outside, in times the usual one"""

    @classmethod
    def of(cls, control: Control) -> Doubts:
        """As configured."""
        stop, jump = control.stop, control.isolation.length_jump
        lengths = (stop.length_sigma, stop.offset_sigma, stop.offset_drift)
        loose = (stop.unrest, *lengths, stop.tracker_leap, stop.load_unrest)
        return cls(stop.taut_tension, jump, *loose)


def _noise(
    settings: Settings,
    period: float,
    errors: int,
    offset_drift: float,
    doubts: Doubts | None = None,
) -> Array:
    """Variances (``errors``,) that a tick adds to the error state; ``offset_drift``: m per sqrt(s);
    ``doubts``: by how much more the accelerations and a load's force change than usually."""
    unrest, load_unrest = (doubts.unrest, doubts.load_unrest) if doubts else (1.0, 1.0)
    density = np.zeros(errors)
    density[TWIST : TWIST + 3] = settings.acceleration_sigma * unrest
    density[TWIST + 3 : EXTERNAL] = settings.angular_acceleration_sigma * unrest
    density[EXTERNAL : EXTERNAL + 3] = settings.force_drift * load_unrest
    density[EXTERNAL + 3 : OFFSETS] = settings.moment_drift
    density[OFFSETS : (OFFSETS + errors) // 2] = offset_drift
    return np.asarray(density**2 * period)


class PoseEstimator:
    """Fuses cable lengths and tensions with tracker poses. The inputs of a tick are of one sampling
    instant, a period ago; the estimate is carried forward to the present."""

    def __init__(
        self,
        robot: Robot,
        settings: Settings,
        tracker: Tracker,
        kinematics: Kinematics,
        period: float,
        doubts: Doubts | None = None,
    ) -> None:
        doubts = doubts or Doubts()
        self._settings, self._period = settings, period
        self._tracker_period = 1.0 / tracker.rate_hz
        self._kinematics, self._cables = kinematics, Kinematics(robot.geometry)
        self._seen = Kinematics(robot.geometry)
        inertia = np.array(robot.platform.inertia)
        body = robot.platform
        self._body = (body.mass, inertia, robot.gravity, robot.axial_stiffness)
        anchors = np.stack([kinematics.frame, kinematics.platform])
        self._anchor_table, self._anchors = anchors, (anchors[0], anchors[1])
        self._moment_length = robot.geometry.moment_length
        cables, errors = robot.cables, error_size(robot.cables)
        length, share = settings.length_sigma**2, period / settings.elongation_time
        creep = settings.compliance_drift**2 * period
        self._excesses = OFFSETS + cables
        """where the offsets end in the error state, and the excesses of compliance begin"""
        usual = _noise(settings, period, errors, settings.offset_drift)
        fixed = (body.mass, robot.gravity, period)
        self._usual = (
            usual,
            np.array([*fixed, length, share, creep, doubts.slack, doubts.jump]),
        )
        """what a tick adds to the variances, and the numbers of `estimate_tick`"""
        self._restless = (
            _noise(settings, period, errors, doubts.offset_drift, doubts),
            np.array([*fixed, doubts.length_sigma**2, share, creep, doubts.slack, math.inf]),
        )
        self._mode = self._usual
        self._variances = (
            tracker.position_sigma**2,
            tracker.rotation_sigma**2,
            settings.length_sigma**2,
        )
        state = np.zeros(errors + 1)
        state[3] = 1.0
        self._nominal = state
        """position, quaternion and rest in one"""
        self._position, self._quaternion, self._rest = state[:3], state[3:POSE], state[POSE:]
        """twist, external wrench, offsets, excesses: the error state without the pose"""
        self.covariance = np.zeros((errors, errors))
        """(errors, errors) of the error state, at the sampling instant"""
        self._rows = kept = np.zeros((4, cables))
        kept[AXIAL_STIFFNESS] = robot.axial_stiffness
        self._stretch = kept[STRETCH]
        """m, mean elongations"""
        self._state = (
            self._position,
            self._quaternion,
            self._rest,
            self.covariance,
            self._stretch,
        )
        depth = math.ceil(tracker.maximum_age_ms * 1e-3 / period) + 2
        self._past, self._past_poses = np.zeros((2, depth, cables)), np.zeros((depth, POSE))
        self._past_usable = np.zeros((depth, cables), dtype=bool)
        self._count = 0
        self._tensions = np.zeros(cables)
        self._innovation = np.zeros(cables)
        self.innovations = kept[INNOVATION]
        """m, of this tick's lengths before they corrected anything; not a number where none was"""
        self.doubts = kept[DOUBT]
        """m, how uncertain the part of them is that comes from a changing elongation"""
        self.believed = np.zeros(cables, dtype=bool)
        """whose lengths corrected the estimate in this tick"""
        self.cable_position, self._cable_quaternion = np.zeros(3), self._quaternion.copy()
        """as solved from the lengths alone, with nothing calibrated"""
        self.residual = 0.0
        """m, RMS disagreement of the lengths with that pose"""
        self.inconsistency = 1.0
        """mean squared innovation of the lengths in their own sigmas, smoothed; about 1"""
        self._odd = False
        self.condition = 1.0
        """of the structure matrix"""
        self.disagreement = Disagreement(settings, tracker)
        self._leap, self._offset_variance = doubts.leap, doubts.offset_sigma**2
        self._offsets_before = np.zeros(cables)
        self._apart, self._moved = np.zeros(3), np.zeros(3)
        """m (3,): of the last pose from the loose estimate, and by how much the tracker is moved"""
        self._seen_at = 0
        whole = self._whole = np.zeros(PUBLISHED)
        whole[:POSE] = state[:POSE]
        self._published = (whole[:3], whole[3:POSE], whole[VELOCITY:TURNING], whole[TURNING:PUSH])
        self.estimate = Estimate(*self._published, whole[PUSH:])
        self._kept = (
            state,
            self.covariance,
            inertia,
            anchors,
            kinematics.lengths,
            kinematics.matrix,
            kept,
            self.believed,
            whole,
            self._past,
            self._past_poses,
            self._past_usable,
        )

        self.found = (
            *self._published,
            self.estimate.external,
            self.cable_position,
            self._position,
            self._rest[OFFSETS - TWIST :],
        )
        """the arrays that are recorded: the estimate; the position by the cables alone, and that of
        the sampling instant; offsets and excesses"""

    @property
    def bias(self) -> Array:
        """(3,) m, what the cables' position is wrong by."""
        return self.cable_position - self._position

    @property
    def offsets(self) -> Array:
        """(n,) m, to be added to the cables' lengths."""
        return self._rest[OFFSETS - TWIST : self._excesses - TWIST]

    @property
    def strays(self) -> Array:
        """(n,) m, what the lengths have become wrong by since the estimate was loosened."""
        return self.offsets - self._offsets_before

    @property
    def compliances(self) -> Array:
        """(n,) of each cable, over its nominal one."""
        return 1.0 + self._rest[self._excesses - TWIST :]

    @property
    def compliance(self) -> float:
        """of the cables, over the nominal one: their mean."""
        return float(self.compliances.mean())

    @property
    def sigma(self) -> float:
        """m, standard deviation of the position along its worst axis."""
        item = self.covariance.item
        return math.sqrt(max(0.0, item(0, 0), item(1, 1), item(2, 2)))

    @property
    def consistency(self) -> Consistency:
        """Whether what is measured fits together."""
        settings = self._settings
        if not self.condition <= settings.condition_limit:
            return Consistency.SINGULAR
        if self._odd:
            return Consistency.CABLES
        return Consistency.TRACKER if self.disagreement.lasting else Consistency.GOOD

    def start(self, position: Array, quaternion: Array, tensions: Array, samples: int) -> None:
        """Begin at rest at a referenced pose, the mean of ``samples`` tracker poses, under
        ``tensions`` (n,): whatever else holds the platform is the first external load."""
        mass, _, gravity, stiffness = self._body
        kinematics = self._kinematics
        kinematics.evaluate(position, quaternion)
        self._position[:], self._quaternion[:] = position, quaternion
        self.cable_position[:], self._cable_quaternion[:] = position, quaternion
        self._rest[:] = 0.0
        external = self._rest[EXTERNAL - TWIST : OFFSETS - TWIST]
        external[:] = -kinematics.matrix @ tensions
        external[2] += mass * gravity
        for i, cable in enumerate(zip(kinematics.lengths, tensions, stiffness, strict=True)):
            self._stretch[i] = elongation(*cable)
        self._tensions[:] = tensions
        self._begin(samples)
        self._count = 0
        self._mode = self._usual
        self.inconsistency, self._odd = 1.0, False
        self.disagreement.reset()
        self._publish()

    def _begin(self, samples: int) -> None:
        """Covariance after a reference: what was wrong in the pose, and in the elongation taken out
        of the lengths, is wrong in the offsets, the other way round."""
        covariance, settings, stretch = self.covariance, self._settings, self._stretch
        offsets = slice(OFFSETS, self._excesses)
        excesses = slice(self._excesses, len(covariance))
        position, rotation, length = self._variances
        pose = np.diag([position] * 3 + [rotation] * 3) / samples
        # What all cables have in common, and what each has by itself. The lengths of six cables fit
        # a pose whatever they are: there each one's own would only make them doubtful.
        spread = settings.compliance_spread if len(stretch) > TWIST else 0.0
        loose = spread**2 * np.eye(len(stretch)) + settings.compliance_sigma**2
        shift = -self._kinematics.matrix.T
        covariance[:] = 0.0
        covariance[:TWIST, :TWIST] = pose
        speed = settings.start_speed_sigma
        turning = speed / self._moment_length
        covariance[TWIST:EXTERNAL, TWIST:EXTERNAL] = np.diag([speed**2] * 3 + [turning**2] * 3)
        covariance[offsets, :TWIST] = shift @ pose
        covariance[:TWIST, offsets] = pose @ shift.T
        covariance[offsets, offsets] = shift @ pose @ shift.T + loose * np.outer(stretch, stretch)
        covariance[offsets, offsets] += length * np.eye(len(stretch))
        covariance[excesses, offsets] = -loose * stretch
        covariance[offsets, excesses] = covariance[excesses, offsets].T
        covariance[excesses, excesses] = loose

    def loosen(self) -> None:
        """From now on cables are gone and others go slack: the platform may move as it could not
        before, too few lengths may say where it is, and the tracker corrects the pose itself. Each
        length may be wrong by millimetres, but those hardly change: taken for noise of every tick
        they would leave it to the tracker to tell the velocity, late."""
        self._mode = self._restless
        self._offsets_before[:] = self.offsets
        offsets = range(OFFSETS, self._excesses)
        self.covariance[offsets, offsets] += self._offset_variance
        self._moved[:] = self.disagreement.shift[:3] if self.disagreement.poses else 0.0
        if self.disagreement.distance <= self._leap * self._tracker_period:
            self._moved[:] = 0.0
        self._apart[:], self._seen_at = self._moved, self._count

    @property
    def _loose(self) -> bool:
        return self._mode is self._restless

    def step(
        self, lengths: Array, tensions: Array, elastic: Array, usable: NDArray[np.bool_]
    ) -> Estimate:
        """One tick: `advance`, then `solve_cables`."""
        estimate = self.advance(lengths, tensions, elastic, usable)
        self.solve_cables(lengths)
        return estimate

    def advance(
        self, lengths: Array, tensions: Array, elastic: Array, usable: NDArray[np.bool_]
    ) -> Estimate:
        """The estimate from measured cable lengths (n,), nominal elongation included, tensions
        (n,), and the part ``elastic`` (n,) of them that stretches the cables. A cable that is not
        ``usable``, slack or far off says nothing about the pose."""
        settings = self._settings
        self._tensions[:] = tensions
        squared = estimate_tick(
            *self._kept,
            *self._mode,
            lengths,
            tensions,
            elastic,
            usable,
            self._count,
        )
        share = self._period / settings.consistency_time
        self.inconsistency += share * (squared - self.inconsistency)
        # Half the limit, once beyond it: said once an episode.
        limit = settings.consistency_limit * (0.5 if self._odd else 1.0)
        self._odd = not self.inconsistency <= limit
        self._count += 1
        return self.estimate

    def solve_cables(self, lengths: Array, *, recorded: bool = True) -> None:
        """The pose from the ``lengths`` (n,) alone, for the tick that `advance` has just been
        called for. It is recorded and watched, and nothing is controlled by it: the drives need not
        wait for it. Where it is not ``recorded``, only in the ticks in which it is watched."""
        watched = (self._count - 1) % _CONDITION_TICKS == 0
        if not (recorded or watched):
            return
        self.residual = self._cables.fit(
            lengths,
            self.believed,
            self.cable_position,
            self._cable_quaternion,
            iterations=_FIT_ITERATIONS,
        )
        if watched:
            self.condition = self._cables.condition

    def track(self, position: Array, quaternion: Array, delay: float) -> bool:
        """Use a tracker pose taken ``delay`` s before this tick.

        Returns False, and changes no estimate, when the pose is too old or beyond the gate.
        """
        # What the cables say lags the tick by one period: the newest entry is that far back.
        back = delay / self._period - 1.0
        depth = len(self._past_poses)
        if not 0.0 <= back <= min(self._count, depth) - 2:
            return False
        whole = int(back)
        share = back - whole
        newer = (self._count - 1 - whole) % depth
        older = (newer - 1) % depth
        if self._loose:
            return self._correct(position, quaternion, share, newer, older)
        lengths, elastic = self._past
        then = (
            (1.0 - share) * lengths[newer] + share * lengths[older],
            (1.0 - share) * elastic[newer] + share * elastic[older],
            self._past_usable[newer] & self._past_usable[older],
        )
        seen, gate = self._seen, self._settings.gate
        chi_square = track(
            self._state,
            (position, quaternion),
            self._variances,
            then,
            self._anchors,
            self._body[3],
            gate,
            self._innovation,
            seen.matrix,
        )
        if chi_square <= gate:
            self.disagreement.end()
            self._publish()
            return True
        if math.isfinite(chi_square):
            self._doubt()
        return False

    def _correct(
        self, position: Array, quaternion: Array, share: float, newer: int, older: int
    ) -> bool:
        """What a tracker pose differs by from the estimate of its instant is what the present one
        is wrong by: a Kalman step on the pose (Larsen et al., CDC 1998, without their correction of
        the gain)."""
        places, turns = self._past_poses[:, :3], self._past_poses[:, 3:]
        then = (1.0 - share) * places[newer] + share * places[older]
        turn = rotation_between(turns[newer], turns[older])
        innovation = np.concatenate(
            [position - then, rotation_between(rotate(turns[newer], share * turn), quaternion)]
        )
        if not np.isfinite(innovation).all() or self._has_leapt(innovation[:3]):
            return False
        spread = self.covariance[:TWIST, :TWIST].copy()
        spread[range(TWIST), range(TWIST)] += [self._variances[0]] * 3 + [self._variances[1]] * 3
        gain = np.linalg.solve(spread, self.covariance[:TWIST]).T
        error = gain @ innovation
        self.covariance -= gain @ self.covariance[:TWIST]
        self.covariance[:] = 0.5 * (self.covariance + self.covariance.T)
        # The past moves with the present: what has been corrected must not be corrected again.
        places += error[:3]
        for slot in range(len(turns)):
            turns[slot] = rotate(turns[slot], error[3:TWIST])
        self._position += error[:3]
        self._quaternion[:] = rotate(self._quaternion, error[3:TWIST])
        self._rest += error[TWIST:]
        self._apart -= error[:3]
        self._publish()
        return True

    def _has_leapt(self, apart: Array) -> bool:
        """Whether a pose (3,) m ``apart`` from the loose estimate is of a tracker that was moved:
        from one pose to the next the difference changes by what the estimate's speed is wrong by,
        and not by centimetres. It is believed again once it has leapt back."""
        passed = max((self._count - self._seen_at) * self._period, self._tracker_period)
        step, limit = apart - self._apart, self._leap * passed
        if float(np.linalg.norm(step)) > limit:
            self._moved += step
            if float(np.linalg.norm(self._moved)) <= limit:
                self._moved[:] = 0.0
        self._apart[:], self._seen_at = apart, self._count
        return bool(self._moved.any())

    def _doubt(self) -> None:
        """A pose beyond the gate. Where many agree, the estimate follows them."""
        matrix, disagreement = self._seen.matrix, self.disagreement
        shift = np.linalg.solve(matrix @ matrix.T, -matrix @ self._innovation)
        disagreement.add(np.asarray(shift, dtype=np.float64))
        if disagreement.learnable:
            self._follow(disagreement.shift, disagreement.poses)
            disagreement.learn()

    def _follow(self, shift: Array, samples: int) -> None:
        """Reference the lengths again: the pose moves by ``shift`` (6,), the offsets so that every
        length tells what it told before, and both are as uncertain as ``samples`` poses leave them.

        To make them uncertain along the shift and leave the step to the next pose is not the same:
        the lengths come first, in every tick, and where they contradict each other, in directions
        in which no pose can move them, they drove the estimate along the only way that was open.
        """
        seen = self._seen
        seen.evaluate(self._position, self._quaternion)
        before = seen.lengths.copy()
        self._position += shift[:3]
        self._quaternion[:] = rotate(self._quaternion, shift[3:])
        seen.evaluate(self._position, self._quaternion)
        self.offsets[:] += seen.lengths - before
        position, rotation, _ = self._variances
        spread = np.vstack([np.eye(TWIST), -seen.matrix.T])
        spread *= np.sqrt(np.array([position] * 3 + [rotation] * 3) / samples)
        rows = np.r_[0:TWIST, OFFSETS : self._excesses]
        self.covariance[np.ix_(rows, rows)] += spread @ spread.T
        self._publish()

    def _publish(self) -> Estimate:
        """The estimate one period on."""
        estimate, kinematics = self.estimate, self._kinematics
        carry_forward(
            self._state,
            self._body,
            self._period,
            kinematics.matrix @ self._tensions,
            self._anchors,
            kinematics.lengths,
            kinematics.matrix,
            self._published,
        )
        estimate.external[:] = self._rest[EXTERNAL - TWIST : OFFSETS - TWIST]
        return estimate
