"""The daemon's control socket: a Unix stream socket, one JSON object a line.

It is looked at once after each tick and does one bounded thing then: let one client in, and take
one message. Nothing here waits, and no client can make it do more. Who is at the other end the
kernel says; one daemon holds a socket at a time, and what a killed one left is taken over.
"""

from __future__ import annotations

import fcntl
import grp
import json
import os
import pwd
import select
import socket
import struct
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from config.schema.operation import ControlSocket as Settings
from runtime.errors import DaemonError

_CREDENTIALS = struct.Struct("@iII")
"""struct ucred: process, user, group"""
_PEER_GROUPS = 59
"""SO_PEERGROUPS of <asm-generic/socket.h>, which the socket module does not name"""
_MOST_GROUPS = 4 * 256
_ROOT = 0
_SECOND_NS = 1_000_000_000
_NEWLINE = b"\n"


class ControlSocketError(DaemonError):
    """The socket cannot be opened; the text says why and what to do."""


class Door(Protocol):
    """What lies behind the socket."""

    def answer(self, message: bytes, who: str) -> dict[str, Any] | None:
        """The reply, or None when there will be one later."""

    def later(self) -> dict[str, Any] | None:
        """That reply, as soon as there is one."""

    def watch(self) -> None:
        """Called each time the socket is looked at."""


@dataclass
class _Client:
    connection: socket.socket
    who: str
    tokens: float
    buffer: bytearray = field(default_factory=bytearray)
    turn: int = 0
    """number of the last look that served it"""


class Peers:
    """Who is heard: root, the daemon's own user, and those the configuration names."""

    def __init__(self, settings: Settings) -> None:
        """Raises `ControlSocketError` for a name that is nobody's."""
        self._users = {os.geteuid(), _ROOT}
        self._groups: set[int] = set()
        for name in settings.users:
            self._users.add(_looked_up(name, "user", lambda known: pwd.getpwnam(known).pw_uid))
        for name in settings.groups:
            self._groups.add(_group(name))
        # Names are looked up now, since that reads files.
        self._names = {uid: _user_name(uid) for uid in self._users}

    def heard(self, connection: socket.socket) -> tuple[bool, str]:
        """Whether the one at the other end is, and who that is."""
        data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        pid, uid, gid = _CREDENTIALS.unpack(data)
        name = self._names.get(uid)
        who = f"{name} (uid {uid}, pid {pid})" if name else f"uid {uid}, pid {pid}"
        if uid in self._users or gid in self._groups:
            return True, who
        return bool(self._groups & set(_supplementary(connection))), who


class ControlSocket:
    """Opens and holds ``path``. Raises `ControlSocketError` when another daemon holds it, or the
    file cannot be made."""

    def __init__(self, path: Path, settings: Settings) -> None:
        self.path = path
        self._settings, self._peers = settings, Peers(settings)
        self._lock = _hold(path)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            path.unlink(missing_ok=True)  # ours alone: the lock says so
            mode = int(settings.mode, 8)
            # Before it has a name, so that there is no moment at which others could come in.
            os.fchmod(self._listener.fileno(), 0o600)
            self._listener.bind(str(path))
            if settings.group is not None:
                os.chown(path, -1, _group(settings.group))
            path.chmod(mode)
            self._listener.listen(settings.clients)
        except OSError as error:
            self._listener.close()
            os.close(self._lock)
            text = error.strerror or str(error)
            raise ControlSocketError(
                f"control socket {path}: {text}; name another place in operation.socket.path"
            ) from error
        self._listener.setblocking(False)
        self._door: Door | None = None
        self._poller = select.epoll()
        self._poller.register(self._listener, select.EPOLLIN)
        self._clients: dict[int, _Client] = {}
        self._asking: _Client | None = None
        """whose command the door has not answered yet"""
        self._look = 0
        self._listener_turn = 0
        self._at_ns: int | None = None

    def open_to(self, door: Door) -> None:
        """Answer from now on."""
        self._door = door

    def poll(self, now_ns: int) -> None:
        """One bounded piece of service; ``now_ns`` is when, on the loop's clock."""
        door = self._door
        if door is None:
            return
        self._look += 1
        door.watch()
        if self._asking is not None:
            reply = door.later()
            if reply is None:
                return
            self._send(self._asking, reply)
            self._asking = None
            return
        ready = self._poller.poll(0)
        if not ready and not any(client.buffer for client in self._clients.values()):
            self._refill(now_ns)
            return
        self._refill(now_ns)
        self._serve([descriptor for descriptor, _ in ready], door)

    def close(self) -> None:
        """Let go of everything; the file goes first."""
        self.path.unlink(missing_ok=True)
        for client in list(self._clients.values()):
            self._drop(client)
        self._poller.close()
        self._listener.close()
        os.close(self._lock)

    def _refill(self, now_ns: int) -> None:
        passed = 0 if self._at_ns is None else now_ns - self._at_ns
        self._at_ns = now_ns
        gain, most = passed * self._settings.rate_hz / _SECOND_NS, float(self._settings.burst)
        for client in self._clients.values():
            client.tokens = min(client.tokens + gain, most)

    def _serve(self, ready: list[int], door: Door) -> None:
        """Whoever has waited longest among those that may."""
        turns = [
            (client.turn, descriptor)
            for descriptor, client in self._clients.items()
            if client.tokens >= 1.0 and (descriptor in ready or _NEWLINE in client.buffer)
        ]
        if self._listener.fileno() in ready:
            turns.append((self._listener_turn, self._listener.fileno()))
        if not turns:
            return
        _, descriptor = min(turns)
        if descriptor == self._listener.fileno():
            self._listener_turn = self._look
            self._accept(door)
        else:
            client = self._clients[descriptor]
            client.turn = self._look
            self._hear(client, door)

    def _accept(self, door: Door) -> None:
        """Let one in, and hear it if it has spoken already: an emergency stop does not wait."""
        try:
            connection, _ = self._listener.accept()
        except OSError:  # it was gone before it was let in
            return
        connection.setblocking(False)
        heard, who = self._peers.heard(connection)
        client = _Client(connection, who, float(self._settings.burst), turn=self._look)
        if not heard:
            self._send(
                client,
                {
                    "ok": False,
                    "error": f"{who} may not operate this daemon",
                    "next": "ask for a place in operation.socket.users or groups",
                },
            )
            connection.close()
            return
        if len(self._clients) >= self._settings.clients:
            self._drop(min(self._clients.values(), key=lambda each: each.turn))
        self._clients[connection.fileno()] = client
        self._poller.register(connection, select.EPOLLIN)
        self._hear(client, door)

    def _hear(self, client: _Client, door: Door) -> None:
        """At most one message, from what is there."""
        most = self._settings.message_bytes
        if _NEWLINE not in client.buffer:
            try:
                came = client.connection.recv(most + 1 - len(client.buffer))
            except BlockingIOError:
                return
            except OSError:
                came = b""
            if not came:
                self._drop(client)
                return
            client.buffer += came
        line, newline, rest = client.buffer.partition(_NEWLINE)
        if not newline:
            if len(client.buffer) > most:
                error = f"a message is longer than {most} bytes"
                self._send(client, {"ok": False, "error": error, "next": "send less"})
                self._drop(client)
            return
        client.buffer = rest
        client.tokens -= 1.0
        reply = door.answer(bytes(line), client.who)
        if reply is None:
            self._asking = client
        else:
            self._send(client, reply)

    def _send(self, client: _Client, reply: dict[str, Any]) -> None:
        """One that does not read its replies is let go."""
        data = json.dumps(reply).encode() + _NEWLINE
        try:
            sent = client.connection.send(data)
        except OSError:
            sent = -1
        if sent != len(data):
            self._drop(client)

    def _drop(self, client: _Client) -> None:
        descriptor = client.connection.fileno()
        if self._clients.pop(descriptor, None) is not None:
            self._poller.unregister(descriptor)
        client.connection.close()


def _hold(path: Path) -> int:
    """A lock that ends with this process, however it ends."""
    lock = path.with_name(f"{path.name}.lock")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise ControlSocketError(
            f"control socket {path}: {lock.name}: {error.strerror}; "
            "set TONUS_RUNTIME_DIR to a folder of your own"
        ) from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        pid = os.pread(descriptor, 32, 0).decode(errors="replace").strip() or "unknown"
        os.close(descriptor)
        raise ControlSocketError(
            f"control socket {path}: a daemon, process {pid}, has it; "
            "end that one, or name another socket with --socket"
        ) from error
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
    return descriptor


def _supplementary(connection: socket.socket) -> Iterable[int]:
    with suppress(OSError):
        data = connection.getsockopt(socket.SOL_SOCKET, _PEER_GROUPS, _MOST_GROUPS)
        return struct.unpack(f"{len(data) // 4}I", data)
    return ()


def _group(name: str) -> int:
    return _looked_up(name, "group", lambda known: grp.getgrnam(known).gr_gid)


def _looked_up(name: str, kind: str, find: Any) -> int:
    if name.isdecimal():
        return int(name)
    try:
        return int(find(name))
    except KeyError as error:
        raise ControlSocketError(
            f"operation.socket: there is no {kind} {name!r}; mend its name, or give its number"
        ) from error


def _user_name(uid: int) -> str | None:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return None
