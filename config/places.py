"""Where the sockets and rings of a running daemon and lab lie."""

from __future__ import annotations

import os
from pathlib import Path

CONTROL_SOCKET = "tonus.sock"
"""A running daemon's control socket, unless its configuration names another."""
LAB_DOOR = "lab.sock"
"""A running lab's door, among its sockets."""


def runtime_dir() -> Path:
    """$TONUS_RUNTIME_DIR, else $XDG_RUNTIME_DIR/tonus, else /run/tonus; not created here."""
    own = os.environ.get("TONUS_RUNTIME_DIR")
    if own:
        return Path(own)
    user = os.environ.get("XDG_RUNTIME_DIR")
    return Path(user) / "tonus" if user else Path("/run/tonus")
