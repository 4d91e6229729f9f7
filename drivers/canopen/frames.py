"""Frames to and from a python-can bus, in the quickest way the bus has.

python-can makes a `can.Message` of every frame and asks the kernel whether there is one before it
takes it. For the thirty frames of a tick that costs more than everything else the bus needs, so a
bus that has frames without messages (the lab's, SocketCAN's) is asked for these.
"""

from __future__ import annotations

import errno
import socket
import struct
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import can
import numpy as np
from can.interfaces.socketcan import SocketcanBus
from numpy.typing import NDArray

from tonus.drivers.fieldbus import RAW_FRAME

EXTENDED = 1 << 31
REMOTE = 1 << 30
ERROR = 1 << 29
"""Flags above an identifier's 29 bits, as SocketCAN has them (linux/can.h)."""
IDENTIFIER = ERROR - 1

_CAN_FRAME = struct.Struct("=IB3x8s")
"""struct can_frame (linux/can.h): identifier with flags, length, data."""
_TIMESPEC = struct.Struct("@ll")
_ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size)
_STAMP = 35
"""SCM_TIMESTAMPNS (asm-generic/socket.h), which python-can switches on."""
_SECOND_NS = 1_000_000_000
_FULL = (errno.EAGAIN, errno.ENOBUFS)
"""The socket's buffer or the interface's queue has no room."""

_RAW = struct.Struct("<qIBBxx8s")
"""`RAW_FRAME`"""


@runtime_checkable
class Frames(Protocol):
    """Both directions, neither of which waits; errors are `can.CanError` and `OSError`."""

    def receive_frames(self, limit: int) -> NDArray[np.void]:
        """What has arrived, oldest first, (n,) of `RAW_FRAME`; ``limit`` frames at most."""

    def send_frame(self, identifier: int, data: bytes, sent_ns: int = 0) -> None:
        """Queue a data frame with an 11-bit identifier. ``sent_ns`` is the present for a bus in
        software that must know it exactly; wires do not need it."""


class JoinedFrames(Protocol):
    """Several buses that nearly always take frames in one call."""

    def send_joined(self, frames: NDArray[np.void], sent_ns: int) -> bool:
        """`Frames.send_frame` of each of ``frames`` (n,) of `RAW_FRAME`, which have the time
        ``sent_ns``, on the bus that its channel counts. False: nothing was done, and each has to be
        sent by itself."""

    def receive_joined(self, limit: int) -> NDArray[np.void] | None:
        """`Frames.receive_frames` of all, by our clock; the frames of each channel oldest first.
        None: nothing was done, and each bus has to be asked by itself."""


@runtime_checkable
class Joins(Frames, Protocol):
    """A bus that can be joined with others."""

    def join(self, buses: Sequence[can.BusABC]) -> JoinedFrames | None:
        """``buses``, itself among them, as one; None where they are too different."""


@runtime_checkable
class FramesTogether(Frames, Protocol):
    """A bus that takes several frames in one go, or none of them."""

    def send_frames(self, frames: Sequence[tuple[int, bytes]], sent_ns: int) -> None:
        """`Frames.send_frame` of each identifier and its data."""


class MessageFrames:
    """Any bus of python-can, by messages."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        # Used again and again: a bus has sent or copied a message when its `send` returns.
        self._outgoing: dict[int, can.Message] = {}

    def receive_frames(self, limit: int) -> NDArray[np.void]:
        receive = self._bus.recv
        frames: list[bytes] = []
        try:
            while len(frames) < limit and (message := receive(0)) is not None:
                identifier = message.arbitration_id
                identifier |= EXTENDED * message.is_extended_id
                identifier |= REMOTE * message.is_remote_frame
                identifier |= ERROR * message.is_error_frame
                stamp_ns, data = round(message.timestamp * 1e9), bytes(message.data)
                own = not message.is_rx
                frames.append(_RAW.pack(stamp_ns, identifier, message.dlc, own, data))
        except (can.CanError, OSError):
            if not frames:  # what came before it is not lost, and the error is met again
                raise
        return _array(frames)

    def send_frame(self, identifier: int, data: bytes, sent_ns: int = 0) -> None:
        message = self._outgoing.get(identifier)
        if message is None:
            message = can.Message(arbitration_id=identifier, is_extended_id=False)
            self._outgoing[identifier] = message
        message.data, message.dlc = bytearray(data), len(data)
        message.timestamp = sent_ns * 1e-9
        self._bus.send(message)


class SocketcanFrames:
    """A Linux CAN interface, by the raw socket that python-can has opened and set up: one system
    call a frame."""

    def __init__(self, opened: socket.socket) -> None:
        self._socket = opened

    def receive_frames(self, limit: int) -> NDArray[np.void]:
        take = self._socket.recvmsg
        frames: list[bytes] = []
        try:
            while len(frames) < limit:
                packet, ancillary, flags, _ = take(
                    _CAN_FRAME.size, _ANCILLARY_BYTES, socket.MSG_DONTWAIT
                )
                if len(packet) < _CAN_FRAME.size:
                    raise OSError(errno.EBADMSG, f"a CAN frame of {len(packet)} bytes")
                identifier, dlc, data = _CAN_FRAME.unpack(packet)
                stamp_ns = 0
                for level, kind, content in ancillary:
                    if level == socket.SOL_SOCKET and kind == _STAMP:
                        seconds, ns = _TIMESPEC.unpack_from(content)
                        stamp_ns = seconds * _SECOND_NS + ns
                length = 0 if identifier & REMOTE else dlc
                # Of this very socket; MSG_DONTROUTE is set for every sender on this host.
                own = bool(flags & socket.MSG_CONFIRM)
                frames.append(_RAW.pack(stamp_ns, identifier, dlc, own, data[:length]))
        except BlockingIOError:
            pass
        except OSError as error:
            if not frames:
                raise can.CanOperationError(str(error.strerror), error.errno) from error
        return _array(frames)

    def send_frame(self, identifier: int, data: bytes, sent_ns: int = 0) -> None:
        del sent_ns
        frame = _CAN_FRAME.pack(identifier, len(data), data)
        try:
            self._socket.send(frame, socket.MSG_DONTWAIT)
        except OSError as error:
            text = "the transmit queue is full" if error.errno in _FULL else str(error.strerror)
            raise can.CanOperationError(text, error.errno) from error


def data_of(identifier: int, dlc: int, word: int) -> bytes:
    """The data of a frame of `RAW_FRAME`."""
    length = 0 if identifier & REMOTE else min(dlc, 8)
    return word.to_bytes(8, "little", signed=True)[:length]


def _array(frames: Sequence[bytes]) -> NDArray[np.void]:
    return np.frombuffer(b"".join(frames), RAW_FRAME)


def frames_of(bus: can.BusABC) -> Frames:
    """The quickest way to a bus' frames."""
    if isinstance(bus, Frames):
        return bus
    if isinstance(bus, SocketcanBus):
        return SocketcanFrames(bus.socket)
    return MessageFrames(bus)


def joined(buses: Sequence[can.BusABC]) -> JoinedFrames | None:
    """Several buses as one, where they can be; at least one."""
    return buses[0].join(buses) if isinstance(buses[0], Joins) else None
