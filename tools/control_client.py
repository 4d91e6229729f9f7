"""A running daemon's control socket, from another process."""

from __future__ import annotations

import json
import socket
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from tonus.config.places import CONTROL_SOCKET, runtime_dir
from tonus.tools.errors import ToolError

PATIENCE_S = 15.0
"""a bus that is being brought up delays the first tick, and with it the answer to a command"""
_REPLY_BYTES = 1 << 16


class ControlClient:
    """One connection; `ask` as often as wanted. Raises `ToolError` when no daemon answers."""

    def __init__(self, path: Path | None = None) -> None:
        self.path = path or runtime_dir() / CONTROL_SOCKET
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(PATIENCE_S)
        self._buffer = b""
        try:
            self._socket.connect(str(self.path))
        except OSError as error:
            self._socket.close()
            raise ToolError(
                f"no daemon answers at {self.path} ({error.strerror or error}); "
                "start one with: tonus run CONFIG --serve"
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def ask(self, op: str, **fields: Any) -> dict[str, Any]:
        """The daemon's reply to one request, whether it was done or refused."""
        # A daemon that closed at once has said why, and that is still there to be read.
        with suppress(BrokenPipeError, ConnectionResetError):
            self._socket.sendall(json.dumps({"op": op, **fields}).encode() + b"\n")
        return self._reply()

    def _reply(self) -> dict[str, Any]:
        while b"\n" not in self._buffer:
            try:
                came = self._socket.recv(_REPLY_BYTES)
            except TimeoutError as error:
                raise ToolError(
                    f"the daemon at {self.path} is silent; it is starting still, or it was stopped"
                ) from error
            except OSError as error:
                raise ToolError(f"the daemon at {self.path} is gone ({error.strerror})") from error
            if not came:
                raise ToolError(f"the daemon at {self.path} is gone; it closed the connection")
            self._buffer += came
        line, _, self._buffer = self._buffer.partition(b"\n")
        reply = json.loads(line)
        assert isinstance(reply, dict)
        return reply
