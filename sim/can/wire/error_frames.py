"""What a host's controller reports, laid out as Linux SocketCAN does (linux/can/error.h)."""

from __future__ import annotations

from enum import IntEnum

from tonus.sim.can.wire.confinement import PASSIVE, WARNING, Counters, ErrorState
from tonus.sim.can.wire.frame import ERROR, Frame

CONTROLLER = 0x004
PROTOCOL = 0x008
ACKNOWLEDGE = 0x020
BUS_OFF = 0x040
BUS_ERROR = 0x080
RESTARTED = 0x100
COUNTERS = 0x200
"""Classes, the identifier's bits."""

_RECEIVE_WARNING, _TRANSMIT_WARNING = 0x04, 0x08
_RECEIVE_PASSIVE, _TRANSMIT_PASSIVE, _ACTIVE = 0x10, 0x20, 0x40
_TRANSMITTING = 0x80
_ACKNOWLEDGE_SLOT = 0x19
_LENGTH = 8
_LARGEST = 0xFF


class Violation(IntEnum):
    """Kinds of protocol violation (byte 2)."""

    BIT = 0x01
    STUFF = 0x04
    UNACKNOWLEDGED = 0x00


def report(
    counters: Counters,
    stamp_ns: int,
    before: ErrorState,
    violation: Violation | None = None,
    *,
    transmitting: bool = False,
) -> Frame:
    """One error frame: a violation on the wire, the change of state since ``before``, or both."""
    kind = COUNTERS
    controller = protocol = place = 0
    if violation is not None:
        kind |= BUS_ERROR
        if violation is Violation.UNACKNOWLEDGED:
            kind |= ACKNOWLEDGE
            place = _ACKNOWLEDGE_SLOT
        else:
            kind |= PROTOCOL
            protocol = violation
        if transmitting:
            protocol |= _TRANSMITTING
    now = counters.state
    if now is not before:
        if now is ErrorState.OFF:
            kind |= BUS_OFF
        else:
            kind |= CONTROLLER | (RESTARTED if before is ErrorState.OFF else 0)
            controller = _controller(counters)
    data = bytes(
        (
            0,
            controller,
            protocol,
            place,
            0,
            0,
            min(counters.transmit, _LARGEST),
            min(counters.receive, _LARGEST),
        )
    )
    frame = Frame(ERROR | kind, data, _LENGTH, 0)
    frame.stamp_ns = stamp_ns
    frame.sender = None
    return frame


def _controller(counters: Counters) -> int:
    transmit, receive = counters.transmit, counters.receive
    if counters.passive:
        return (_TRANSMIT_PASSIVE if transmit >= PASSIVE else 0) | (
            _RECEIVE_PASSIVE if receive >= PASSIVE else 0
        )
    warned = (_TRANSMIT_WARNING if transmit >= WARNING else 0) | (
        _RECEIVE_WARNING if receive >= WARNING else 0
    )
    return warned or _ACTIVE


def state(identifier: int, data: bytes, before: ErrorState) -> ErrorState:
    """The controller's state after an error frame."""
    if identifier & BUS_OFF:
        return ErrorState.OFF
    if not identifier & CONTROLLER:
        return before
    if data[1] & (_TRANSMIT_PASSIVE | _RECEIVE_PASSIVE):
        return ErrorState.PASSIVE
    if data[1] & (_TRANSMIT_WARNING | _RECEIVE_WARNING):
        return ErrorState.WARNING
    return ErrorState.ACTIVE
