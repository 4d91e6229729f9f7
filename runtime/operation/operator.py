"""Who tells the cycle what to do: at most one command a tick."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Protocol

from tonus.config.schema.scenario import Command
from tonus.runtime.control.tuning import NO_CHANGE, GainChange
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.states import ARMED, Operator, State


class Commander(Protocol):
    """Asked once a tick, before it."""

    @property
    def who(self) -> str:
        """Who gave the last command; empty for the program itself."""
        ...

    @property
    def select(self) -> int:
        """Number plus one of the scenario that the last command came with, 0 for none."""
        ...

    @property
    def change(self) -> GainChange:
        """Of a tunable parameter, that the last command came with."""
        ...

    def next(self, sequence: Sequence) -> Operator: ...

    def refused(self, reason: str) -> None:
        """The last command, to arm, was not passed on."""

    @property
    def finished(self) -> bool: ...

    @property
    def interrupted(self) -> bool:
        """A stop was requested."""
        ...

    @property
    def urgent(self) -> bool:
        """Something waits for the next tick that must not wait for a bus being brought up."""
        ...

    @property
    def obstacle(self) -> str:
        """Why nothing was played at all; empty if something was."""
        ...

    def stop(self, who: str = "") -> None:
        """A controlled stop and the end, please; asked a second time, at once."""


class _Stoppable:
    """Ends when asked to: once in a controlled way, twice at once."""

    def __init__(self) -> None:
        self._asked = 0
        self._over = False
        self.who = ""
        self.select = 0
        self.change = NO_CHANGE
        self.obstacle = ""

    @property
    def finished(self) -> bool:
        return self._over

    @property
    def interrupted(self) -> bool:
        return self._asked > 0

    @property
    def urgent(self) -> bool:
        return self._asked > 0

    def stop(self, who: str = "") -> None:
        self._asked += 1
        self.who = who

    def _obey(self, state: State) -> Operator:
        if state not in ARMED:
            self._over = True
            return Operator.NONE
        if self._asked > 1:
            return Operator.ESTOP
        return Operator.STOP if state is not State.SAFE_STOP else Operator.NONE


class Script(_Stoppable):
    """Arms, starts, lets the scenario run for its duration, stops. Ends in STANDBY or FAULT.

    `stop` and `estop` may be asked for from outside; the rest is the script's. Commands of the
    scenario come first: until the last of them is given the script only arms.
    """

    def __init__(
        self,
        duration: float,
        patience_s: float = 0.0,
        commands: Iterable[Command] = (),
        period: float = 1e-3,
    ) -> None:
        """``patience_s``: how long it waits in STANDBY for a self-test that is good. ``period``: s
        between two calls of `next`."""
        super().__init__()
        self._duration, self._patience_s = duration, patience_s
        self._period, self._ticks = period, 0
        self._commands: deque[Command] = deque()
        self.follow(commands)
        self._armed = False
        self._waited = 0.0

    def next(self, sequence: Sequence) -> Operator:
        state = sequence.state
        resting = state in (State.STANDBY, State.FAULT)
        if state is State.FAULT or (resting and (self._armed or self._asked)):
            self._over = True
            return Operator.NONE
        if self._asked:
            return self._obey(state)
        if state is State.STANDBY:
            self._armed, self._waited, self._ticks = True, sequence.elapsed, 0
            return Operator.ARM
        self._ticks += 1
        if self._commands:
            return self._commanded()
        if state is State.HOLD and sequence.elapsed > 0.0:
            return Operator.START
        if state is State.ACTIVE and sequence.elapsed >= self._duration:
            return Operator.STOP
        return Operator.NONE

    def follow(self, commands: Iterable[Command]) -> None:
        """Give these commands in place of those left; what was due before now is left out."""
        self._commands = deque(each for each in commands if self._due(each) > self._ticks)

    def last(self, duration: float) -> None:
        """Let the scenario run for ``duration`` s in ACTIVE."""
        self._duration = duration

    @property
    def armed_for(self) -> int:
        """Ticks since arming."""
        return self._ticks

    def _due(self, command: Command) -> int:
        """Ticks after arming."""
        return max(round(command.at / self._period), 1)

    def _commanded(self) -> Operator:
        if self._due(self._commands[0]) > self._ticks:
            return Operator.NONE
        return Operator[self._commands.popleft().command.upper()]

    def refused(self, reason: str) -> None:
        self._armed = False
        if self._waited >= self._patience_s:
            self.obstacle, self._over = reason, True

    def remaining(self, sequence: Sequence) -> float:
        """s left in ACTIVE."""
        if sequence.state is not State.ACTIVE:
            return self._duration
        return max(0.0, self._duration - sequence.elapsed)


class Console(_Stoppable):
    """What people say through the control socket: `give` a command, the next tick takes it. Where
    nobody says anything a script may."""

    def __init__(self, script: Script | None = None) -> None:
        super().__init__()
        self.script = script
        self.refusal = ""
        """why the last command was not passed on"""
        self._given: tuple[Operator, int, GainChange, str] | None = None
        self._halted = False

    @property
    def interrupted(self) -> bool:
        return self._asked > 0 or self._halted

    @property
    def urgent(self) -> bool:
        stopping = self._given is not None and self._given[0] is Operator.ESTOP
        return stopping or super().urgent

    @property
    def ending(self) -> bool:
        """A signal asked for the daemon's end."""
        return self._asked > 0

    @property
    def pending(self) -> bool:
        """A command waits for the next tick."""
        return self._given is not None

    def give(
        self, operator: Operator, who: str, select: int = 0, change: GainChange = NO_CHANGE
    ) -> None:
        """Take the place of whatever was given and not yet taken, except an emergency stop's."""
        if self._given is None or self._given[0] is not Operator.ESTOP:
            self._given = operator, select, change, who
            self.refusal = ""
            self._halted |= operator is Operator.STOP

    def next(self, sequence: Sequence) -> Operator:
        self.select, self.change = 0, NO_CHANGE
        given, self._given = self._given, None
        if given is not None and (given[0] is Operator.ESTOP or not self._asked):
            operator, self.select, self.change, self.who = given
            return operator
        if self._asked:
            return self._obey(sequence.state)
        self.who = ""
        if self.script is None:
            return Operator.NONE
        operator = self.script.next(sequence)
        self._over = self.script.finished
        return operator

    def refused(self, reason: str) -> None:
        self.refusal = reason
        if self.script is not None:
            self.script.refused(reason)
            self.obstacle, self._over = self.script.obstacle, self.script.finished
