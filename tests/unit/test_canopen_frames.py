"""Frames without messages: every way to a bus gives the same."""

from __future__ import annotations

import errno
import socket
import struct
from collections import deque
from typing import Any

import can
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.unit.fake_can import ScriptedBus
from tonus.drivers.canopen.frames import (
    ERROR,
    EXTENDED,
    REMOTE,
    Frames,
    FramesTogether,
    MessageFrames,
    SocketcanFrames,
    data_of,
    frames_of,
)
from tonus.drivers.fieldbus import RAW_FRAME


def heard(frames: NDArray[np.void]) -> list[tuple[int, int, int, bool, bytes]]:
    return [(s, n, dlc, bool(own), data_of(n, dlc, w)) for s, n, dlc, own, _, w in frames.tolist()]


def test_messages_become_frames_with_their_flags() -> None:
    bus = ScriptedBus("can0")
    bus.put(0x181, b"\1\2", timestamp=1.5)
    bus.put(0x18DA00F1, b"", is_extended_id=True)
    bus.put(0x701, is_remote_frame=True, dlc=1)
    bus.put(0x004, bytes(8), is_error_frame=True)
    bus.put(0x182, b"\3", is_rx=False)
    frames = frames_of(bus)
    assert isinstance(frames, MessageFrames)
    assert heard(frames.receive_frames(4)) == [
        (1_500_000_000, 0x181, 2, False, b"\1\2"),
        (0, 0x18DA00F1 | EXTENDED, 0, False, b""),
        (0, 0x701 | REMOTE, 1, False, b""),
        (0, 0x004 | ERROR, 8, False, bytes(8)),
    ]
    assert heard(frames.receive_frames(4)) == [(0, 0x182, 1, True, b"\3")]
    frames.send_frame(0x201, b"\5\6")
    assert bus.take_sent() == [(0x201, b"\5\6")]


def test_what_came_before_an_error_is_not_lost() -> None:
    bus = ScriptedBus("can0")
    heard = deque([can.Message(arbitration_id=0x181, is_extended_id=False)])

    def recv(timeout: float | None = None) -> can.Message | None:
        if heard:
            return heard.popleft()
        raise can.CanOperationError("no such device")

    bus.recv = recv  # type: ignore[method-assign]
    frames = frames_of(bus)
    assert len(frames.receive_frames(9)) == 1
    with pytest.raises(can.CanOperationError):
        frames.receive_frames(9)


class RawSocket:
    """As much of a raw CAN socket as is used; it cannot be had here."""

    def __init__(self) -> None:
        self.waiting: list[tuple[bytes, list[Any], int] | OSError] = []
        self.sent: list[bytes] = []
        self.refusal: OSError | None = None

    def put(self, identifier: int, dlc: int, data: bytes, stamp: tuple[int, int]) -> None:
        # linux/can.h: u32 can_id, u8 len, three bytes, eight data bytes
        frame = struct.pack("=IBBBB", identifier, dlc, 0, 0, 0) + data.ljust(8, b"\xaa")
        told = [(socket.SOL_SOCKET, 35, struct.pack("@ll", *stamp))]
        self.waiting.append((frame, told, 0))

    def recvmsg(self, size: int, ancillary: int, flags: int) -> tuple[bytes, list[Any], int, None]:
        assert flags & socket.MSG_DONTWAIT
        if not self.waiting:
            raise BlockingIOError(errno.EAGAIN, "nothing there")
        first = self.waiting.pop(0)
        if isinstance(first, OSError):
            raise first
        return *first, None

    def send(self, data: bytes, flags: int) -> int:
        if self.refusal is not None:
            raise self.refusal
        self.sent.append(data)
        return len(data)


def test_socketcan_frames_are_read_as_the_kernel_lays_them_out() -> None:
    raw = RawSocket()
    raw.put(0x181, 2, b"\1\2", (1_700_000_000, 123_456_789))
    raw.put(0x18DA00F1 | EXTENDED, 8, bytes(range(8)), (0, 5))
    raw.put(0x701 | REMOTE, 1, b"", (0, 6))
    frame, _, _ = raw.waiting[0]  # type: ignore[misc]
    other_process = socket.MSG_DONTROUTE
    raw.waiting.append((frame, [], other_process))
    raw.waiting.append((frame, [], socket.MSG_DONTROUTE | socket.MSG_CONFIRM))
    frames = SocketcanFrames(raw)  # type: ignore[arg-type]
    assert heard(frames.receive_frames(3)) == [
        (1_700_000_000_123_456_789, 0x181, 2, False, b"\1\2"),
        (5, 0x18DA00F1 | EXTENDED, 8, False, bytes(range(8))),
        (6, 0x701 | REMOTE, 1, False, b""),
    ]
    assert heard(frames.receive_frames(3)) == [
        (0, 0x181, 2, False, b"\1\2"),
        (0, 0x181, 2, True, b"\1\2"),
    ]
    assert heard(frames.receive_frames(3)) == []


def test_socketcan_errors_are_python_cans() -> None:
    raw = RawSocket()
    frames = SocketcanFrames(raw)  # type: ignore[arg-type]
    raw.put(0x181, 0, b"", (0, 1))
    raw.waiting += [OSError(errno.ENETDOWN, "Network is down")] * 2
    assert len(frames.receive_frames(9)) == 1
    with pytest.raises(can.CanOperationError, match="Network is down"):
        frames.receive_frames(9)
    raw.waiting = []
    raw.put(0x182, 0, b"", (0, 1))
    raw.waiting += [(b"\0" * 8, [], 0)] * 2
    assert len(frames.receive_frames(9)) == 1
    with pytest.raises(can.CanOperationError, match="8 bytes"):
        frames.receive_frames(9)
    frames.send_frame(0x201, b"\1\2\3\4")
    assert raw.sent == [struct.pack("=IBBBB", 0x201, 4, 0, 0, 0) + b"\1\2\3\4\0\0\0\0"]
    raw.refusal = OSError(errno.ENOBUFS, "No buffer space available")
    with pytest.raises(can.CanOperationError, match="the transmit queue is full"):
        frames.send_frame(0x201, b"")


def test_the_labs_buses_need_no_messages() -> None:
    from tonus.sim.can.plugin import LocalBus, SocketBus
    from tonus.sim.can.wire.inbox import FRAMES

    for kind in (LocalBus, SocketBus):
        assert issubclass(kind, Frames)
    assert issubclass(SocketBus, FramesTogether)
    assert FRAMES.descr == RAW_FRAME.descr
