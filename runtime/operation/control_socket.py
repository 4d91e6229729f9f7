"""The daemon's control socket: a Unix stream socket, one JSON object a line.

It is looked at once after each tick. `ControlSocket.listen` takes what every client has sent, up to
a bound, and passes emergency stops on at once; `ControlSocket.poll` then takes one other message.
Nothing here waits. Who is at the other end the kernel says; one daemon holds a socket at a time,
and what a killed one left is taken over.
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
from pathlib import Path
from typing import Any, Protocol

from tonus.config.schema.operation import ControlSocket as Settings
from tonus.runtime.errors import DaemonError
from tonus.runtime.operation.socket_client import SocketClient

_CREDENTIALS = struct.Struct("@iII")
"""struct ucred: process, user, group"""
_PEER_GROUPS = 59
"""SO_PEERGROUPS of <asm-generic/socket.h>, which the socket module does not name"""
_MOST_GROUPS = 4 * 256
_ROOT = 0
_SECOND_NS = 1_000_000_000
_CHUNKS_A_LOOK = 16
"""read in one look, beside one of every client: more than a connection's buffer usually holds"""


class ControlSocketError(DaemonError):
    """The socket cannot be opened; the text says why and what to do."""


class Door(Protocol):
    """What lies behind the socket."""

    def answer(self, message: bytes, who: str, *, overtaken: bool = False) -> dict[str, Any] | None:
        """The reply, or None when there will be one later. ``overtaken`` by an emergency stop, a
        command is refused."""

    def later(self) -> dict[str, Any] | None:
        """That reply, as soon as there is one."""

    def emergency(self, who: str) -> None:
        """An emergency stop, in the next tick."""

    def stopped(self) -> dict[str, Any] | None:
        """The reply to emergency stops, as soon as there is one."""

    def watch(self) -> None:
        """Called each time the socket is looked at."""


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
        self._clients: dict[int, SocketClient] = {}
        self._asking: SocketClient | None = None
        """whose command the door has not answered yet"""
        self._stopping: list[SocketClient] = []
        """who have given an emergency stop that the door has not answered yet"""
        self._look = 0
        self._at_ns: int | None = None

    def open_to(self, door: Door) -> None:
        """Answer from now on."""
        self._door = door

    def listen(self, now_ns: int) -> None:
        """Take what has been sent, a bounded piece; emergency stops reach the next tick, whoever
        gave them and whatever waits before them."""
        del now_ns
        door = self._door
        if door is None:
            return
        if self._stopping:
            self._reply_to_stops(door)
        ready = self._poller.poll(0)
        if not ready:
            return
        waiting = [self._clients[each] for each, _ in ready if each in self._clients]
        budget = _CHUNKS_A_LOOK + len(waiting)
        budget = self._receive_all(waiting, door, budget)
        if any(descriptor == self._listener.fileno() for descriptor, _ in ready):
            for _ in range(self._settings.clients + 1):  # as many as can wait to be let in
                connection = self._accept()
                if connection is None:
                    break
                client = self._admit(connection)
                if client is not None:
                    budget = self._receive_all([client], door, budget + 1)

    def _receive_all(self, waiting: list[SocketClient], door: Door, budget: int) -> int:
        """A chunk of each in turn, as long as there are more; what is left of the ``budget``."""
        while waiting and budget > 0:
            budget -= len(waiting)
            waiting = [client for client in waiting if self._receive(client, door)]
        return budget

    def poll(self, now_ns: int) -> None:
        """One message that is no emergency stop; ``now_ns`` is when, on the loop's clock."""
        door = self._door
        if door is None:
            return
        self._look += 1
        self._refill(now_ns)
        door.watch()
        if not self._stopping:
            if self._asking is None:
                self._serve(door)
            elif (reply := door.later()) is not None:
                self._send(self._asking, reply)
                self._asking = None
        for client in list(self._clients.values()):
            self._look_after(client)

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

    def _receive(self, client: SocketClient, door: Door) -> bool:
        """Take a chunk of a client; whether more may be there."""
        try:
            more = client.receive()
        except Exception:
            self._drop(client)  # so that the others are heard in the next look
            raise
        if client.stops:
            door.emergency(client.who)
            self._stopping += [client] * client.stops
            client.stops = 0
            # An older message, a reset say, must not act after it.
            for each in self._clients.values():
                each.overtaken = len(each.lines)
        if client.too_long:
            self._refuse_long(client)
        elif client.ended:
            # What it has sent before is still served.
            self._poller.unregister(client.connection)
        return more and not client.too_long

    def _look_after(self, client: SocketClient) -> None:
        """Tell it what was not kept, and let it go when it has ended and been answered."""
        if client.lost:
            text = f"{client.lost} messages more than {self._settings.backlog} that may wait"
            client.lost = 0
            self._send(client, {"ok": False, "error": f"{text} were not kept", "next": "send less"})
        if client.ended and not (
            client.lines or client is self._asking or client in self._stopping
        ):
            self._drop(client)

    def _reply_to_stops(self, door: Door) -> None:
        reply = door.stopped()
        if reply is not None:
            stopping, self._stopping = self._stopping, []
            for client in stopping:
                self._send(client, reply)

    def _serve(self, door: Door) -> None:
        """Whoever has waited longest among those that may."""
        able = [each for each in self._clients.values() if each.lines and each.tokens >= 1.0]
        if not able:
            return
        client = min(able, key=lambda each: each.turn)
        client.turn = self._look
        client.tokens -= 1.0
        line, overtaken = client.take()
        if len(line) > self._settings.message_bytes:
            self._refuse_long(client)
            return
        reply = door.answer(line, client.who, overtaken=overtaken)
        if reply is None:
            self._asking = client
        else:
            self._send(client, reply)

    def _accept(self) -> socket.socket | None:
        try:
            return self._listener.accept()[0]
        except OSError:  # nobody is there, or is gone before it was let in
            return None

    def _admit(self, connection: socket.socket) -> SocketClient | None:
        """Accept a client that may operate this daemon; refuse and disconnect any other."""
        connection.setblocking(False)
        heard, who = self._peers.heard(connection)
        client = SocketClient(connection, who, self._look, self._settings)
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
            return None
        if len(self._clients) >= self._settings.clients:
            self._drop(min(self._clients.values(), key=lambda each: each.turn))
        self._clients[connection.fileno()] = client
        self._poller.register(connection, select.EPOLLIN)
        return client

    def _refuse_long(self, client: SocketClient) -> None:
        error = f"a message is longer than {self._settings.message_bytes} bytes"
        self._send(client, {"ok": False, "error": error, "next": "send less"})
        self._drop(client)

    def _send(self, client: SocketClient, reply: dict[str, Any]) -> None:
        """One that does not read its replies is let go."""
        data = json.dumps(reply).encode() + b"\n"
        try:
            sent = client.connection.send(data)
        except OSError:
            sent = -1
        if sent != len(data):
            self._drop(client)

    def _drop(self, client: SocketClient) -> None:
        descriptor = client.connection.fileno()
        if self._clients.get(descriptor) is client:
            del self._clients[descriptor]
            with suppress(OSError):  # one that has ended is unregistered already
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
            f"operation.socket: there is no {kind} {name!r}; correct its name, or give its number"
        ) from error


def _user_name(uid: int) -> str | None:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return None
