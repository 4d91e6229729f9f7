"""Where the rings of a run lie, and what becomes of those that a killed run has left."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tonus.config.places import runtime_dir
from tonus.drivers.fieldbus import Progress
from tonus.runtime.errors import DaemonError
from tonus.tools.errors import ToolError
from tonus.tools.folders import make_folder
from tonus.tools.run.recorder_process import salvage


@contextmanager
def ring_directory(say: Progress) -> Iterator[Path]:
    """A place for the rings of this run; what a killed run left behind is recorded first where
    nobody did, and then cleared away."""
    base = runtime_dir()
    make_folder(base, "set TONUS_RUNTIME_DIR to a folder of your own")
    for old in base.glob("run-*"):
        if not Path("/proc", old.name.removeprefix("run-")).exists():
            _clear(old, say)
    rings = base / f"run-{os.getpid()}"
    rings.mkdir()
    try:
        yield rings
    finally:
        shutil.rmtree(rings, ignore_errors=True)


def _clear(old: Path, say: Progress) -> None:
    try:
        file = salvage(old)
    except (ToolError, DaemonError, OSError) as error:
        say(f"left by an earlier run and kept: {error}")
        return
    if file is not None:
        say(f"left by an earlier run and now recorded: {file}")
    shutil.rmtree(old, ignore_errors=True)
