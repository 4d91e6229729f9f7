"""SDO client (CiA 301, 7.2.4): expedited and segmented, one transfer at a time to one node."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Awaitable, Callable
from typing import TypeVar

from tonus.drivers.cia301 import abort_codes
from tonus.drivers.errors import SdoAbortError, SdoError, SdoTimeoutError

Result = TypeVar("Result")
Send = Callable[[bytes], None]
"""Sends the eight bytes of a request to the node's server."""

MAXIMUM_SIZE = 1 << 16
"""Bytes taken from a server that announces more than this, or nothing, before it is cut short."""

_HEADER = struct.Struct("<BHB4x")
_HEADER_AND_WORD = struct.Struct("<BHBI")
_ABORT = 0x80
_SEGMENT = 7


class SdoClient:
    """Talks to one node's SDO server; `receive` is called for each frame on 0x580 + node id.

    Frames that do not answer the request under way are ignored: they are late answers to one that
    was given up, or meant for another client of the same server.

    A transfer without an answer is begun again, since a frame may be lost and a server be late: an
    object that is read or written twice with one value is as after once.
    """

    def __init__(self, send: Send, timeout_s: float, attempts: int = 1) -> None:
        """``attempts``: transfers without an answer in time, in a row, that are an error."""
        self._send = send
        self._timeout_s = timeout_s
        self._attempts = attempts
        self.repeated = 0
        """transfers that were begun again"""
        self._turn = asyncio.Lock()
        self._reply: asyncio.Future[bytes] | None = None
        self._accepts: Callable[[bytes], bool] = lambda _: False
        self._object = (0, 0)

    def receive(self, data: bytes) -> None:
        reply = self._reply
        if reply is None or reply.done() or len(data) != 8:
            return
        frame = bytes(data)
        if frame[0] == _ABORT:
            _, index, subindex, _ = _HEADER_AND_WORD.unpack(frame)
            if (index, subindex) == self._object:
                reply.set_result(frame)
        elif self._accepts(frame):
            reply.set_result(frame)

    async def read(self, index: int, subindex: int) -> bytes:
        """Upload. Raises `SdoAbortError`, `SdoTimeoutError` or, for a false length, `SdoError`."""
        async with self._turn:
            self._object = (index, subindex)
            return await self._persist(self._upload)

    async def write(self, index: int, subindex: int, data: bytes) -> None:
        """Download. Raises `SdoAbortError` or `SdoTimeoutError`."""
        async with self._turn:
            self._object = (index, subindex)
            await self._persist(lambda: self._download(data))

    async def _persist(self, transfer: Callable[[], Awaitable[Result]]) -> Result:
        for _ in range(self._attempts - 1):
            try:
                return await transfer()
            except SdoTimeoutError:
                self.repeated += 1
        return await transfer()

    async def _upload(self) -> bytes:
        reply = await self._request(
            _HEADER.pack(0x40, *self._object),
            lambda frame: frame[0] >> 5 == 2 and self._is_object(frame),
            "reading",
        )
        command = reply[0]
        if command & 0x02:  # expedited
            unused = command >> 2 & 3 if command & 0x01 else 0
            return reply[4 : 8 - unused]
        size = int.from_bytes(reply[4:8], "little") if command & 0x01 else None
        return await self._upload_segments(size)

    async def _download(self, data: bytes) -> None:
        size = len(data)
        expedited = 1 <= size <= 4
        if expedited:
            head = struct.pack("<BHB", 0x23 | (4 - size) << 2, *self._object)
            request = (head + data).ljust(8, b"\0")
        else:
            request = _HEADER_AND_WORD.pack(0x21, *self._object, size)
        await self._request(
            request,
            lambda frame: frame[0] >> 5 == 3 and self._is_object(frame),
            "writing",
        )
        if not expedited:
            await self._download_segments(data)

    async def _upload_segments(self, size: int | None) -> bytes:
        received = bytearray()
        limit = MAXIMUM_SIZE if size is None else min(size, MAXIMUM_SIZE)
        toggle = 0
        while True:
            reply = await self._request(
                bytes((0x60 | toggle << 4, 0, 0, 0, 0, 0, 0, 0)),
                lambda frame: frame[0] >> 5 == 0,
                "reading",
            )
            self._check_toggle(reply, toggle)
            received += reply[1 : 8 - (reply[0] >> 1 & 7)]
            last = reply[0] & 0x01
            if len(received) > limit or (last and size is not None and len(received) != size):
                self._abort(abort_codes.LENGTH)
                announced = "no size" if size is None else f"{size} bytes"
                raise SdoError(
                    f"device announced {announced} and sent {len(received)}, "
                    f"{self._doing('reading')}"
                )
            if last:
                return bytes(received)
            toggle ^= 1

    async def _download_segments(self, data: bytes) -> None:
        toggle = 0
        for start in range(0, max(len(data), 1), _SEGMENT):
            part = data[start : start + _SEGMENT]
            last = start + _SEGMENT >= len(data)
            head = toggle << 4 | (_SEGMENT - len(part)) << 1 | last
            reply = await self._request(
                bytes((head,)) + part.ljust(_SEGMENT, b"\0"),
                lambda frame: frame[0] >> 5 == 1,
                "writing",
            )
            self._check_toggle(reply, toggle)
            toggle ^= 1

    def _check_toggle(self, reply: bytes, toggle: int) -> None:
        if reply[0] >> 4 & 1 != toggle:
            self._abort(abort_codes.TOGGLE)
            raise SdoError(f"device did not alternate the toggle bit, {self._doing('segments of')}")

    async def _request(self, request: bytes, accepts: Callable[[bytes], bool], doing: str) -> bytes:
        """Send and await the answer; an abort or silence is raised, silence told the node too."""
        loop = asyncio.get_running_loop()
        self._reply = reply = loop.create_future()
        self._accepts = accepts
        done = False
        try:
            self._send(request)
            async with asyncio.timeout(self._timeout_s):
                frame: bytes = await reply
            done = True
        except TimeoutError as error:
            times = f" to each of {self._attempts} requests" if self._attempts > 1 else ""
            raise SdoTimeoutError(
                f"no answer within {self._timeout_s * 1e3:.0f} ms{times}, {self._doing(doing)}"
            ) from error
        finally:
            self._reply = None
            if not done:  # timed out or cancelled: the server must not wait for more
                self._abort(abort_codes.TIMEOUT)
        if frame[0] == _ABORT:
            code = int.from_bytes(frame[4:8], "little")
            raise SdoAbortError(code, f"{abort_codes.words(code)}, {self._doing(doing)}")
        return frame

    def _abort(self, code: int) -> None:
        self._send(_HEADER_AND_WORD.pack(_ABORT, *self._object, code))

    def _is_object(self, frame: bytes) -> bool:
        return (frame[1] | frame[2] << 8, frame[3]) == self._object

    def _doing(self, doing: str) -> str:
        index, subindex = self._object
        return f"{doing} 0x{index:04X}:{subindex}"
