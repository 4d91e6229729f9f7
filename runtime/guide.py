"""The reference the platform follows through a run: off the cradle to home, along the scenario at a
rate that HOLD and the envelope may slow to nothing, and back down after a stop. Nothing jumps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from config.schema.control import Sequence
from config.schema.robot import Robot
from config.schema.scenario import Reference
from runtime.reference import Move, Sample, trajectory
from runtime.states import State

Array = NDArray[np.float64]


class Guide:
    """Desired position, velocity and acceleration of each tick."""

    def __init__(
        self, robot: Robot, sequence: Sequence, reference: Reference, period: float
    ) -> None:
        self._sequence, self._period = sequence, period
        self._slew = sequence.reference_slew * period
        self._trajectory = trajectory(reference)
        self._home, self._rest = np.array(robot.home), np.array(robot.rest)
        self._still = np.zeros(3)
        self.start(self._rest)

    def start(self, position: Array) -> None:
        """From a referenced pose, ready to lift."""
        self._move = Move(position, self._home, self._sequence.lift_s)
        self._on_scenario = False
        self._lowering = False
        self._rate = 0.0
        self.time = 0.0
        """s of scenario time"""
        self.desired: Sample = (position, self._still, self._still)

    def __call__(self, state: State, elapsed: float, progress: float) -> Sample:
        """``elapsed``: s in this state. ``progress``: rate the envelope allows, 0 to 1."""
        sequence = self._sequence
        if state is State.PRETENSION:
            self.desired = self._move(elapsed - sequence.pretension_s)
        elif state is State.SAFE_STOP and elapsed >= sequence.stop_s:
            if not self._lowering:
                self._lowering = True
                self._move = Move(self.desired[0], self._rest, sequence.lower_s)
            self.desired = self._move(elapsed - sequence.stop_s)
        elif state in (State.HOLD, State.ACTIVE) or self._on_scenario:
            self._on_scenario = True
            self.desired = self._along(progress if state is State.ACTIVE else 0.0)
        else:
            self.desired = (self.desired[0], self._still, self._still)
        return self.desired

    def _along(self, wanted: float) -> Sample:
        before = self._rate
        rate = min(max(wanted, before - self._slew), before + self._slew)
        self._rate = rate
        self.time += rate * self._period
        offset, velocity, acceleration = self._trajectory(self.time)
        bend = (rate - before) / self._period
        return (
            self._home + offset,
            rate * velocity,
            rate * rate * acceleration + bend * velocity,
        )
