"""A python-can bus on a lab of this process whose `recv` lets the lab's time pass."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

import can

from tonus.sim.can.plugin import LocalBus

_LONGEST_S = 60.0
"""of the lab's time; who waits longer for a frame waits for ever"""
Wait = Callable[[Callable[[], bool], float], bool]
"""As `tonus.tools.testing.lab.VirtualLab.wait`."""


class WaitingBus(LocalBus):
    """As `LocalBus`, which would raise where it has to wait."""

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        del args, kwargs
        return object.__new__(cls)

    def __init__(self, channel: str, *, wait: Wait, **options: Any) -> None:
        self._wait = wait
        super().__init__(channel, **options)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next message, or None if none came within ``timeout`` s of the lab's time.

        Raises `can.CanOperationError` where it is to wait without end and nothing comes in a
        minute.
        """
        if timeout == 0:
            return super().recv(timeout=0)
        found: list[can.Message] = []

        def arrived() -> bool:
            message = super(WaitingBus, self).recv(timeout=0)
            if message is not None:
                found.append(message)
            return message is not None

        self._wait(arrived, _LONGEST_S if timeout is None else timeout)
        if not found and timeout is None:
            raise can.CanOperationError(
                f"no frame came on {self._name} in {_LONGEST_S:g} s of the lab's time; "
                "give recv a timeout"
            )
        return found[0] if found else None
