"""The daemon's state machine: one table, every (state, event) pair defined.

*Armed* means that drives are enabled: REFERENCING, PRETENSION, HOLD, ACTIVE and SAFE_STOP.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple


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
    CABLE_TORN = 16
    LENGTH_JUMP = 17
    TENSION_ERROR = 18
    LENGTH_DRIFT = 19
    CELL_FROZEN = 20
    CONTROL_FAILED = 21
    DRUM_TORQUE = 22
    DRUM_STUCK = 23
    RELAY_SILENT = 24
    SUPERVISOR_IGNORED = 25


class StopMode(IntEnum):
    """How a controlled stop is made; it only ever goes down this list."""

    NONE = 0
    ON_PATH = 1
    """along the path, then down to the cradle, as long as all that it relies on holds"""
    DESCENT = 2
    """with the cables that are left: weight, and damping of every motion"""
    PASSIVE = 3
    """each drum by itself: a little tension, and damping by its own rate"""


ARMED = frozenset({State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE, State.SAFE_STOP})

MEANING: dict[State, str] = {
    State.OFF: "the bus is brought up and the unloaded cells are zeroed",
    State.STANDBY: "drives are disabled; the robot may be armed",
    State.REFERENCING: "cables are tensioned lightly and their lengths referenced",
    State.PRETENSION: "tension grows and the platform rises from its cradle to home",
    State.HOLD: "the platform holds its place",
    State.ACTIVE: "the scenario plays",
    State.SAFE_STOP: "a controlled stop: to standstill, down to the cradle, tensions released",
    State.FAULT: "drives are disabled because of a fault",
}

NEXT: dict[State, str] = {
    State.OFF: "wait until it is in STANDBY",
    State.STANDBY: "arm it",
    State.REFERENCING: "wait until it is in HOLD, or stop it",
    State.PRETENSION: "wait until it is in HOLD, or stop it",
    State.HOLD: "start it, or stop it",
    State.ACTIVE: "hold it, or stop it",
    State.SAFE_STOP: "wait until it is in STANDBY or FAULT",
    State.FAULT: "correct the cause, then reset it",
}
"""What an operator may do, in words that follow on a refusal."""


class Move(NamedTuple):
    """Where an event leads, and why it may."""

    to: State
    reason: str


_ESTOP = Move(State.FAULT, "an emergency stop disables every drive in the same tick")
_RESTING = "the drives are disabled: there is nothing to stop"
_MOVING = "moving or under tension: to standstill and down, then disabled"
_MOVES: dict[State, dict[Event, Move]] = {
    State.OFF: {
        Event.TARED: Move(State.STANDBY, "every cell is zeroed, and its offset is small"),
        Event.FAULT: Move(State.FAULT, _RESTING),
        Event.ESTOP: _ESTOP,
    },
    State.STANDBY: {
        Event.ARM: Move(State.REFERENCING, "the self-test has passed and arming was requested"),
        Event.FAULT: Move(State.FAULT, _RESTING),
        Event.ESTOP: _ESTOP,
    },
    State.REFERENCING: {
        Event.REFERENCED: Move(
            State.PRETENSION, "no cable is slack, lengths are referenced: poses and tensions agree"
        ),
        Event.STOP: Move(
            State.SAFE_STOP, "the tensions are released evenly; nothing has moved yet"
        ),
        Event.FAULT: Move(
            State.SAFE_STOP, "the tensions are released evenly; nothing has moved yet"
        ),
        Event.ESTOP: _ESTOP,
    },
    State.PRETENSION: {
        Event.TENSIONED: Move(State.HOLD, "tensions are full and the platform is at home"),
        Event.STOP: Move(State.SAFE_STOP, _MOVING),
        Event.FAULT: Move(State.SAFE_STOP, _MOVING),
        Event.ESTOP: _ESTOP,
    },
    State.HOLD: {
        Event.START: Move(State.ACTIVE, "the scenario was requested"),
        Event.STOP: Move(State.SAFE_STOP, _MOVING),
        Event.FAULT: Move(State.SAFE_STOP, _MOVING),
        Event.ESTOP: _ESTOP,
    },
    State.ACTIVE: {
        Event.HOLD: Move(
            State.HOLD, "the scenario's time slows to zero; the platform holds its place"
        ),
        Event.STOP: Move(State.SAFE_STOP, _MOVING),
        Event.FAULT: Move(State.SAFE_STOP, _MOVING),
        Event.ESTOP: _ESTOP,
    },
    State.SAFE_STOP: {
        Event.STOPPED: Move(State.STANDBY, "every drive is disabled, and there was no fault"),
        Event.STOPPED_BY_FAULT: Move(State.FAULT, "every drive is disabled; the fault remains"),
        Event.ESTOP: _ESTOP,
    },
    State.FAULT: {
        Event.RESET: Move(State.STANDBY, "the operator confirms that the cause is corrected"),
    },
}

TRANSITIONS: dict[tuple[State, Event], State] = {
    (state, event): _MOVES[state][event].to if event in _MOVES[state] else state
    for state in State
    for event in Event
}
"""An event that is not allowed in a state leaves it unchanged."""

MOVES: dict[tuple[State, Event], Move] = {
    (state, event): move for state, moves in _MOVES.items() for event, move in moves.items()
}
"""The transitions that lead elsewhere, with their reasons."""


class Operator(IntEnum):
    """Commands of a person or of a script, at most one a tick."""

    NONE = 0
    ARM = Event.ARM
    START = Event.START
    HOLD = Event.HOLD
    STOP = Event.STOP
    ESTOP = Event.ESTOP
    RESET = Event.RESET
