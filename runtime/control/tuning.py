"""Gains of the stiffness law that are changed while the robot runs: a change is an input of the
tick in which it comes, and the gain goes to it at a bounded rate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from tonus.config.schema.operation import Tunable
from tonus.runtime.control.stiffness import GAINS, Law
from tonus.runtime.states import State

STATES = frozenset({State.STANDBY, State.HOLD, State.ACTIVE})
"""in which a change is accepted"""
_ROUNDING = 1e-9
"""relative, by which a step may seem too large"""


class GainChange(NamedTuple):
    """What a tick is told to tune."""

    number: int = 0
    """of the parameter in ``operation.tunable``, plus 1; 0 for no change"""
    value: float = 0.0


NO_CHANGE = GainChange()


class Tuning:
    """Takes changes of ``tunable`` parameters and moves the gains of ``law`` there; with None, a
    controller without a law, it takes none."""

    def __init__(self, tunable: Sequence[Tunable], law: Law | None, period: float) -> None:
        """``period``: s, of a tick."""
        self.keys: list[str] = [each.key for each in tunable]
        self._places = [GAINS.index(key.rpartition(".")[2]) for key in self.keys]
        self._ends = [(each.minimum, each.maximum) for each in tunable]
        self._largest = [each.step for each in tunable]
        self._rates = [each.rate for each in tunable]
        self._law, self._period = law, period
        self.gains = [0.0] * len(GAINS) if law is None else law.gains
        """those in force, in the order of `GAINS`"""
        self.targets = [self.gains[place] for place in self._places]
        """where each parameter goes to"""
        self.before = 0.0
        """value of the parameter changed last, when that change came"""
        self._moving = False

    def value(self, index: int) -> float:
        """A parameter in force."""
        return self.gains[self._places[index]]

    def against(self, change: GainChange, state: State) -> tuple[str, str]:
        """What stands against a change in a state, and what to do instead; empty for nothing. The
        change may have any number and any value."""
        if not 1 <= change.number <= len(self.keys):
            return "it is not in operation.tunable", f"choose one of {', '.join(self.keys)}"
        if self._law is None:
            return "the controller has no stiffness law", "start the daemon with one that has"
        if state not in STATES:
            return f"not while in {state.name}", "it may be changed in STANDBY, HOLD and ACTIVE"
        index, value = change.number - 1, change.value
        low, high = self._ends[index]
        if not low <= value <= high:  # also when it is not a number
            return f"{value:g} is outside {low:g} to {high:g}", "choose a value between them"
        now, largest = min(max(self.value(index), low), high), self._largest[index]
        if abs(value - now) > largest * (1.0 + _ROUNDING):
            return f"{value:g} is more than {largest:g} from {now:g}", "go there in smaller steps"
        return "", ""

    def ask(self, change: GainChange, state: State) -> None:
        """Accept a change, unless something stands against it."""
        if self.against(change, state)[0]:
            return
        index = change.number - 1
        self.before = self.value(index)
        self.targets[index] = change.value
        self._moving = True

    def accepted(self, change: GainChange) -> bool:
        """Whether the parameter goes to this value."""
        return 1 <= change.number <= len(self.keys) and (
            self.targets[change.number - 1] == change.value
        )

    def left(self, index: int) -> float:
        """s until a parameter has its value."""
        return abs(self.targets[index] - self.value(index)) / self._rates[index]

    def step(self) -> None:
        """One tick."""
        if not self._moving:
            return
        self._moving = False
        for place, target, rate in zip(self._places, self.targets, self._rates, strict=True):
            most, now = rate * self._period, self.gains[place]
            self.gains[place] = min(max(target, now - most), now + most)
            self._moving |= self.gains[place] != target
