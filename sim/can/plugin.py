"""The lab's bus as a python-can interface: ``can.Bus(interface="tonus", channel="can0")``.

A channel of a lab in this process is used directly; otherwise a running lab is joined through its
socket. In this process time is the lab's, so nothing can be waited for: a blocking `recv` raises,
and cyclic messages are sent by the lab's time.

Error frames are laid out as SocketCAN's (`tonus.sim.can.wire.error_frames`) and pass every filter,
as there.

Who is pressed for time does without messages: `TonusBus.receive_frames` and `TonusBus.send_frame`.
"""

from __future__ import annotations

import secrets
import select
import socket
from collections import deque
from collections.abc import Sequence
from typing import Any, Self, cast

import can
import numpy as np
from can.typechecking import CanFilters
from numpy.typing import NDArray

from tonus.config.places import runtime_dir
from tonus.sim.can import packet, registry
from tonus.sim.can.carried import CarriedBuses
from tonus.sim.can.cyclic import LabCyclicTask, Modifier
from tonus.sim.can.joined import JoinedBuses
from tonus.sim.can.wire import error_frames
from tonus.sim.can.wire.confinement import ErrorState
from tonus.sim.can.wire.frame import (
    BASE_ID,
    ERROR,
    EXTENDED,
    EXTENDED_ID,
    REMOTE,
    Frame,
    arbitration_key,
)
from tonus.sim.can.wire.inbox import FRAME, FRAMES, RawFrame

_SEND_BUFFER = 16384
"""Bytes a socket holds of frames the lab has not taken yet: some forty, the host counts its own
overhead with each. Like a controller's queue it must not hide a lab that has fallen behind."""
_MOST_CARRIED = 255
"""connections by one carrier: their number is a byte"""


class TonusBus(can.BusABC):
    """A python-can bus on a channel of the lab; made as one of the two below."""

    def __new__(cls, channel: str, *args: Any, **kwargs: Any) -> Self:
        del args, kwargs
        chosen: type[TonusBus] = cls
        if cls is TonusBus:
            chosen = SocketBus if registry.find(str(channel)) is None else LocalBus
        return cast(Self, object.__new__(chosen))

    def __init__(
        self,
        channel: str,
        can_filters: CanFilters | None = None,
        receive_own_messages: bool = False,
        bitrate: int | None = None,
        error_frames: bool = True,
        rx_queue_size: int = 0,
        gather_ms: int = 0,
        **kwargs: object,
    ) -> None:
        """``bitrate`` has to be the lab's, if it is given and can be known; ``rx_queue_size`` is
        that of a lab in this process, 0: without end. A client that looks seldom saves a lab in
        another process much work with ``gather_ms`` (0 to 255): frames come in fewer packets, so
        much later at most. Raises `can.CanInitializationError`.
        """
        if not 0 <= gather_ms <= 255:
            raise can.CanInitializationError(f"gather_ms is {gather_ms}; it has to be 0 to 255")
        self._name = str(channel)
        self.channel_info = f"tonus lab, channel {self._name}"
        self._echo = bool(receive_own_messages)
        self._error_frames = bool(error_frames)
        self._depth = int(rx_queue_size) or None
        self._gather_ms = gather_ms
        self._connect(bitrate)
        super().__init__(channel, can_filters, **kwargs)

    def _connect(self, bitrate: int | None) -> None:
        raise NotImplementedError

    def receive_frames(self, limit: int) -> NDArray[np.void]:
        """Everything that has arrived, without waiting, oldest first, ``limit`` frames at most:
        (n,) of `FRAMES`."""
        frames = self._take(limit)
        if self._takes_all:
            return frames
        wanted = [
            self._wanted(_message(*frame, self._name)) for frame in packet.decode(frames.tobytes())
        ]
        chosen: NDArray[np.void] = frames[np.array(wanted, bool)]
        return chosen

    def _take(self, limit: int) -> NDArray[np.void]:
        raise NotImplementedError

    def send_frame(self, identifier: int, data: bytes, sent_ns: int = 0) -> None:
        """A data frame with an 11-bit identifier; otherwise as `send` of a message."""
        raise NotImplementedError

    @property
    def _takes_all(self) -> bool:
        return self._filters is None and self._error_frames

    def _wanted(self, message: can.Message) -> bool:
        if message.is_error_frame:
            return self._error_frames
        return self._filters is None or self._matches_filters(message)


def _checked(message: can.Message) -> int:
    """Identifier with flags of a message to send. Raises `can.CanOperationError`."""
    if message.is_fd or message.is_error_frame or message.dlc > 8:
        raise can.CanOperationError("the lab's bus carries classic data and remote frames only")
    identifier = message.arbitration_id
    if not 0 <= identifier <= (EXTENDED_ID if message.is_extended_id else BASE_ID):
        raise can.CanOperationError(f"an identifier of 0x{identifier:X} does not fit the frame")
    if message.is_extended_id:
        identifier |= EXTENDED
    if message.is_remote_frame:
        identifier |= REMOTE
    elif len(message.data) != message.dlc:
        raise can.CanOperationError(
            f"a frame of length {message.dlc} was given {len(message.data)} bytes"
        )
    return identifier


def _message(
    stamp_ns: int, identifier: int, dlc: int, own: bool, data: bytes, channel: str
) -> can.Message:
    received = not own
    if identifier <= EXTENDED_ID:  # no flags: a base data frame, nearly always
        return can.Message(
            stamp_ns * 1e-9, identifier, False, False, False, channel, dlc, data, False, received
        )
    return can.Message(
        stamp_ns * 1e-9,
        identifier & EXTENDED_ID,
        bool(identifier & EXTENDED),
        bool(identifier & REMOTE),
        bool(identifier & ERROR),
        channel,
        dlc,
        data,
        False,
        received,
    )


_STATES = {
    ErrorState.ACTIVE: can.BusState.ACTIVE,
    ErrorState.WARNING: can.BusState.ACTIVE,
    ErrorState.PASSIVE: can.BusState.PASSIVE,
    ErrorState.OFF: can.BusState.ERROR,
}


class LocalBus(TonusBus):
    """On a lab in this process."""

    def _connect(self, bitrate: int | None) -> None:
        door = registry.find(self._name)
        if door is None:
            raise can.CanInitializationError(f"no lab in this process has a channel {self._name}")
        if bitrate is not None and bitrate != door.bitrate:
            raise can.CanInitializationError(
                f"channel {self._name} runs at {door.bitrate} bit/s, not {bitrate}"
            )
        self._lab = door.lab
        self._clock = door.lab.clock
        self._port = door.channel.attach(listens=True, inbox=self._depth)
        self._port.echo = self._echo
        self._port.reports = self._error_frames
        assert self._port.received is not None
        self._received = self._port.received
        self._keys: dict[int, int] = {}

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a message now; the queue's room is known at once, so ``timeout`` has no effect.

        Raises `can.CanOperationError` if the queue is full.
        """
        del timeout
        self._send(_checked(msg), bytes(msg.data), msg.dlc)

    def send_frame(self, identifier: int, data: bytes, sent_ns: int = 0) -> None:
        del sent_ns
        port, key = self._port, self._keys.get(identifier)
        now_ns = self._clock()
        # Nearly every frame goes to compiled code, without a step between.
        if (
            key is None
            or now_ns != self._lab.now_ns
            or not port.channel.wire.put(port.number, key, identifier, data, now_ns)
        ):
            self._send(identifier, data, len(data))

    def join(self, buses: Sequence[can.BusABC]) -> JoinedBuses | None:
        """Buses on the channels of this lab, itself among them, as one; None where one of them is
        another, or does not receive everything."""
        plain = [bus for bus in buses if isinstance(bus, LocalBus) and bus._takes_all]
        ports = [bus._port for bus in plain if bus._lab is self._lab]
        return JoinedBuses(self._lab, ports) if len(ports) == len(buses) else None

    def _send(self, identifier: int, data: bytes, dlc: int) -> None:
        lab = self._lab
        now_ns = self._clock()
        if now_ns > lab.now_ns:
            lab.advance(now_ns)
        if not self._queue(identifier, data, dlc):
            raise can.CanOperationError(f"the transmit queue of channel {self._name} is full")

    def _queue_message(self, message: can.Message) -> bool:
        return self._queue(_checked(message), bytes(message.data), message.dlc)

    def _queue(self, identifier: int, data: bytes, dlc: int) -> bool:
        """Queue a frame at the lab's present; False if there is no room."""
        key = self._keys.get(identifier)
        if key is None:
            key = arbitration_key(identifier)
            if identifier <= BASE_ID:  # of the others there are too many to keep
                self._keys[identifier] = key
        port, now_ns = self._port, self._lab.now_ns
        if dlc == len(data) and port.channel.wire.put(port.number, key, identifier, data, now_ns):
            return True
        return port.channel.send(port, Frame(identifier, data, dlc, key), now_ns)

    def _send_periodic_internal(
        self,
        msgs: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None = None,
        autostart: bool = True,
        modifier_callback: Modifier | None = None,
    ) -> LabCyclicTask:
        self._lab.advance(self._clock())
        task = LabCyclicTask(
            self._lab, self._queue_message, msgs, period, duration, modifier_callback
        )
        if autostart:
            task.start()
        return task

    @property
    def state(self) -> can.BusState:
        """The controller's, now."""
        self._lab.advance(self._clock())
        return _STATES[self._port.errors.state]

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        raise NotImplementedError(f"a controller of the lab cannot be set to {new_state}")

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next message that has arrived by now, or None. ``timeout`` has to be 0.

        Raises `can.CanOperationError` if it would have to wait.
        """
        received = self._received
        while True:
            frame = received.pop()
            if frame is None:
                self._lab.advance(self._clock())
                frame = received.pop()
                if frame is None:
                    break
            message = _message(*frame, self._name)
            if self._wanted(message):
                return message
        if timeout is None or timeout > 0:
            raise can.CanOperationError(
                f"recv on channel {self._name} would wait, but the lab's time passes only in this"
                " process: poll with recv(timeout=0)"
            )
        return None

    def _take(self, limit: int) -> NDArray[np.void]:
        # Even if something is there already: another fieldbus may have moved the lab on, in
        # mid-tick, to the first of several answers.
        self._lab.advance(self._clock())
        return self._received.take(limit)

    def flush_tx_buffer(self) -> None:
        self._port.channel.drop(self._port)

    def shutdown(self) -> None:
        if not self._is_shutdown:
            self._port.channel.detach(self._port)
        super().shutdown()


class SocketBus(TonusBus):
    """On a lab in another process."""

    def _connect(self, bitrate: int | None) -> None:
        del bitrate
        path = packet.socket_path(runtime_dir(), self._name)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        try:
            self._socket.connect(str(path))
        except OSError as error:
            self._socket.close()
            raise can.CanInitializationError(
                f"no lab answers at {path} ({error.strerror}); start one with: tonus lab CONFIG"
            ) from error
        self._socket.setblocking(False)
        self._poll = select.poll()
        self._poll.register(self._socket, select.POLLIN)
        self._ask = self._poll.poll
        self._batch: deque[RawFrame] = deque()
        self._held = False
        """the packet they came in is still in the socket"""
        self._rest = b""
        """frames beyond the limit of a `receive_frames`"""
        self._state = ErrorState.ACTIVE
        self._carried: CarriedBuses | None = None
        """asked for"""
        self._way, self._number = self._socket, 0
        """of what is sent, and what its frames have for a channel"""
        if self._echo or self._gather_ms:
            self._socket.send(packet.Wishes(self._echo, self._gather_ms).packed())

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """A timestamp in ``msg``, s on the lab's clock, is when it enters its queue: how late the
        lab reads it then does not matter.

        Raises `can.CanOperationError` if the lab has not taken the frames before this one.
        """
        identifier = _checked(msg)
        sent_ns = round(max(msg.timestamp, 0.0) * 1e9)
        data = self._packed(sent_ns, identifier, msg.dlc, bytes(msg.data))
        if timeout is not None and timeout > 0:
            select.select([], [self._way], [], timeout)
        self.send_packed(data)

    def send_frame(self, identifier: int, data: bytes, sent_ns: int = 0) -> None:
        self.send_packed(self._packed(sent_ns, identifier, len(data), data))

    def send_frames(self, frames: Sequence[tuple[int, bytes]], sent_ns: int) -> None:
        """Data frames with their identifiers, in one packet."""
        pack = self._packed
        self.send_packed(b"".join([pack(sent_ns, each, len(data), data) for each, data in frames]))

    def _packed(self, sent_ns: int, identifier: int, dlc: int, data: bytes) -> bytes:
        return packet.ADDRESSED.pack(sent_ns, identifier, dlc, 0, self._number, data)

    def send_packed(self, data: bytes | memoryview) -> None:
        """A packet. Raises `can.CanOperationError`."""
        try:
            self._way.send(data)
        except BlockingIOError as error:
            raise can.CanOperationError(
                f"the transmit queue of channel {self._name} is full"
            ) from error
        except OSError as error:
            raise can.CanOperationError(f"the lab has closed {self._name}: {error}") from error

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """As python-can's, but without its clock and its logging where nothing is waited for."""
        if timeout == 0:
            return self._recv_internal(0)[0]
        return super().recv(timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """The next message that has arrived or arrives within ``timeout`` s; no time is lost on
        those that a filter holds back."""
        while self._batch or self._fill(timeout):
            frame = self._batch.popleft()
            if not self._batch and self._held:
                self._let_go()
            self.notice(frame)
            message = _message(*frame, self._name)
            if self._wanted(message):
                return message, True
            timeout = 0 if timeout is not None else None
        return None, True

    def join(self, buses: Sequence[can.BusABC]) -> CarriedBuses | None:
        """``buses`` in other processes, itself the first, as one, when their lab has agreed: from
        then on frames come in through that alone. None where one of them wants anything special,
        or cannot ask."""
        plain = [bus for bus in buses if isinstance(bus, SocketBus) and bus._is_plain]
        if len(plain) != len(buses) or not 1 < len(plain) <= _MOST_CARRIED or plain[0] is not self:
            return None
        carried = CarriedBuses(plain)
        shared = secrets.token_bytes(4)
        try:
            for number, bus in enumerate(plain):
                bus.send_packed(packet.Wishes(False, 0, len(plain), number, shared).packed())
        except can.CanOperationError:
            return None  # the lab never hears of all
        for bus in plain:
            bus._carried = carried
        return carried

    @property
    def _is_plain(self) -> bool:
        return self._takes_all and not (self._echo or self._gather_ms or self._carried)

    def carry(self, carrier: SocketBus, number: int) -> None:
        """Send by ``carrier`` from now on, as its connection ``number``."""
        self._way, self._number = carrier._socket, number

    def _take(self, limit: int) -> NDArray[np.void]:
        data = self.take_packed(limit)
        if packet.flagged(data):
            for frame in packet.decode(data):
                self.notice(frame)
        return np.frombuffer(data, FRAMES)

    def take_packed(self, limit: int) -> bytes:
        """`receive_frames`, as they come; error frames are for `notice`."""
        if self._held:
            self._let_go()
        data, self._rest = self._rest, b""
        if self._batch:
            data += b"".join([FRAME.pack(*frame) for frame in self._batch])
            self._batch.clear()
        most = limit * FRAME.size
        # To ask is cheaper than to be refused: an exception costs more than a system call.
        while len(data) < most and self._ask(0):
            try:
                received = self._receive(0)
            except can.CanOperationError:
                if not data:  # what came before it is not lost, and the error is met again
                    raise
                break
            if self._carried is not None and received == packet.AGREED:
                self._carried.agree()
                break
            if self._carried is not None and received == packet.APART:
                self._carried.part()
                continue
            data += received
        if len(data) > most:
            data, self._rest = data[:most], data[most:]
        return data

    def notice(self, frame: RawFrame) -> None:
        """Keep in mind what an error frame tells of the controller."""
        _, identifier, _, _, data = frame
        if identifier & ERROR:
            self._state = error_frames.state(identifier, data, self._state)

    @property
    def state(self) -> can.BusState:
        """The controller's, as far as frames have been received."""
        return _STATES[self._state]

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        raise NotImplementedError(f"a controller of the lab cannot be set to {new_state}")

    def _fill(self, timeout: float | None) -> bool:
        """Look at the next packet; False if none came in time. It stays in the socket until its
        last frame is out, so that the socket is readable for as long as there is a frame to be had.
        """
        if self._rest:
            self._batch.extend(packet.decode(self._rest))
            self._rest = b""
            return True
        if timeout is None or timeout > 0:
            self._ask(None if timeout is None else timeout * 1e3)
        try:
            data = self._receive(socket.MSG_PEEK)
        except BlockingIOError:
            return False
        self._batch.extend(packet.decode(data))
        self._held = True
        return bool(self._batch)

    def _let_go(self) -> None:
        """Of the packet whose frames are all in the batch."""
        self._socket.recv(1)
        self._held = False

    def _receive(self, flags: int) -> bytes:
        """Raises `BlockingIOError` if there is no packet, `can.CanOperationError` if there will be
        none."""
        try:
            data = self._socket.recv(packet.PACKET_BYTES, flags)
        except BlockingIOError:
            raise
        except OSError as error:
            raise can.CanOperationError(f"cannot receive on {self._name}: {error}") from error
        if not data:
            raise can.CanOperationError(f"the lab has closed channel {self._name}")
        return data

    def fileno(self) -> int:
        return self._socket.fileno()

    def shutdown(self) -> None:
        super().shutdown()
        self._socket.close()
