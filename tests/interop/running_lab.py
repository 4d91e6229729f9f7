"""`tonus lab` as a process, for clients that know only its sockets."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

COMMAND = (sys.executable, "-m", "tonus.tools.cli", "lab", "config/can.yaml")
DRIVES = {"can0": (1, 7), "can1": (3, 5), "can2": (4, 6), "can3": (2, 8)}
CELLS = {"can0": (17, 23), "can1": (19, 21), "can2": (20, 22), "can3": (18, 24, 25)}


def environment(directory: Path) -> dict[str, str]:
    return {**os.environ, "TONUS_RUNTIME_DIR": str(directory), "PYTHONUNBUFFERED": "1"}


def start(directory: Path) -> subprocess.Popen[str]:
    """A lab whose sockets are open in ``directory``, and whose tracker nobody else hears."""
    with socket.socket(type=socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = (*COMMAND, "--set", f"tracker.port={port}")
    process = subprocess.Popen(
        command, env=environment(directory), stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    line = process.stdout.readline()
    assert str(directory) in line, line
    return process
