"""python-canopen on a lab of this process, without its receiving thread."""

from __future__ import annotations

from typing import Any, Self

import can
import canopen


class VirtualNetwork(canopen.Network):
    """A `canopen.Network` that is connected already. Its callbacks are called while the lab's time
    passes, in this thread."""

    def __init__(self, bus: can.BusABC) -> None:
        super().__init__(bus)

    def connect(self, *args: Any, **kwargs: Any) -> Self:
        """It is."""
        del args, kwargs
        return self

    def receive(self) -> None:
        """Give everything that has arrived to the listeners."""
        while self.bus is not None and (message := self.bus.recv(timeout=0)) is not None:
            for listener in self.listeners:
                listener(message)
