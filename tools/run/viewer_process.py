"""A viewer beside a run: a process of its own, at ordinary priority."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from tonus.drivers.fieldbus import Progress
from tonus.tools.errors import ToolError

_END_S = 5.0


@contextmanager
def beside(say: Progress) -> Iterator[None]:
    """Show this process's run while the block lasts. Raises `ToolError` without the extra."""
    if find_spec("viser") is None:
        raise ToolError("--view needs the package viser: pip install 'tonus[view]'")
    # Before the daemon takes its priority. A group of its own: Ctrl-C is for the daemon.
    viewer = subprocess.Popen(
        [sys.executable, "-m", "tonus.tools.cli", "view", "--run", str(os.getpid())],
        stdin=subprocess.DEVNULL,
        process_group=0,
    )
    say("a viewer starts beside it, and prints its address")
    try:
        yield
    finally:
        viewer.terminate()
        try:
            viewer.wait(_END_S)
        except subprocess.TimeoutExpired:
            viewer.kill()
            viewer.wait()
