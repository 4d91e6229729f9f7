"""The drive state machine of CiA 402 (IEC 61800-7-201): states, commands, transitions.

Only the logic: what a drive does with its power stage is behind `Actions`.
"""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import Protocol


class State(IntEnum):
    """A state's value is its pattern in the statusword (mask 0x6F)."""

    NOT_READY = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


class Command(Enum):
    SHUTDOWN = "shutdown"
    SWITCH_ON = "switch on"
    ENABLE = "enable operation"
    DISABLE_VOLTAGE = "disable voltage"
    QUICK_STOP = "quick stop"


FAULT_RESET_BIT = 0x80


def command(controlword: int) -> Command:
    """What bits 0 to 3 ask for. Bit 7 acts by its edge and is not looked at here."""
    if not controlword & 0x02:
        return Command.DISABLE_VOLTAGE
    if not controlword & 0x04:
        return Command.QUICK_STOP
    if not controlword & 0x01:
        return Command.SHUTDOWN
    return Command.ENABLE if controlword & 0x08 else Command.SWITCH_ON


class Actions(Protocol):
    """What the transitions do. A ramp that is asked for ends with a call of the machine."""

    def power(self, on: bool) -> None: ...

    def ramp_down(self, then: State) -> None:
        """Brake and report with `Machine.ramp_ended`; in quick stop stay braked afterwards."""

    def resettable(self) -> bool:
        """Whether no cause of a fault remains."""

    def fault_cleared(self) -> None: ...

    def may_enable(self) -> bool:
        """Whether nothing at the terminals forbids it; a drive may fault instead."""

    def shutdown_ramp(self) -> bool:
        """0x605B: brake before the power goes."""

    def disable_ramp(self) -> bool:
        """0x605C: the same for disable operation."""

    def quick_stop_option(self) -> int:
        """0x605A: 0 power off; 1 to 4 brake, then power off; 5 to 8 brake and stay."""


_S, _C = State, Command
_DIRECT: dict[tuple[State, Command], State] = {
    (_S.SWITCH_ON_DISABLED, _C.SHUTDOWN): _S.READY,  # 2
    (_S.READY, _C.SWITCH_ON): _S.SWITCHED_ON,  # 3
    (_S.READY, _C.ENABLE): _S.OPERATION_ENABLED,  # 3 and 4 in one
    (_S.SWITCHED_ON, _C.ENABLE): _S.OPERATION_ENABLED,  # 4
    (_S.SWITCHED_ON, _C.SHUTDOWN): _S.READY,  # 6
    (_S.READY, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 7
    (_S.READY, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 7
    (_S.OPERATION_ENABLED, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 9
    (_S.SWITCHED_ON, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 10
    (_S.SWITCHED_ON, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 10
    (_S.OPERATION_ENABLED, _C.QUICK_STOP): _S.QUICK_STOP_ACTIVE,  # 11
    (_S.QUICK_STOP_ACTIVE, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 12
    (_S.QUICK_STOP_ACTIVE, _C.ENABLE): _S.OPERATION_ENABLED,  # 16
}
_BRAKED: dict[tuple[State, Command], State] = {
    (_S.OPERATION_ENABLED, _C.SWITCH_ON): _S.SWITCHED_ON,  # 5
    (_S.OPERATION_ENABLED, _C.SHUTDOWN): _S.READY,  # 8
}
_CUT, _STAYS = 0, 5
"""Options of 0x605A."""
POWERED = frozenset({_S.OPERATION_ENABLED, _S.QUICK_STOP_ACTIVE, _S.FAULT_REACTION_ACTIVE})
"""States in which the power stage may be on."""


class Machine:
    """One drive's state. ``state`` is read by all, written here."""

    def __init__(self, actions: Actions) -> None:
        self._actions = actions
        self.state = State.NOT_READY
        self._braking: State | None = None  # the state that a ramp leads to
        self._reset_bit = True  # a bit that is set from the start is no edge

    def start(self) -> None:
        """Transitions 0 and 1, after switch-on or reset."""
        self._braking = None
        self._reset_bit = True
        self._actions.power(False)
        self.state = State.SWITCH_ON_DISABLED

    def controlword(self, word: int) -> None:
        """Evaluate a controlword; it is a level, so the same word again is no new command."""
        reset = bool(word & FAULT_RESET_BIT)
        edge = reset and not self._reset_bit
        self._reset_bit = reset
        if self.state is State.FAULT:
            if edge and self._actions.resettable():
                self.state = State.SWITCH_ON_DISABLED  # 15
                self._actions.fault_cleared()
            return
        if reset or self.state in (State.FAULT_REACTION_ACTIVE, State.NOT_READY):
            return
        self.obey(command(word))

    def obey(self, wanted: Command) -> None:
        """A command of the controlword, or of an input with the same meaning."""
        key = (self.state, wanted)
        if self._braking is not None and wanted is not Command.DISABLE_VOLTAGE:
            # While it brakes for transition 5 or 8, only taking the power or stopping is heard.
            if wanted is not Command.QUICK_STOP:
                return
            self._braking = None
        if key in _BRAKED:
            how = self._actions
            ramp = how.shutdown_ramp() if wanted is Command.SHUTDOWN else how.disable_ramp()
            if ramp:
                self._braking = _BRAKED[key]
                self._actions.ramp_down(_BRAKED[key])
            else:
                self._enter(_BRAKED[key])
        elif key in _DIRECT:
            if _DIRECT[key] is State.OPERATION_ENABLED and not self._actions.may_enable():
                return
            self._braking = None
            cut = wanted is Command.QUICK_STOP and self._actions.quick_stop_option() == _CUT
            self._enter(State.SWITCH_ON_DISABLED if cut else _DIRECT[key])

    def _enter(self, state: State) -> None:
        self.state = state
        if state is State.OPERATION_ENABLED:
            self._actions.power(True)
        elif state is State.QUICK_STOP_ACTIVE:
            self._actions.ramp_down(state)
        elif state not in POWERED:
            self._actions.power(False)

    def ramp_ended(self) -> None:
        """The drive stands still, or did not within its time."""
        if self.state is State.FAULT_REACTION_ACTIVE:
            self.state = State.FAULT  # 14
            self._actions.power(False)
        elif self._braking is not None:
            state, self._braking = self._braking, None
            self._enter(state)
        elif self.state is State.QUICK_STOP_ACTIVE and self._actions.quick_stop_option() < _STAYS:
            self._enter(State.SWITCH_ON_DISABLED)  # 12

    def fault(self, *, ramp: bool) -> None:
        """Transition 13; ``ramp`` if the drive may brake before its power goes."""
        if self.state in (State.FAULT, State.NOT_READY):
            self.state = State.FAULT
            return
        self._braking = None
        powered = self.state in POWERED
        self.state = State.FAULT_REACTION_ACTIVE
        if ramp and powered:
            self._actions.ramp_down(State.FAULT)
        else:
            self.state = State.FAULT
            self._actions.power(False)
