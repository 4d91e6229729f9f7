"""Several channels of a lab in another process by one connection: a system call each way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tonus.sim.can import packet
from tonus.sim.can.wire.inbox import FRAMES

if TYPE_CHECKING:
    from tonus.sim.can.plugin import SocketBus


class CarriedBuses:
    """``buses`` of one lab that have asked it for this; the first is the carrier. Nothing changes
    before the lab has `agreed`."""

    def __init__(self, buses: Sequence[SocketBus]) -> None:
        self._buses = buses
        self.agreed = False
        """by the lab"""
        self._apart = False
        """each sends by itself"""
        self._before = True
        """what came in on each connection by itself may not have been taken yet"""

    def agree(self) -> None:
        """All is sent by the carrier from now on."""
        self.agreed = True
        for number, bus in enumerate(self._buses):
            bus.carry(self._buses[0], number)

    def part(self) -> None:
        """A channel is full: each sends by itself again, and is told of its own."""
        self._apart = True
        for bus in self._buses:
            bus.carry(bus, 0)

    def send_joined(self, frames: NDArray[np.void], sent_ns: int) -> bool:
        """Queue data frames of 11-bit identifiers, (n,) of `FRAMES`, each on the bus that its
        channel counts; all have the time ``sent_ns``. False: nothing was done, and each has to be
        sent by itself. Raises `can.CanOperationError`."""
        del sent_ns
        if not self.agreed or self._apart:
            return False
        self._buses[0].send_packed(frames.data)
        return True

    def receive_joined(self, limit: int) -> NDArray[np.void] | None:
        """What has arrived, (n,) of `FRAMES`, in the order of time on each channel; ``limit``
        frames at most. None: each bus has to be asked by itself. Raises `can.CanOperationError`."""
        if not self.agreed:
            return None
        data = bytearray(self._buses[0].take_packed(limit))
        if self._before:
            self._before = False
            data = self._taken_before(limit) + data
        frames = np.frombuffer(data, FRAMES)
        if packet.flagged(data):
            for channel, frame in zip(frames["channel"], packet.decode(data), strict=True):
                self._buses[channel].notice(frame)
        return frames

    def _taken_before(self, limit: int) -> bytearray:
        data = bytearray()
        for number, bus in enumerate(self._buses[1:], 1):
            while received := bytearray(bus.take_packed(limit)):
                np.frombuffer(received, FRAMES)["channel"] = number
                data += received
        return data
