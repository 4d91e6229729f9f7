"""The state of a channel as its controller tells it: by error frames, or when it is asked."""

from __future__ import annotations

from enum import IntEnum

import can

from tonus.drivers.events import EventLog

# SocketCAN (linux/can/error.h): classes in the identifier, the controller's state in byte 1.
_CONTROLLER = 0x004
_BUS_OFF = 0x040
_RESTARTED = 0x100
_STATE_BYTE = 1
_OVERFLOW = 0x03
_PASSIVE = 0x30
_ACTIVE = 0x40
_CLASSES = (
    (0x001, "transmission timed out"),
    (0x002, "arbitration lost"),
    (0x008, "protocol violated"),
    (0x010, "transceiver fault"),
    (0x020, "no node acknowledged a frame"),
    (0x080, "error on the wire"),
)


class Condition(IntEnum):
    ACTIVE = 0
    PASSIVE = 1
    OFF = 2


_TOLD = {
    can.BusState.ACTIVE: Condition.ACTIVE,
    can.BusState.PASSIVE: Condition.PASSIVE,
    can.BusState.ERROR: Condition.OFF,
}


class Health:
    """One channel's condition; every change of it is an event."""

    def __init__(self, where: str, bus: can.BusABC, events: EventLog) -> None:
        self.condition = Condition.ACTIVE
        self._where = where
        self._bus = bus
        self._events = events
        self._mute = False
        # Interfaces without a state of their own inherit one that is always active.
        self._can_tell = type(bus).state is not can.BusABC.state

    def look(self) -> None:
        """Ask the controller, if it can tell."""
        if not self._can_tell:
            return
        try:
            told = self._bus.state
        except (can.CanError, OSError) as error:
            self._events.begin("bus_deaf", self._where, f"its state cannot be read: {error}")
            self._mute = True
            return
        if self._mute:
            self._mute = False
            self._events.end("bus_deaf", self._where)
        self._become(_TOLD[told])

    def error_frame(self, classes: int, data: bytes) -> None:
        """An error frame of the controller, ``classes`` being its identifier."""
        state = data[_STATE_BYTE] if classes & _CONTROLLER and len(data) > _STATE_BYTE else 0
        if classes & _BUS_OFF:
            self._become(Condition.OFF)
        elif classes & _RESTARTED or state & _ACTIVE:
            self._become(Condition.ACTIVE)
        elif state & _PASSIVE:
            self._become(Condition.PASSIVE)
        if state & _OVERFLOW:
            self._events.counted("bus_error", self._where, "a queue of the controller overflowed")
        words = [text for bit, text in _CLASSES if classes & bit]
        if words:
            self._events.counted("bus_error", self._where, ", ".join(words))

    def _become(self, condition: Condition) -> None:
        before, self.condition = self.condition, condition
        if condition is before:
            return
        if condition is Condition.OFF:
            text = "the controller left the bus after too many errors"
            self._events.counted("bus_off", self._where, text)
        elif condition is Condition.PASSIVE:
            text = "the controller counts 128 errors or more"
            self._events.counted("bus_passive", self._where, text)
        else:
            self._events.counted("bus_recovered", self._where, "the controller is error-active")
