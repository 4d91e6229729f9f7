"""A client of the lab's door that knows nothing but a socket's name and JSON."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any


def ask(directory: Path, **request: Any) -> dict[str, Any]:
    """One request to the lab whose sockets lie in ``directory``, and its reply.

    Raises `TimeoutError` if none comes within 5 s.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
        asking.settimeout(5)
        asking.bind("")  # an address of its own, so that there is a way back
        asking.sendto(json.dumps(request).encode(), str(directory / "lab.sock"))
        reply: dict[str, Any] = json.loads(asking.recv(65536))
    return reply


def inject(directory: Path, kind: str, **fault: Any) -> None:
    """Make a fault happen; an `AssertionError` carries the lab's words if it refuses."""
    reply = ask(directory, op="inject", fault={"kind": kind, **fault})
    assert reply["ok"], reply["error"]
