"""The mailbox of a slave: messages, their counters, the queue behind the send mailbox."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from typing import Protocol

_HEADER = struct.Struct("<HHBB")
HEADER_BYTES = _HEADER.size
_ERROR, COE = 0, 3
_UNSUPPORTED, _TOO_SHORT, _SIZE = 2, 6, 8
_REPLY_TO_ERROR = 1
_QUEUE = 32
"""Messages that wait for the master; beyond, an emergency is thrown away."""


class Box(Protocol):
    """Where the messages for the master go."""

    def post(self, number: int, message: bytes) -> bool: ...
    def acknowledge_repeat(self) -> None: ...


class Mailbox:
    """``serve`` takes what came in a CoE message and returns the answers' contents, any number."""

    def __init__(self, box: Box, serve: Callable[[bytes, int], list[bytes]], size: int) -> None:
        self._box = box
        self._serve = serve
        self._size = size
        self._waiting: deque[bytes] = deque()
        self._last = b""
        self._sent = 0
        self._heard = 0
        self.reset()

    def reset(self) -> None:
        """A new connection: masters begin each with the counter 1."""
        self._waiting.clear()
        self._last = b""
        self._sent = 0
        self._heard = 0

    def received(self, box: bytes, now_ns: int) -> None:
        """A whole mailbox that the master has written."""
        if len(box) < HEADER_BYTES:
            return
        length, _, _, kind = _HEADER.unpack_from(box)
        counter = kind >> 4 & 7
        if counter and counter == self._heard:
            return  # the same once more, because our answer got lost
        self._heard = counter
        protocol = kind & 0x0F
        content = box[HEADER_BYTES : HEADER_BYTES + length]
        if length > self._size - HEADER_BYTES:
            self._refuse(_SIZE)
        elif protocol == COE:
            if length < 2:
                self._refuse(_TOO_SHORT)
                return
            for answer in self._serve(content, now_ns):
                self.send(answer)
        elif protocol != _ERROR:
            self._refuse(_UNSUPPORTED)

    def _refuse(self, detail: int) -> None:
        self._enqueue(struct.pack("<HH", _REPLY_TO_ERROR, detail), _ERROR)

    def send(self, content: bytes) -> None:
        """Queue a CoE message."""
        self._enqueue(content, COE)

    def _enqueue(self, content: bytes, protocol: int) -> None:
        if len(self._waiting) >= _QUEUE:
            return
        self._sent = self._sent % 7 + 1
        kind = protocol | self._sent << 4
        self._waiting.append(_HEADER.pack(len(content), 0, 0, kind) + content)
        self.next()

    def next(self) -> None:
        """Post the next message, if the last has been read."""
        if self._waiting and self._box.post(1, self._waiting[0]):
            self._last = self._waiting.popleft()

    def repeat(self) -> None:
        """The last message again if it was read and lost; one that is unread stays where it is."""
        if self._last:
            self._box.post(1, self._last)
        self._box.acknowledge_repeat()
