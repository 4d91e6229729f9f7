"""What missed ticks lead to: they are skipped, the platform holds, or it stops."""

from __future__ import annotations

from tonus.config.schema.realtime import RealTime
from tonus.runtime.states import ARMED, Operator, State

_YIELDING = (Operator.NONE, Operator.START, Operator.HOLD)
"""what the operator may have said that a policy takes the place of"""


class Overruns:
    """Applies the configured policy; its answer reaches the cycle as an operator's command does,
    so a replay knows of it."""

    def __init__(self, settings: RealTime) -> None:
        self._policy, self._least = settings.overrun, settings.overrun_ticks
        self.stopped = False
        """the policy has stopped the robot, and nobody has armed it since"""

    def answer(self, skipped: int, state: State, command: Operator) -> Operator:
        """The command of this tick, ``skipped`` ticks after the last one."""
        if command is Operator.ARM:
            self.stopped = False
        if skipped < self._least or command not in _YIELDING:
            return command
        if self._policy == "stop" and state in ARMED and state is not State.SAFE_STOP:
            self.stopped = True
            return Operator.STOP
        if self._policy == "hold" and state is State.ACTIVE:
            return Operator.HOLD
        return command
