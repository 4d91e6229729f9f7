"""One CAN channel: frames out, and frames in by a table from identifier to handler."""

from __future__ import annotations

from collections.abc import Callable

import can

from drivers.canopen.identifiers import SYNC
from drivers.events import EventLog
from drivers.fieldbus import FrameTap

Handler = Callable[[bytearray], None]
Clock = Callable[[], int]

SHORTEST_FRAME_BITS = 47
"""No data, no stuff bit, three bits of inter-frame space: a bus cannot carry frames faster."""
CATCH_UP = 4
"""Frames taken in one drain, over what the bus can carry in a period: a backlog shrinks, and a bus
that never runs dry does not hold the tick."""
SAME_CLOCK_NS = 1_000_000_000
"""A stamp further than this from our clock comes from another clock."""


class Channel:
    """Sends and drains one python-can bus; never waits."""

    def __init__(
        self,
        number: int,
        name: str,
        bus: can.BusABC,
        frames_per_drain: int,
        clock: Clock,
        tap: FrameTap | None,
        events: EventLog,
    ) -> None:
        self.name = name
        self.handlers: dict[int, Handler] = {}
        self._number = number
        self._bus = bus
        self._frames_per_drain = frames_per_drain
        self._clock = clock
        self._tap = tap
        self._events = events
        self._offset_ns = 0
        self._refused = False
        self._deaf = False
        self._sync = can.Message(arbitration_id=SYNC, is_extended_id=False)

    def send(self, identifier: int, data: bytes) -> None:
        self._transmit(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))

    def sync(self) -> None:
        self._transmit(self._sync)

    def _transmit(self, message: can.Message) -> None:
        try:
            self._bus.send(message)
        except (can.CanError, OSError) as error:
            self._refused = True
            self._events.begin("transmit_refused", self.name, f"frame not sent: {error}")
            return
        if self._refused:
            self._refused = False
            self._events.end("transmit_refused", self.name)
        if self._tap is not None:
            now = self._clock()
            self._tap(now, self._number, message.arbitration_id, bytes(message.data), True)

    def drain(self) -> None:
        """Hand every frame that has arrived to its handler."""
        receive = self._bus.recv
        handlers = self.handlers
        tap = self._tap
        now = self._clock() if tap is not None else 0
        try:
            for _ in range(self._frames_per_drain):
                message = receive(0)
                if message is None:
                    break
                data = message.data
                identifier = message.arbitration_id
                if tap is not None:
                    stamp = self._stamp(message.timestamp, now)
                    tap(stamp, self._number, identifier, bytes(data), False)
                handler = handlers.get(identifier)
                if (
                    handler is None
                    or message.is_extended_id
                    or message.is_remote_frame
                    or message.is_error_frame
                ):
                    self._foreign(message)
                else:
                    handler(data)
        except (can.CanError, OSError) as error:
            self._deaf = True
            self._events.begin("bus_error", self.name, f"cannot receive: {error}")
            return
        if self._deaf:
            self._deaf = False
            self._events.end("bus_error", self.name)

    def _foreign(self, message: can.Message) -> None:
        if message.is_error_frame:
            self._events.counted("bus_error", self.name, "error frame on the bus")
            return
        kind = "remote request" if message.is_remote_frame else "frame"
        width = 8 if message.is_extended_id else 3
        identifier = f"0x{message.arbitration_id:0{width}X}"
        text = f"{kind} {identifier}, {message.dlc} bytes, belongs to no node of ours"
        self._events.counted("foreign_frame", f"{self.name}/{identifier}", text)

    def _stamp(self, seconds: float, now: int) -> int:
        """A bus's time of reception on our clock.

        The lab and some interfaces stamp with the loop's own clock; others with one of their own,
        for which the least delay seen so far stands for the difference of the two.
        """
        stamp = round(seconds * 1e9) + self._offset_ns
        if stamp > now or now - stamp > SAME_CLOCK_NS:
            self._offset_ns += now - stamp
            return now
        return stamp

    def shutdown(self) -> None:
        try:
            self._bus.shutdown()
        except (can.CanError, OSError) as error:
            self._events.add("bus_error", self.name, f"did not close: {error}")
