"""Who tells the cycle what to do: at most one command a tick."""

from __future__ import annotations

from typing import Protocol

from runtime.sequence import Sequence
from runtime.states import ARMED, Operator, State


class Commander(Protocol):
    """Asked once a tick, before it."""

    def next(self, sequence: Sequence) -> Operator: ...

    @property
    def finished(self) -> bool: ...

    @property
    def interrupted(self) -> bool:
        """Somebody asked for a stop."""
        ...

    def stop(self) -> None:
        """A controlled stop, please; asked a second time, at once."""


class Script:
    """Arms, starts, lets the scenario run for its duration, stops. Ends in STANDBY or FAULT."""

    def __init__(self, duration: float) -> None:
        self._duration = duration
        self._armed = False
        self._asked = 0
        self._over = False

    @property
    def finished(self) -> bool:
        return self._over

    @property
    def interrupted(self) -> bool:
        return self._asked > 0

    def stop(self) -> None:
        self._asked += 1

    def next(self, sequence: Sequence) -> Operator:
        state = sequence.state
        resting = state in (State.STANDBY, State.FAULT)
        if state is State.FAULT or (resting and (self._armed or self._asked)):
            self._over = True
            return Operator.NONE
        if self._asked:
            return self._obey(state)
        if state is State.STANDBY:
            self._armed = True
            return Operator.ARM
        if state is State.HOLD and sequence.elapsed > 0.0:
            return Operator.START
        if state is State.ACTIVE and sequence.elapsed >= self._duration:
            return Operator.STOP
        return Operator.NONE

    def _obey(self, state: State) -> Operator:
        if state not in ARMED:
            self._over = True
            return Operator.NONE
        if self._asked > 1:
            return Operator.ESTOP
        return Operator.STOP if state is not State.SAFE_STOP else Operator.NONE

    def remaining(self, sequence: Sequence) -> float:
        """s left in ACTIVE."""
        if sequence.state is not State.ACTIVE:
            return self._duration
        return max(0.0, self._duration - sequence.elapsed)
