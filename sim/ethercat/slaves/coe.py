"""CANopen over EtherCAT: the SDO server of a slave (ETG.1000.6), and its emergencies."""

from __future__ import annotations

import struct
from collections.abc import Callable

from tonus.sim.devices.objects import (
    COMMAND,
    LENGTH_LOW,
    NO_SUBINDEX,
    READ_ONLY,
    TOGGLE,
    TYPE_LENGTH,
    WRITE_ONLY,
    AbortError,
    Kind,
    ObjectDictionary,
)
from tonus.sim.ethercat.slaves import information

COMPLETE_ACCESS = 0x06010004
"""The EPOS4's list of abort codes has it: the object cannot be accessed as a whole."""
_EMERGENCY, _REQUEST, _RESPONSE, _INFORMATION = 1, 2, 3, 8
_SDO = struct.Struct("<HBHB")
_SDO_WORD = struct.Struct("<HBHBI")
_ERROR = struct.Struct("<HB5x")
_HEAD = 2
_EXPEDITED = 4
_LEAST_SEGMENT = 7
_LONGEST = 4096
"""Bytes a segmented download may bring."""
_DOWNLOAD_SEGMENT, _DOWNLOAD, _UPLOAD, _UPLOAD_SEGMENT, _ABORT = range(5)


def emergency(code: int, register: int) -> bytes:
    """Content of a message that tells of an error."""
    return struct.pack("<H", _EMERGENCY << 12) + _ERROR.pack(code, register)


class Coe:
    """One client at a time. ``size`` is the mailbox's, ``complete`` whether objects can be accessed
    as a whole, ``refuse`` (index, subindex) the abort code of a test that wants one, or 0."""

    def __init__(
        self,
        objects: ObjectDictionary,
        size: int,
        *,
        complete: bool,
        refuse: Callable[[int, int], int],
    ) -> None:
        self._objects = objects
        self._room = size - 6 - _HEAD
        self._complete = complete
        self._refuse = refuse
        self.reset()

    def reset(self) -> None:
        """Forget a transfer in progress."""
        self._object = (0, 0)
        self._whole = False
        self._upload: bytes | None = None
        self._download: bytearray | None = None
        self._announced = 0
        self._toggle = 0

    def serve(self, message: bytes, now_ns: int) -> list[bytes]:
        """Contents of the answers to a message, CoE header included."""
        del now_ns
        service = message[1] >> 4
        if service == _INFORMATION:
            return information.serve(self._objects, message, self._room + _HEAD)
        if service != _REQUEST or len(message) < _HEAD + 1:
            return []
        command = message[_HEAD]
        if command >> 5 in (_DOWNLOAD, _UPLOAD):
            if len(message) < _SDO.size + 4:
                message = message.ljust(_SDO.size + 4, b"\0")
            _, _, index, subindex = _SDO.unpack_from(message)
            self.reset()
            self._object = (index, subindex)
        try:
            return self._request(command, message)
        except AbortError as abort:
            index, subindex = self._object
            self.reset()
            return [_SDO_WORD.pack(_REQUEST << 12, 0x80, index, subindex, abort.code)]

    def _request(self, command: int, message: bytes) -> list[bytes]:
        what = command >> 5
        if what == _ABORT:
            self.reset()
            return []
        if what == _UPLOAD:
            return [self._begin_upload(command)]
        if what == _DOWNLOAD:
            return [self._begin_download(command, message)]
        if what == _UPLOAD_SEGMENT:
            return [self._upload_segment(command)]
        if what == _DOWNLOAD_SEGMENT:
            return [self._download_segment(command, message)]
        raise AbortError(COMMAND)

    def _check(self, command: int) -> None:
        """Whether access to the present object is possible at all."""
        index, subindex = self._object
        code = self._refuse(index, subindex)
        if code:
            raise AbortError(code)
        self._whole = bool(command & 0x10)
        if self._whole:
            if not self._complete:
                raise AbortError(COMPLETE_ACCESS)
            self._objects.find(index, subindex)
            if subindex > 1:
                raise AbortError(NO_SUBINDEX)

    # -- upload ----------------------------------------------------------------------------------

    def _begin_upload(self, command: int) -> bytes:
        self._check(command)
        index, subindex = self._object
        if self._whole:
            value = self._read_whole(index, subindex)
        else:
            value = self._objects.read(index, subindex)
        if 0 < len(value) <= _EXPEDITED:
            head = 0x43 | (_EXPEDITED - len(value)) << 2 | 0x10 * self._whole
            return self._answer(head) + value.ljust(_EXPEDITED, b"\0")
        room = self._room - 8
        part, rest = value[:room], value[room:]
        if rest:
            self._upload = rest
        head = 0x41 | 0x10 * self._whole
        return self._answer(head) + struct.pack("<I", len(value)) + part

    def _answer(self, head: int) -> bytes:
        index, subindex = self._object
        return _SDO.pack(_RESPONSE << 12, head, index, subindex)

    def _upload_segment(self, command: int) -> bytes:
        if self._upload is None:
            raise AbortError(COMMAND)
        toggle = self._turn(command)
        room = self._room - 1
        part, rest = self._upload[:room], self._upload[room:]
        self._upload = rest or None
        unused = max(_LEAST_SEGMENT - len(part), 0)
        head = toggle << 4 | unused << 1 | (not rest)
        part = part.ljust(_LEAST_SEGMENT, b"\0")
        return struct.pack("<HB", _RESPONSE << 12, head) + part

    def _turn(self, command: int) -> int:
        toggle = command >> 4 & 1
        if toggle != self._toggle:
            raise AbortError(TOGGLE)
        self._toggle ^= 1
        return toggle

    # -- download --------------------------------------------------------------------------------

    def _begin_download(self, command: int, message: bytes) -> bytes:
        self._check(command)
        if command & 2:
            length = _EXPEDITED - (command >> 2 & 3) if command & 1 else self._length()
            self._write(message[_SDO.size : _SDO.size + length])
        else:
            if not self._whole and self._objects.find(*self._object).access in ("ro", "const"):
                raise AbortError(READ_ONLY)
            (total,) = struct.unpack_from("<I", message, _SDO.size)
            part = message[_SDO_WORD.size :]
            if total > _LONGEST or len(part) > total:
                raise AbortError(TYPE_LENGTH)
            if len(part) == total:
                self._write(part)
            else:
                self._announced = total
                self._download = bytearray(part)
        return self._answer(0x60 | 0x10 * self._whole) + bytes(4)

    def _length(self) -> int:
        """What an expedited download of unstated length means."""
        return min(self._objects.find(*self._object).kind.size or _EXPEDITED, _EXPEDITED)

    def _download_segment(self, command: int, message: bytes) -> bytes:
        if self._download is None:
            raise AbortError(COMMAND)
        toggle = self._turn(command)
        data = message[_HEAD + 1 :]
        if len(data) <= _LEAST_SEGMENT:
            data = data[: _LEAST_SEGMENT - (command >> 1 & 7)]
        self._download += data
        last = command & 1
        if len(self._download) > self._announced:
            raise AbortError(TYPE_LENGTH)
        if last:
            if len(self._download) < self._announced:
                raise AbortError(LENGTH_LOW)
            value, self._download = bytes(self._download), None
            self._write(value)
        return struct.pack("<HB", _RESPONSE << 12, 0x20 | toggle << 4) + bytes(7)

    def _write(self, value: bytes) -> None:
        index, subindex = self._object
        if self._whole:
            self._write_whole(index, subindex, value)
        else:
            self._objects.write(index, subindex, value)

    # -- complete access -------------------------------------------------------------------------

    def _parts(self, index: int) -> list[int]:
        """Subindices of an object behind 0, in order."""
        return sorted(sub for found, sub in self._objects.entries if found == index and sub)

    def _read_whole(self, index: int, first: int) -> bytes:
        objects = self._objects
        value = b"" if first else objects.read(index, 0).ljust(2, b"\0")
        count = objects.number(index, 0) if self._parts(index) else 0
        for subindex in self._parts(index)[:count]:
            if objects.find(index, subindex).access == "wo":
                raise AbortError(WRITE_ONLY)
            value += objects.read(index, subindex)
        return value

    def _write_whole(self, index: int, first: int, value: bytes) -> None:
        """Where subindex 0 counts what is used (PDO objects), it is 0 in between."""
        objects = self._objects
        head = objects.find(index, 0)
        counted = head.access == "rw"
        count = None
        at = 0
        if first == 0:
            if len(value) < 2:
                raise AbortError(LENGTH_LOW)
            count, at = value[0], 2
        before = head.value
        if counted:
            objects.write(index, 0, b"\0")
        try:
            for subindex in self._parts(index):
                kind = objects.find(index, subindex).kind
                if at >= len(value):
                    break
                size = kind.size if kind is not Kind.STRING else len(value) - at
                objects.write(index, subindex, value[at : at + size])
                at += size
            if at < len(value):
                raise AbortError(TYPE_LENGTH)
            if counted and count is not None:
                objects.write(index, 0, bytes((count,)))
            elif counted:
                head.value = before
        except AbortError:
            if counted and head.value != before:
                # The list stays empty: half of one is worse than none.
                head.value = 0
            raise
