"""A running lab's door, from another process."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

from tonus.config.places import LAB_DOOR, runtime_dir
from tonus.tools.errors import ToolError

REPLY_BYTES = 1 << 20
PATIENCE_S = 5.0


def door_path() -> Path:
    """Where the door of this user's lab is."""
    return runtime_dir() / LAB_DOOR


def ask(request: dict[str, Any], path: Path | None = None) -> dict[str, Any]:
    """The reply of the lab at ``path``, else of this user's, to a request it can carry out.

    Raises `ToolError` when no lab answers or the lab refuses.
    """
    path = path or door_path()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as client:
        client.bind("")  # the kernel finds a name for the reply to go to
        client.settimeout(PATIENCE_S)
        try:
            client.connect(str(path))
            client.send(json.dumps(request).encode())
            reply = json.loads(client.recv(REPLY_BYTES))
        except TimeoutError as error:
            raise ToolError(f"the lab at {path} is silent; is it stopped?") from error
        except OSError as error:
            raise ToolError(
                f"no lab answers at {path} ({error.strerror or error}); "
                "start one with: tonus lab CONFIG"
            ) from error
    if not reply["ok"]:
        raise ToolError(f"the lab refuses: {reply['error']}")
    return dict(reply)
