"""One connection to the control socket: what it has sent, as whole messages, and its emergency
stops apart from them, which wait behind nothing."""

from __future__ import annotations

import re
import socket
from collections import deque

from tonus.config.schema.operation import ControlSocket as Settings

CHUNK_BYTES = 16384
"""taken from a connection at once"""
_WORD = b'"estop"'
_STOP = re.compile(rb'^[ \t]*\{[ \t]*"op"[ \t]*:[ \t]*"estop"[ \t]*\}[ \t\r]*\n', re.MULTILINE)
"""Spelt otherwise, it is a message as any other."""
_MOST_MENTIONS = 64
"""of the word in a chunk that are looked at one by one; more are one emergency stop, unread"""
_NEWLINE = b"\n"


class SocketClient:
    """`receive` what has come; `lines` are the messages that wait for their turn."""

    def __init__(self, connection: socket.socket, who: str, turn: int, settings: Settings) -> None:
        self.connection, self.who = connection, who
        self.tokens = float(settings.burst)
        self.turn = turn
        """number of the last look that served it"""
        self.lines: deque[bytes] = deque()
        self.overtaken = 0
        """how many of them an emergency stop came after"""
        self.stops = 0
        """emergency stops that nobody has taken"""
        self.lost = 0
        """messages that did not fit in `lines`"""
        self.ended = False
        """nothing more will come"""
        self._tail = b""
        self._settings = settings

    @property
    def too_long(self) -> bool:
        """What has come of an unfinished message is more than one may have."""
        return len(self._tail) > self._settings.message_bytes

    def receive(self) -> bool:
        """Take a chunk; whether more may be there. Never waits."""
        try:
            came = self.connection.recv(CHUNK_BYTES)
        except BlockingIOError:
            return False
        except OSError:
            came = b""
        if not came:
            self.ended = True
            return False
        self._sort(came)
        return len(came) == CHUNK_BYTES

    def _sort(self, came: bytes) -> None:
        data = self._tail + came
        end = data.rfind(_NEWLINE) + 1
        whole, self._tail = data[:end], data[end:]
        mentions = whole.count(_WORD)
        if mentions > _MOST_MENTIONS:
            self.stops += 1
        elif mentions:
            whole, found = _STOP.subn(b"", whole)
            self.stops += found
        *kept, rest = whole.split(_NEWLINE, self._settings.backlog - len(self.lines))
        self.lines += kept
        self.lost += rest.count(_NEWLINE)

    def take(self) -> tuple[bytes, bool]:
        """The next message, and whether an emergency stop came after it."""
        overtaken = self.overtaken > 0
        self.overtaken -= overtaken
        return self.lines.popleft(), overtaken
