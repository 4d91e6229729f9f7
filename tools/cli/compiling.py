"""Compiled code: a place to keep it, and a word about what is being compiled.

Numba keeps what it compiled beside the sources or in the user's cache folder. A user who may write
to neither gets a folder of the system's for temporary files; a first command compiles for up to a
minute, and says so.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import click

from tonus import runtime
from tonus.runtime.timing.clock import wall_seconds

VARIABLE = "NUMBA_CACHE_DIR"
_SILENT_S, _STEP_S = 1.5, 5.0


def keep_somewhere() -> None:
    """Name a folder that may be written where numba would find none; before numba is loaded."""
    if os.environ.get(VARIABLE) or any(map(_may_be_written, _usual())):
        return
    folder = Path(tempfile.gettempdir(), f"tonus-compiled-{os.getuid()}")
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        owned = folder.stat().st_uid == os.getuid() and not folder.is_symlink()
    except OSError:
        return  # nowhere at all: numba says so
    if owned and _may_be_written(folder):
        os.environ[VARIABLE] = str(folder)


def _usual() -> list[Path]:
    cache = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    return [Path(runtime.__file__).parent / "__pycache__", Path(cache) / "numba"]


def _may_be_written(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


class Compiling:
    """A numba event listener that tells a person what takes so long."""

    def __init__(self) -> None:
        self._began: float | None = None
        self._next = _SILENT_S
        self._count = 0

    def notify(self, event: Any) -> None:
        """Called by numba at the start and at the end of each compilation."""
        if not event.is_start:
            return
        now = wall_seconds()
        self._began = now if self._began is None else self._began
        self._count += 1
        if now - self._began < self._next:
            return
        name = getattr(event.data.get("dispatcher"), "py_func", None)
        where = f"{name.__module__}.{name.__name__}" if name is not None else "control"
        first = " (once for each installation, about a minute)" if self._next == _SILENT_S else ""
        click.echo(f"compiling{first}: {where}, number {self._count}", err=True)
        self._next = now - self._began + _STEP_S


def tell() -> None:
    """From here on, where numba is loaded."""
    if "numba" not in sys.modules:
        return
    from numba.core import event

    event.register("numba:compile", _listener(event))  # type: ignore[no-untyped-call]


def _listener(event: Any) -> Any:
    told = Compiling()

    class Listener(event.Listener):  # type: ignore[misc]  # numba is not annotated
        """Numba's own kind."""

        def on_start(self, happened: Any) -> None:
            told.notify(happened)

        def on_end(self, happened: Any) -> None:
            del happened

    return Listener()
