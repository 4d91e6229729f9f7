"""The trajectory player: the reference from the cradle to home, along the scenario with a time
scaling that HOLD and the envelope may reduce to zero, and back down after a stop. The reference is
continuous: a scenario selected in HOLD begins with the motion to home."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.control import Sequence
from tonus.config.schema.robot import Robot
from tonus.config.schema.safety import Envelope
from tonus.config.schema.scenario import Reference
from tonus.runtime.control.compiled import angular_velocity, rotate
from tonus.runtime.control.controllers.base import LEVEL
from tonus.runtime.control.reference import Move, Sample, trajectory
from tonus.runtime.states import State

Array = NDArray[np.float64]
_ORIGIN = np.zeros(3)
LEVEL_STILL: Sample = (np.zeros(3), np.zeros(3), np.zeros(3))
LEVEL_MOVE = Move(np.zeros(3), np.zeros(3), 1.0)
# Looked up once: a member of an enumeration takes ten times as long as a name (Python 3.11).
_PRETENSION = State.PRETENSION
_SAFE_STOP = State.SAFE_STOP
_ACTIVE = State.ACTIVE


@njit(cache=True)
def _pace(origin: Array, sample: Sample, rate: float, bend: float, paced: Array) -> None:
    offset, velocity, acceleration = sample
    for i in range(3):
        paced[0, i] = origin[i] + offset[i]
        paced[1, i] = rate * velocity[i]
        paced[2, i] = rate * rate * acceleration[i] + bend * velocity[i]


def _paced(origin: Array, sample: Sample, rate: float, bend: float) -> Sample:
    """``sample``, relative to ``origin`` (3,), of a time that passes at ``rate`` and whose rate
    changes by ``bend`` (1/s)."""
    paced = np.empty((3, 3))
    _pace(origin, sample, rate, bend, paced)
    return paced[0], paced[1], paced[2]


class Guide:
    """Desired position, velocity and acceleration of each tick."""

    def __init__(
        self,
        robot: Robot,
        sequence: Sequence,
        envelope: Envelope,
        reference: Reference,
        period: float,
        others: Iterable[Reference] = (),
    ) -> None:
        """``others`` can be chosen instead of ``reference``, by their numbers from 1 on."""
        self._sequence, self._period = sequence, period
        self._slew = sequence.reference_slew * period
        self._cruise = envelope.speed_limit * envelope.speed_warning
        self._trajectories = tuple(trajectory(each) for each in (reference, *others))
        self.chosen = 0
        """number of the scenario in force"""
        self._home, self._rest = np.array(robot.home), np.array(robot.rest)
        self.start(self._rest)

    def start(self, position: Array) -> None:
        """From a referenced pose, ready to lift."""
        self._move = Move(position, self._home, self._sequence.lift_s)
        self._move_time = 0.0
        self._on_scenario = self._lowering = self._returning = False
        self._rate = 0.0
        self.time = 0.0
        """s of scenario time"""
        self.desired: Sample = (position, np.zeros(3), np.zeros(3))
        self.turning: Sample = LEVEL_STILL
        """rotation vector from level (rad, base frame), its rate and acceleration"""
        self._turn = LEVEL_MOVE
        self.push = np.zeros(3)
        """N, desired contact force of the scenario"""

    @property
    def attitude(self) -> tuple[Array, Array]:
        """Desired orientation (4,), w x y z, and angular velocity (3,), rad/s."""
        if self.turning is LEVEL_STILL:
            return LEVEL, _ORIGIN
        vector, rate, _ = self.turning
        return rotate(LEVEL, vector), angular_velocity(vector, rate)

    @property
    def standing(self) -> bool:
        """The reference is at rest."""
        return self._rate == 0.0

    def select(self, number: int) -> None:
        """Play scenario ``number`` from its beginning, next time; while the reference stands. From
        elsewhere than home the way there comes first, no faster than a stop's."""
        if not 0 <= number < len(self._trajectories):
            return
        self.chosen = number
        if not (self._on_scenario or self._returning):
            return
        here = self.desired[0]
        distance = float(np.linalg.norm(here - self._home))
        self._move = Move(
            here, self._home, max(self._sequence.lift_s, 1.875 * distance / self._cruise)
        )
        self._turn = self._to_level(self._move.duration)
        self._move_time, self.time = 0.0, 0.0
        self._on_scenario = False
        self._returning = distance > 0.0 or self._turn is not LEVEL_MOVE
        self.push = np.zeros(3)

    def plan_stop(self) -> float:
        """How long lowering to the cradle will take (s): from far away long enough for the
        minimum-jerk peak, 15/8 of the mean speed, to stay under the speed where amber begins."""
        slowing = self._cruise * self._sequence.stop_s
        distance = float(np.linalg.norm(self.desired[0] - self._rest)) + slowing
        self._lower_s = max(self._sequence.lower_s, 1.875 * distance / self._cruise)
        return self._lower_s

    def __call__(self, state: State, elapsed: float, progress: float) -> Sample:
        """``elapsed``: s in this state. ``progress``: rate the envelope allows, 0 to 1."""
        if state is _PRETENSION:
            lifting = elapsed >= self._sequence.pretension_s
            self.desired = self._follow(1.0 if lifting else 0.0)
        elif state is _SAFE_STOP:
            self.desired = self._stop(elapsed)
            self.push = np.zeros(3)
        else:
            if self._returning:
                self._returning = self._move_time < self._move.duration
            elif not self._on_scenario:
                self._on_scenario, self._rate = True, 0.0
            self.desired = self._follow(progress if state is _ACTIVE else 0.0)
        return self.desired

    def _stop(self, elapsed: float) -> Sample:
        """To standstill along the way the platform is on, then straight down to the cradle."""
        # Where the stop waits this is zero but for rounding errors, which have either sign.
        since = elapsed - self._sequence.stop_s
        if since < 0.0 and not self._lowering:
            return self._follow(0.0)
        since = max(since, 0.0)
        if not self._lowering:
            self._lowering = True
            self._move = Move(self.desired[0], self._rest, self._lower_s)
            self._turn = self._to_level(self._lower_s)
        if self._turn is not LEVEL_MOVE:
            self.turning = self._turn(since)
        return self._move(since)

    def _to_level(self, duration: float) -> Move:
        """A turn from the present orientation."""
        here = self.turning[0]
        return Move(here, _ORIGIN, duration) if here.any() else LEVEL_MOVE

    def _follow(self, wanted: float) -> Sample:
        """The lift or the scenario at a rate that changes no faster than the slew allows."""
        before = self._rate
        rate = self._rate = min(max(wanted, before - self._slew), before + self._slew)
        if self._on_scenario:
            self.time += rate * self._period
            played = self._trajectories[self.chosen]
            origin, sample = self._home, played(self.time)
            self.push = played.push(self.time)
            turn = played.rotation(self.time) if played.turns else LEVEL_STILL
        else:
            self._move_time += rate * self._period
            origin, sample = _ORIGIN, self._move(self._move_time)
            level = self._turn is LEVEL_MOVE
            turn = LEVEL_STILL if level else self._turn(self._move_time)
        bend = (rate - before) / self._period
        still = turn is LEVEL_STILL
        self.turning = turn if still else _paced(_ORIGIN, turn, rate, bend)
        paced: Sample = _paced(origin, sample, rate, bend)
        return paced
