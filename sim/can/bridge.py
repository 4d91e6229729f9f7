"""A channel of the lab on a bus that is not the lab's: emulated nodes beside real ones.

The bridge stores and forwards, like one between two wires: a device's frame goes out when it has
ended on the lab's channel, and a frame from outside enters the channel when it has arrived. Only in
real time. A frame that the other bus does not take, or that finds the bridge's queue full, is lost.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

import can

from tonus.sim.can.registry import Advancing
from tonus.sim.can.wire.channel import Channel
from tonus.sim.can.wire.frame import ERROR, EXTENDED, EXTENDED_ID, REMOTE, Frame
from tonus.sim.errors import LabError

_LISTEN_S = 0.1
"""How long a bus without a file descriptor is listened to before a look whether to go on."""


class Bridge:
    """Opens ``interface`` at the channel's own name; ``after`` is called when a frame has come in.

    Raises `LabError` when the bus cannot be opened, and into the loop when it fails later.
    """

    def __init__(
        self,
        lab: Advancing,
        channel: Channel,
        interface: str,
        bitrate: int,
        after: Callable[[], object],
    ) -> None:
        self._lab = lab
        self._name = channel.name
        self._after = after
        try:
            self._bus = can.Bus(interface=interface, channel=channel.name, bitrate=bitrate)
        except (can.CanError, OSError, ValueError, ImportError) as error:
            raise LabError(
                f"{interface} channel {channel.name} cannot be opened: {error}"
            ) from error
        self._port = channel.attach(listens=True)
        self.lost = 0
        """frames that the other bus did not take"""
        self._loop = asyncio.get_running_loop()
        self._closed = False
        self._thread: threading.Thread | None = None
        try:
            self._file = self._bus.fileno()
        except NotImplementedError:
            self._file = -1
        if self._file >= 0:
            self._loop.add_reader(self._file, self._drain)
        else:
            self._thread = threading.Thread(target=self._listen, daemon=True)
            self._thread.start()

    def close(self) -> None:
        self._closed = True
        if self._thread is not None:
            self._thread.join()
        else:
            self._loop.remove_reader(self._file)
        self._port.channel.detach(self._port)
        self._bus.shutdown()

    def forward(self) -> None:
        """Hand out what has ended on the channel."""
        received = self._port.received
        assert received is not None
        while (frame := received.pop()) is not None:
            _, identifier, dlc, _, data = frame
            if identifier & ERROR:
                continue  # each side has errors of its own
            message = can.Message(
                arbitration_id=identifier & EXTENDED_ID,
                is_extended_id=bool(identifier & EXTENDED),
                is_remote_frame=bool(identifier & REMOTE),
                dlc=dlc,
                data=data,
            )
            try:
                self._bus.send(message)
            except (can.CanError, OSError):
                self.lost += 1  # as at a controller whose queue nobody empties

    def _drain(self) -> None:
        while (message := self._receive(0.0)) is not None:
            self._take(message)

    def _listen(self) -> None:
        try:
            while not self._closed:
                message = self._receive(_LISTEN_S)
                if message is not None:
                    self._loop.call_soon_threadsafe(self._take, message)
        except LabError as error:
            self._loop.call_soon_threadsafe(self._fail, error)

    def _receive(self, timeout: float) -> can.Message | None:
        try:
            return self._bus.recv(timeout)
        except (can.CanError, OSError) as error:
            raise LabError(f"channel {self._name} has failed: {error}") from error

    def _fail(self, error: LabError) -> None:
        raise error

    def _take(self, message: can.Message) -> None:
        if message.is_error_frame or message.is_fd or self._closed:
            return  # not of this bus' kind
        identifier = message.arbitration_id
        identifier |= EXTENDED * message.is_extended_id | REMOTE * message.is_remote_frame
        lab = self._lab
        lab.advance(lab.clock())
        frame = Frame(identifier, bytes(message.data), message.dlc)
        self._port.channel.send(self._port, frame, lab.now_ns)
        self._after()
