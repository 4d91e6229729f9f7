"""The door as a Unix datagram socket, ``lab.sock``: one request a datagram, one reply.

Only its owner is heard: the file belongs to it alone, and the kernel tells of every datagram who
sent it. Nothing here waits, so a client that does not read its replies loses them.
"""

from __future__ import annotations

import asyncio
import json
import os
import socket
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from tonus.sim.errors import LabError
from tonus.sim.lab.door import REQUEST_BYTES, Door, refusal

_CREDENTIALS = struct.Struct("@iII")
"""struct ucred: process, user, group"""
_ANCILLARY_BYTES = socket.CMSG_SPACE(_CREDENTIALS.size)
_ROOT = 0
_UNREAD_BYTES = 1 << 20
"""of replies; the kernel may grant less"""


class DoorSocket:
    """Opens ``path``, which must be free. ``before`` and ``after`` are called round each request:
    to bring the lab to the present, and to hand out what came of it. Raises `LabError`.
    """

    def __init__(
        self,
        door: Door,
        path: Path,
        before: Callable[[], object],
        after: Callable[[], object],
    ) -> None:
        self._door = door
        self._path = path
        self._before = before
        self._after = after
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        # What a client leaves unread is charged to us, and would in the end leave no room for
        # replies to others; the kernel limits it to net.unix.max_dgram_qlen of them a client.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNREAD_BYTES)
        # Before it has a name, so that there is no moment at which others could come in.
        os.fchmod(self._socket.fileno(), 0o600)
        try:
            self._socket.bind(str(path))
        except OSError as error:
            self._socket.close()
            raise LabError(f"{path} cannot be opened: {error}") from error
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._socket, self._receive)

    def poll(self, now_ns: int) -> None:
        """Answer one request, if there is one: in virtual time, whose loop watches no sockets."""
        del now_ns
        self._receive()

    def close(self) -> None:
        self._loop.remove_reader(self._socket)
        self._socket.close()
        self._path.unlink(missing_ok=True)

    def _receive(self) -> None:
        try:
            request, ancillary, _, client = self._socket.recvmsg(
                REQUEST_BYTES + 1, _ANCILLARY_BYTES
            )
        except BlockingIOError:
            return
        user = _sender(ancillary)
        if user not in (os.geteuid(), _ROOT):
            line = f"this lab belongs to user {os.geteuid()}; user {user} is not permitted"
            reply = json.dumps(refusal(line)).encode()
        else:
            self._before()
            reply = self._door.answer(request)
            self._after()
        # A client without an address wants no reply; one that is gone or does not read gets none.
        if client:
            with suppress(OSError):
                self._socket.sendto(reply, client)


def _sender(ancillary: list[tuple[int, int, bytes]]) -> int | None:
    """The user who sent a datagram, as the kernel says."""
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == socket.SCM_CREDENTIALS:
            return int(_CREDENTIALS.unpack_from(data)[1])
    return None


def remove_stale(path: Path, kind: socket.SocketKind = socket.SOCK_SEQPACKET) -> None:
    """Take away the socket of a lab that is gone. Raises `LabError` if it still answers."""
    if not path.exists():
        return
    if not path.is_socket():
        raise LabError(f"{path} is in the way and not a socket; remove it")
    with socket.socket(socket.AF_UNIX, kind) as probe:
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
            return
        except OSError as error:
            raise LabError(f"{path} cannot be used: {error.strerror}") from error
    raise LabError(f"a lab already runs at {path}; stop it, or choose another TONUS_RUNTIME_DIR")
