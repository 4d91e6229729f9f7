"""The segment's end of a network cable: an AF_PACKET socket that answers EtherCAT frames.

The socket is bound to the ethertype, or it would see its own answers. Its receive buffer is small:
a lab that was stopped must not answer old frames later, since a master's frame indices come again
after sixteen frames and stale answers would pass for fresh ones. The kernel stamps each frame when
it arrives, so that how late it is read does not show in the segment.
"""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import Callable

from tonus.sim.errors import LabError
from tonus.sim.ethercat.frames import ETHERTYPE
from tonus.sim.ethercat.segment import Segment

_FRAME_BYTES = 2048
_BATCH = 16
"""Frames answered at once before others get their turn."""
_SO_TIMESTAMPNS = 35
_STAMP = struct.Struct("@qq")
_ANCILLARY_BYTES = socket.CMSG_SPACE(_STAMP.size)
_SECOND_NS = 1_000_000_000
_OUTGOING = 4
Clock = Callable[[], int]


class SegmentPort:
    """``clock`` is the lab's, in ns; ``utc`` what to add to it for the host's time of day, None
    where nobody knows. ``after`` is called when frames have been answered. Raises `LabError`."""

    def __init__(
        self,
        segment: Segment,
        interfaces: tuple[str, ...],
        receive_buffer: int,
        clock: Clock,
        utc: Clock | None,
        after: Callable[[], None],
    ) -> None:
        self._segment = segment
        self._clock = clock
        self._utc = utc
        self._after = after
        self._loop = asyncio.get_running_loop()
        self._sockets: list[socket.socket] = []
        self.unsent = 0
        """answers the interface did not take"""
        try:
            for name in interfaces:
                self._sockets.append(_open(name, receive_buffer, stamps=utc is not None))
        except LabError:
            self.close()
            raise
        for number, opened in enumerate(self._sockets):
            self._loop.add_reader(opened, self._ready, number)
        segment.awaits = self._late

    def close(self) -> None:
        self._segment.awaits = None
        for opened in self._sockets:
            self._loop.remove_reader(opened)
            opened.close()

    def _ready(self, number: int) -> None:
        self.receive(number)
        self._after()

    def receive_all(self) -> None:
        """Answer what has arrived by now."""
        for number in range(len(self._sockets)):
            self.receive(number)

    def receive(self, number: int) -> None:
        opened, segment = self._sockets[number], self._segment
        for _ in range(_BATCH):
            try:
                frame, ancillary, _, sender = opened.recvmsg(_FRAME_BYTES, _ANCILLARY_BYTES)
            except BlockingIOError:
                return
            except OSError:
                return  # the interface went down; its cable may be put back
            if sender[2] == _OUTGOING:
                continue
            answer = segment.answer(frame, self._arrival(ancillary), number)
            if answer is not None:
                self._send(segment.cable.exit(number), answer)
            segment.settle()

    def _arrival(self, ancillary: list[tuple[int, int, bytes]]) -> int:
        now_ns = self._clock()
        if self._utc is not None:
            for level, kind, data in ancillary:
                if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS:
                    seconds, rest = _STAMP.unpack_from(data)
                    stamp: int = seconds * _SECOND_NS + rest
                    return min(stamp - self._utc(), now_ns)
        return now_ns

    def _send(self, number: int, answer: bytes) -> None:
        try:
            self._sockets[min(number, len(self._sockets) - 1)].send(answer)
        except OSError:
            self.unsent += 1

    def _late(self) -> None:
        for number, answer in self._segment.poll(self._clock()):
            self._send(number, answer)


def _open(name: str, receive_buffer: int, *, stamps: bool) -> socket.socket:
    try:
        opened = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETHERTYPE))
    except PermissionError as error:
        raise LabError(
            f"{name} cannot be opened: a raw socket needs CAP_NET_RAW; "
            "run as root, or give the interpreter the capability with setcap"
        ) from error
    try:
        opened.setblocking(False)
        # The kernel doubles what it is told.
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer // 2)
        if stamps:
            opened.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        opened.bind((name, ETHERTYPE))
    except OSError as error:
        opened.close()
        raise LabError(f"{name} cannot be opened: {error.strerror}") from error
    return opened
