"""The application layer's states (ETG.1000.6): what a request leads to, as a pure function."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple


class State(IntEnum):
    """As the AL status register has it."""

    INIT = 1
    PRE_OP = 2
    BOOT = 3
    SAFE_OP = 4
    OP = 8


ACKNOWLEDGE = 0x10
ERROR = 0x10
NO_ERROR = 0x0000
INVALID_CHANGE = 0x0011
UNKNOWN_STATE = 0x0012
NO_BOOT = 0x0013
MAILBOX_WRONG = 0x0016
WATCHDOG = 0x001B
OUTPUTS_WRONG = 0x001D
INPUTS_WRONG = 0x001E
SYNC_LOST = 0x002C
NO_SYNC = 0x002D
SYNC_WRONG = 0x0030
_UP = {State.INIT: State.PRE_OP, State.PRE_OP: State.SAFE_OP, State.SAFE_OP: State.OP}


class Facts(NamedTuple):
    """What the slave finds of what the master has set up."""

    mailbox: bool
    outputs: bool
    inputs: bool
    sync: bool
    """distributed clocks are not used, or SYNC0 is configured"""


class Standing(NamedTuple):
    """State, error flag and AL status code."""

    state: State
    error: bool
    code: int

    @property
    def word(self) -> int:
        """The AL status register."""
        return self.state | (ERROR if self.error else 0)


def next_standing(now: Standing, request: int, facts: Facts) -> Standing:
    """Where a write of ``request`` to AL control leads."""
    acknowledged = bool(request & ACKNOWLEDGE)
    number = request & 0x0F
    if number not in State._value2member_map_:
        return _refused(now, UNKNOWN_STATE)
    wanted = State(number)
    if now.error and not acknowledged and wanted >= now.state:
        return now  # nothing is heard of this before the error is acknowledged
    if wanted is State.BOOT:
        return _refused(now, NO_BOOT)
    if wanted <= now.state:
        return Standing(wanted, False, NO_ERROR)
    if _UP.get(now.state) is not wanted:
        return _refused(now, INVALID_CHANGE)
    code = _obstacle(wanted, facts)
    return _refused(now, code) if code else Standing(wanted, False, NO_ERROR)


def _refused(now: Standing, code: int) -> Standing:
    return Standing(now.state, True, code)


def _obstacle(wanted: State, facts: Facts) -> int:
    """AL status code of what stands against a step up."""
    if not facts.mailbox:
        return MAILBOX_WRONG
    if wanted is State.PRE_OP:
        return NO_ERROR
    if not facts.outputs:
        return OUTPUTS_WRONG
    if not facts.inputs:
        return INPUTS_WRONG
    return NO_ERROR if facts.sync else SYNC_WRONG
