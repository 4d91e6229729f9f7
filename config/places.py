"""Where the sockets and rings of a running daemon and lab lie."""

from __future__ import annotations

import os
from pathlib import Path

RUNTIME_DIR = "TONUS_RUNTIME_DIR"
"""environment variable"""
CONTROL_SOCKET = "tonus.sock"
"""A running daemon's control socket, unless its configuration names another."""
LAB_DOOR = "lab.sock"
"""A running lab's door, among its sockets."""


IN_MEMORY = ("tmpfs", "ramfs", "hugetlbfs")
"""File systems that never write a page to a disk."""


def runtime_dir() -> Path:
    """$TONUS_RUNTIME_DIR, else $XDG_RUNTIME_DIR/tonus, else /run/tonus, or, where /run lies on a
    disk, as in some containers and virtual machines, /dev/shm/tonus-UID; not created here.

    On a disk the kernel makes a ring's pages read-only while it writes them, every 30 s, and the
    next record in each faults and may wait for the file system's journal.
    """
    own = os.environ.get(RUNTIME_DIR)
    if own:
        return Path(own)
    user = os.environ.get("XDG_RUNTIME_DIR")
    if user:
        return Path(user) / "tonus"
    usual, shared = Path("/run/tonus"), Path("/dev/shm")  # noqa: S108  # the folder below is ours
    if file_system(usual) in IN_MEMORY or file_system(shared) not in IN_MEMORY:
        return usual
    return shared / f"tonus-{os.getuid()}"


def file_system(path: Path) -> str:
    """Kind of the one a path lies, or would lie, on; "unknown" if that cannot be told."""
    try:
        mounts = Path("/proc/mounts").read_text()
    except OSError:
        return "unknown"
    best, kind = -1, "unknown"
    for line in mounts.splitlines():
        _, mount, found, *_ = line.split()
        if path.absolute().is_relative_to(mount) and len(mount) >= best:
            best, kind = len(mount), found
    return kind
