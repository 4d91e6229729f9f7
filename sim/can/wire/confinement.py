"""Error confinement of one controller: the counters of ISO 11898-1 and what they make of it."""

from __future__ import annotations

from enum import Enum

WARNING = 96
PASSIVE = 128
_OFF = 256
_TRANSMIT_STEP = 8
_AFTER_PASSIVE = 119
"""A success takes an error-passive receiver's counter to 119 to 127; the lowest is ours."""


class ErrorState(Enum):
    ACTIVE = "active"
    WARNING = "warning"
    """still active; a counter has reached 96"""
    PASSIVE = "passive"
    OFF = "bus_off"


class Counters:
    """Transmit and receive error counter. Bus-off is left by `recover` alone."""

    __slots__ = ("off", "receive", "transmit")

    def __init__(self) -> None:
        self.transmit = 0
        self.receive = 0
        self.off = False

    @property
    def clean(self) -> bool:
        return not (self.transmit or self.receive or self.off)

    @property
    def passive(self) -> bool:
        return self.transmit >= PASSIVE or self.receive >= PASSIVE

    @property
    def state(self) -> ErrorState:
        if self.off:
            return ErrorState.OFF
        if self.passive:
            return ErrorState.PASSIVE
        warned = self.transmit >= WARNING or self.receive >= WARNING
        return ErrorState.WARNING if warned else ErrorState.ACTIVE

    def sent(self) -> None:
        if self.transmit:
            self.transmit -= 1

    def received(self) -> None:
        if self.receive >= PASSIVE:
            self.receive = _AFTER_PASSIVE
        elif self.receive:
            self.receive -= 1

    def transmit_failed(self) -> None:
        self.transmit = min(self.transmit + _TRANSMIT_STEP, _OFF)
        self.off = self.transmit == _OFF

    def not_acknowledged(self) -> None:
        """A transmitter that is passive already is not charged: alone it never goes bus-off."""
        if not self.passive:
            self.transmit_failed()

    def receive_failed(self, step: int = 1) -> None:
        """Not counted beyond error-passive."""
        if self.receive < PASSIVE:
            self.receive = min(self.receive + step, PASSIVE)

    def recover(self) -> None:
        self.transmit = self.receive = 0
        self.off = False
