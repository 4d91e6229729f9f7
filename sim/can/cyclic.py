"""Cyclic sending on a lab in this process: by the lab's own time, not by a thread's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import cycle

import can
from can.broadcastmanager import (
    LimitedDurationCyclicSendTaskABC,
    ModifiableCyclicTaskABC,
    RestartableCyclicTaskABC,
)

from tonus.sim.devices.timers import Timers

_SECOND_NS = 1_000_000_000
Modifier = Callable[[can.Message], None]


class LabCyclicTask(
    ModifiableCyclicTaskABC, LimitedDurationCyclicSendTaskABC, RestartableCyclicTaskABC
):
    """Sends its messages in turn, one each period; ``period`` and ``duration`` in s.

    A message that meets a full transmit queue is lost and counted there.
    """

    def __init__(
        self,
        timers: Timers,
        send: Callable[[can.Message], object],
        messages: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None,
        modifier: Modifier | None,
    ) -> None:
        super().__init__(messages, period, duration)
        self._timers = timers
        self._send = send
        self._modifier = modifier
        self._epoch = 0  # a timer of an older epoch is stale

    def start(self) -> None:
        """Begin, or begin anew, with the first message at once."""
        self._epoch += 1
        now_ns = self._timers.now_ns
        end_ns = None if self.duration is None else now_ns + round(self.duration * _SECOND_NS)
        epoch, turn = self._epoch, cycle(range(len(self.messages)))

        def due(at_ns: int) -> None:
            if epoch != self._epoch or (end_ns is not None and at_ns >= end_ns):
                return
            message = self.messages[next(turn)]
            if self._modifier is not None:
                self._modifier(message)
            self._send(message)
            self._timers.call_at(at_ns + self.period_ns, due)

        due(now_ns)

    def stop(self) -> None:
        self._epoch += 1
