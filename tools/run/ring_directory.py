"""Where the rings of a run lie, and what becomes of those that a killed run has left."""

from __future__ import annotations

import os
import shutil
import tempfile
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
    rings = base / f"run-{os.getpid()}"
    for old in base.glob("run-*"):
        # A daemon of a container has the same number each time.
        if old == rings or not Path("/proc", old.name.removeprefix("run-")).exists():
            _clear(old, say, needed=old == rings)
    rings.mkdir()
    try:
        yield rings
    finally:
        shutil.rmtree(rings, ignore_errors=True)


def _clear(old: Path, say: Progress, *, needed: bool) -> None:
    """``needed``: the place itself is; what has to be kept is moved aside. Raises `ToolError` where
    somebody is still at work there."""
    try:
        file = salvage(old)
    except (ToolError, DaemonError, OSError) as error:
        if needed and isinstance(error, ToolError):
            raise
        say(f"left by an earlier run and kept: {error}")
        if needed:
            old.rename(tempfile.mkdtemp(prefix=f"{old.name}-", dir=old.parent))
        return
    if file is not None:
        say(f"left by an earlier run and now recorded: {file}")
    shutil.rmtree(old, ignore_errors=True)
