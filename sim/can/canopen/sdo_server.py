"""The SDO server of CiA 301: expedited and segmented transfers in both directions.

Block transfer is refused as an unknown command, a choice: the drive's EDS shows none. A length that
does not fit has one code, whether too long or not as announced (the drive's list has no other).
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from tonus.sim.devices.objects import (
    COMMAND,
    READ_ONLY,
    TIMEOUT,
    TOGGLE,
    TYPE_LENGTH,
    AbortError,
    ObjectDictionary,
)
from tonus.sim.devices.timers import Timers

_HEADER = struct.Struct("<BHB")
_HEADER_AND_WORD = struct.Struct("<BHBI")
_WORD = struct.Struct("<I")
_LONGEST = 1024
"""Bytes a segmented download may bring."""
_PATIENCE_NS = 1_000_000_000
"""How long a client may be silent in the middle of a transfer."""
_EXPEDITED = 4
_SEGMENT = 7


class SdoServer:
    """One client at a time. `request` returns the answer to a request, or None for silence."""

    def __init__(
        self,
        objects: ObjectDictionary,
        changed: Callable[[int], None],
        timers: Timers,
        send: Callable[[bytes], None],
    ) -> None:
        """``changed`` is told the index of every object written; ``send`` carries what is no
        answer: the abort of a transfer that its client has left."""
        self._objects = objects
        self._changed = changed
        self._timers = timers
        self._send = send
        self._transfer = 0  # number of the present transfer; a timer of an older one is stale
        self._heard_ns = 0
        self.reset()

    def reset(self) -> None:
        """Forget a transfer in progress."""
        self._transfer += 1
        self._object = (0, 0)
        self._upload: bytes | None = None
        self._download: bytearray | None = None
        self._announced: int | None = None
        self._toggle = 0

    def request(self, data: bytes) -> bytes | None:
        """``data``: 8 bytes. A client's abort is obeyed and not answered."""
        command = data[0]
        service = command >> 5
        self._heard_ns = self._timers.now_ns
        if service == 4:
            self.reset()
            return None
        try:
            if service == 1:
                return self._begin_download(command, data)
            if service == 2:
                return self._begin_upload(data)
            if service == 0:
                return self._download_segment(command, data)
            if service == 3:
                return self._upload_segment(command)
            # Block transfer is not served.
            self._object = _HEADER.unpack_from(data)[1:]
            raise AbortError(COMMAND)
        except AbortError as abort:
            return self._abort(abort.code)

    def _abort(self, code: int) -> bytes:
        index, subindex = self._object
        self.reset()
        return _HEADER_AND_WORD.pack(0x80, index, subindex, code)

    def _wait(self) -> None:
        """Expect the next segment in time."""
        transfer = self._transfer

        def look(at_ns: int) -> None:
            if transfer != self._transfer or (self._upload is None and self._download is None):
                return
            due_ns = self._heard_ns + _PATIENCE_NS
            if at_ns < due_ns:
                self._timers.call_at(due_ns, look)
            else:
                self._send(self._abort(TIMEOUT))

        self._timers.call_at(self._heard_ns + _PATIENCE_NS, look)

    def _begin_upload(self, data: bytes) -> bytes:
        _, index, subindex = _HEADER.unpack_from(data)
        self.reset()
        self._object = (index, subindex)
        value = self._objects.read(index, subindex)
        if 0 < len(value) <= _EXPEDITED:
            head = 0x43 | (_EXPEDITED - len(value)) << 2
            return _HEADER.pack(head, index, subindex) + value.ljust(_EXPEDITED, b"\0")
        self._upload = value
        self._wait()
        return _HEADER_AND_WORD.pack(0x41, index, subindex, len(value))

    def _upload_segment(self, command: int) -> bytes:
        if self._upload is None:
            raise AbortError(COMMAND)
        toggle = command >> 4 & 1
        if toggle != self._toggle:
            raise AbortError(TOGGLE)
        part, self._upload = self._upload[:_SEGMENT], self._upload[_SEGMENT:]
        last = not self._upload
        self._toggle ^= 1
        if last:
            self._upload = None
        head = toggle << 4 | (_SEGMENT - len(part)) << 1 | last
        return bytes((head,)) + part.ljust(_SEGMENT, b"\0")

    def _begin_download(self, command: int, data: bytes) -> bytes:
        _, index, subindex = _HEADER.unpack_from(data)
        self.reset()
        self._object = (index, subindex)
        sized = bool(command & 1)
        if command & 2:
            length = _EXPEDITED - (command >> 2 & 3) if sized else self._size(index, subindex)
            self._write(data[_EXPEDITED : _EXPEDITED + length])
        else:
            if self._objects.find(index, subindex).access in ("ro", "const"):
                raise AbortError(READ_ONLY)
            self._announced = _WORD.unpack_from(data, 4)[0] if sized else None
            if self._announced is not None and self._announced > _LONGEST:
                raise AbortError(TYPE_LENGTH)
            self._download = bytearray()
            self._wait()
        return _HEADER.pack(0x60, index, subindex) + bytes(4)

    def _size(self, index: int, subindex: int) -> int:
        """What an expedited download of unstated length means."""
        return min(self._objects.find(index, subindex).kind.size or _EXPEDITED, _EXPEDITED)

    def _download_segment(self, command: int, data: bytes) -> bytes:
        if self._download is None:
            raise AbortError(COMMAND)
        toggle = command >> 4 & 1
        if toggle != self._toggle:
            raise AbortError(TOGGLE)
        self._toggle ^= 1
        self._download += data[1 : 8 - (command >> 1 & 7)]
        if len(self._download) > _LONGEST:
            raise AbortError(TYPE_LENGTH)
        if command & 1:
            if self._announced is not None and self._announced != len(self._download):
                raise AbortError(TYPE_LENGTH)
            value = bytes(self._download)
            self._download = None
            self._write(value)
        return bytes((0x20 | toggle << 4,)) + bytes(7)

    def _write(self, value: bytes) -> None:
        self._objects.write(*self._object, value)
        self._changed(self._object[0])
