"""The mailbox and the SDO client of the deterministic master (ETG.1000.6), one slave each.

Frames may be lost. A mailbox write is sent again as it was, with the same counter, by which the
slave knows it; a lost mailbox read is asked for with the repeat request of the sync manager.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable
from typing import Protocol

from tonus.drivers.cia301 import abort_codes
from tonus.drivers.errors import SdoAbortError, SdoError, SdoTimeoutError
from tonus.drivers.ethercat.frames import Answer, Command, Datagram

_HEADER = struct.Struct("<HHBB")  # length, address, channel and priority, type and counter
_ERROR_TYPE, _COE_TYPE = 0, 3
_EMERGENCY, _REQUEST, _RESPONSE = 1, 2, 3
_COUNTERS = 7
_FULL = 0x08
_REPEAT = 0x02
_SM0_STATUS, _SM1_STATUS, _SM1_ACTIVATE = 0x0805, 0x080D, 0x080E
_POLL_S = 1e-3
_ABORT = 0x80
_TOGGLE = 0x10
_EXPEDITED_BYTES = 4
_SEGMENT_BYTES = 7
"""of data that a segment holds at least, however little of it counts"""

_MAILBOX_ERRORS = {
    1: "syntax of the header",
    2: "protocol not supported",
    3: "wrong channel",
    4: "service not supported",
    5: "invalid header",
    6: "too short",
    7: "no memory",
    8: "wrong size",
}


class Registers(Protocol):
    """Datagrams to one slave; a frame that is lost is sent again unless it must not be."""

    async def read(self, register: int, size: int, *, again: bool = True) -> Answer | None:
        """None if no frame came back."""

    async def write(self, register: int, data: bytes) -> Answer | None: ...


class Mailbox:
    """Requests to one slave and the answers to them."""

    def __init__(
        self,
        registers: Registers,
        write_at: tuple[int, int],
        read_at: tuple[int, int],
        timeout_s: float,
        on_emergency: Callable[[bytes], None],
    ) -> None:
        """``write_at`` and ``read_at``: start and length of the two mailboxes."""
        self._registers = registers
        self._write_at, self._read_at = write_at, read_at
        self._timeout_s = timeout_s
        self._on_emergency = on_emergency
        self._counter = 0
        self._lock = asyncio.Lock()

    @property
    def capacity(self) -> int:
        """Bytes behind the header."""
        return self._write_at[1] - _HEADER.size

    async def ask(self, body: bytes) -> bytes:
        """Send a CoE message and return the next that is no emergency. Raises `SdoError`."""
        loop = asyncio.get_running_loop()
        end = loop.time() + self._timeout_s
        async with self._lock:
            await self._put(body, end)
            while True:
                kind, answer = await self._get(end)
                if kind == _ERROR_TYPE:
                    detail = int.from_bytes(answer[2:4], "little")
                    words = _MAILBOX_ERRORS.get(detail, f"code {detail}")
                    raise SdoError(f"the mailbox refused: {words}")
                if kind != _COE_TYPE or len(answer) < 2:
                    continue
                if answer[1] >> 4 == _EMERGENCY:
                    self._on_emergency(answer[2:])
                    continue
                return answer

    async def _put(self, body: bytes, end: float) -> None:
        self._counter = self._counter % _COUNTERS + 1
        start, size = self._write_at
        header = _HEADER.pack(len(body), 0, 0, _COE_TYPE | self._counter << 4)
        data = (header + body).ljust(size, b"\0")
        while True:
            answer = await self._registers.write(start, data)
            if answer is not None and answer.counter:
                return
            await self._wait(end, "its mailbox accepts no message")

    async def _get(self, end: float) -> tuple[int, bytes]:
        start, size = self._read_at
        while True:
            status = await self._registers.read(_SM1_STATUS, 1)
            if status is None or not status.counter or not status.data[0] & _FULL:
                await self._wait(end, "no answer in its mailbox")
                continue
            answer = await self._registers.read(start, size, again=False)
            if answer is None:
                await self._repeat(end)
            elif answer.counter:
                length, _, _, kind = _HEADER.unpack_from(answer.data)
                return kind & 0xF, answer.data[_HEADER.size : _HEADER.size + length]

    async def _repeat(self, end: float) -> None:
        """The slave has given its message away, but nobody got it."""
        before = await self._registers.read(_SM1_ACTIVATE, 2)
        if before is None:
            return
        wanted = before.data[0] ^ _REPEAT
        await self._registers.write(_SM1_ACTIVATE, bytes((wanted,)))
        while True:
            now = await self._registers.read(_SM1_ACTIVATE, 2)
            if now is not None and now.counter and not (now.data[1] ^ wanted) & _REPEAT:
                return
            await self._wait(end, "it does not repeat the answer")

    async def _wait(self, end: float, what: str) -> None:
        if asyncio.get_running_loop().time() >= end:
            raise SdoTimeoutError(what)
        await asyncio.sleep(_POLL_S)


class Objects:
    """SDO access over a mailbox: expedited, and in segments both ways."""

    def __init__(self, mailbox: Mailbox) -> None:
        self._mailbox = mailbox

    async def read(self, index: int, subindex: int) -> bytes:
        answer = await self._sdo(struct.pack("<BHB4x", 0x40, index, subindex), index, subindex)
        flags = answer[0]
        if flags & 0x02:
            size = _EXPEDITED_BYTES - (flags >> 2 & 3) if flags & 1 else _EXPEDITED_BYTES
            return answer[4 : 4 + size]
        total = int.from_bytes(answer[4:8], "little")
        data = answer[8:]
        toggle = 0
        while len(data) < total:
            request = bytes((0x60 | toggle,)).ljust(8, b"\0")
            part = await self._sdo(request, index, subindex, segment=True)
            if part[0] & _TOGGLE != toggle:
                raise SdoError(f"0x{index:04X}:{subindex}: a segment came twice")
            count = len(part) - 1
            if count == _SEGMENT_BYTES:
                count -= part[0] >> 1 & 7
            data += part[1 : 1 + count]
            toggle ^= _TOGGLE
            if part[0] & 1:
                break
        if len(data) != total:
            raise SdoError(f"0x{index:04X}:{subindex}: {len(data)} bytes came of {total}")
        return data

    async def write(self, index: int, subindex: int, data: bytes) -> None:
        if 0 < len(data) <= _EXPEDITED_BYTES:
            flags = 0x23 | (_EXPEDITED_BYTES - len(data)) << 2
            request = struct.pack("<BHB", flags, index, subindex) + data.ljust(4, b"\0")
            await self._sdo(request, index, subindex)
            return
        room = self._mailbox.capacity - 2 - 8
        request = struct.pack("<BHBI", 0x21, index, subindex, len(data)) + data[:room]
        await self._sdo(request, index, subindex)
        rest = data[room:]
        room = self._mailbox.capacity - 2 - 1
        toggle = 0
        while rest:
            part, rest = rest[:room], rest[room:]
            unused = max(0, _SEGMENT_BYTES - len(part))
            head = toggle | unused << 1 | (0 if rest else 1)
            request = bytes((head,)) + part.ljust(_SEGMENT_BYTES, b"\0")
            await self._sdo(request, index, subindex, segment=True)
            toggle ^= _TOGGLE

    async def _sdo(
        self, request: bytes, index: int, subindex: int, *, segment: bool = False
    ) -> bytes:
        """The SDO part of the answer. Raises `SdoError`."""
        where = f"0x{index:04X}:{subindex}"
        try:
            while True:
                message = struct.pack("<H", _REQUEST << 12) + request
                answer = await self._mailbox.ask(message)
                service, sdo = answer[1] >> 4, answer[2:]
                if service not in (_REQUEST, _RESPONSE) or len(sdo) < 8:
                    raise SdoError(f"{where}: an answer that is none of SDO")
                named = struct.unpack_from("<HB", sdo, 1)
                if sdo[0] == _ABORT:
                    code = int.from_bytes(sdo[4:8], "little")
                    raise SdoAbortError(code, f"{where}: {abort_codes.words(code)}")
                if segment or named == (index, subindex):
                    return sdo
                raise SdoError(f"{where}: the answer is of 0x{named[0]:04X}:{named[1]}")
        except SdoTimeoutError as error:
            raise SdoTimeoutError(f"{where}: {error}") from error


def fixed(command: Command, address: int, register: int, data: bytes) -> Datagram:
    """A datagram to a station."""
    return Datagram(command, address | register << 16, data)
