"""The daemon's state machine: one table, every (state, event) pair defined.

*Armed* means that drives are enabled: REFERENCING, PRETENSION, HOLD, ACTIVE and SAFE_STOP.
"""

from __future__ import annotations

from enum import IntEnum


class State(IntEnum):
    OFF = 0
    STANDBY = 1
    REFERENCING = 2
    PRETENSION = 3
    HOLD = 4
    ACTIVE = 5
    SAFE_STOP = 6
    FAULT = 7


class Event(IntEnum):
    """What can happen, from the operator (first six) or from the cycle itself."""

    ARM = 1
    START = 2
    HOLD = 3
    STOP = 4
    ESTOP = 5
    RESET = 6
    TARED = 7
    """the cells are zeroed: the robot may be armed"""
    REFERENCED = 8
    TENSIONED = 9
    FAULT = 10
    STOPPED = 11
    """a controlled stop came to its end without a fault"""
    STOPPED_BY_FAULT = 12


class Fault(IntEnum):
    """Why the robot stopped; logged with the axis, cell or bound it concerns."""

    NONE = 0
    DRIVE_LOST = 1
    DRIVE_FAULT = 2
    CELL_LOST = 3
    CELL_BAD = 4
    ENABLE_TIMEOUT = 5
    REFERENCING_FAILED = 6
    CONTACT_LIMIT = 7
    SPEED_LIMIT = 8
    WORKSPACE_LIMIT = 9
    OVER_TENSION = 10
    SLACK_CABLE = 11
    EMERGENCY_STOP = 12
    NOT_FINITE = 13
    IMPLAUSIBLE_DRIVE = 14
    IMPLAUSIBLE_CELL = 15


ARMED = frozenset({State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE, State.SAFE_STOP})

_MOVES: dict[State, dict[Event, State]] = {
    State.OFF: {
        Event.TARED: State.STANDBY,
        Event.FAULT: State.FAULT,
        Event.ESTOP: State.FAULT,
    },
    State.STANDBY: {
        Event.ARM: State.REFERENCING,
        Event.FAULT: State.FAULT,
        Event.ESTOP: State.FAULT,
    },
    State.REFERENCING: {
        Event.REFERENCED: State.PRETENSION,
        Event.STOP: State.SAFE_STOP,
        Event.FAULT: State.SAFE_STOP,
        Event.ESTOP: State.FAULT,
    },
    State.PRETENSION: {
        Event.TENSIONED: State.HOLD,
        Event.STOP: State.SAFE_STOP,
        Event.FAULT: State.SAFE_STOP,
        Event.ESTOP: State.FAULT,
    },
    State.HOLD: {
        Event.START: State.ACTIVE,
        Event.STOP: State.SAFE_STOP,
        Event.FAULT: State.SAFE_STOP,
        Event.ESTOP: State.FAULT,
    },
    State.ACTIVE: {
        Event.HOLD: State.HOLD,
        Event.STOP: State.SAFE_STOP,
        Event.FAULT: State.SAFE_STOP,
        Event.ESTOP: State.FAULT,
    },
    State.SAFE_STOP: {
        Event.STOPPED: State.STANDBY,
        Event.STOPPED_BY_FAULT: State.FAULT,
        Event.ESTOP: State.FAULT,
    },
    State.FAULT: {
        Event.RESET: State.STANDBY,
    },
}

TRANSITIONS: dict[tuple[State, Event], State] = {
    (state, event): _MOVES[state].get(event, state) for state in State for event in Event
}
"""An event that means nothing in a state leaves it unchanged."""


class Operator(IntEnum):
    """Commands of a person or of a script, at most one a tick."""

    NONE = 0
    ARM = Event.ARM
    START = Event.START
    HOLD = Event.HOLD
    STOP = Event.STOP
    ESTOP = Event.ESTOP
    RESET = Event.RESET
