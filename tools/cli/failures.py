"""What a command's error means to a person: one line, and the exit code."""

from __future__ import annotations

import click

from tonus.config.errors import ConfigError
from tonus.drivers.errors import DriverError
from tonus.runtime.errors import ControllerError, DaemonError
from tonus.sim.errors import LabError
from tonus.tools.errors import ToolError

_NO_CACHE = "no locator available"
"""numba's words where it finds no folder for what it compiles"""
_CACHE_ADVICE = (
    "compiled code can be kept neither beside the sources nor in the user's cache folder; "
    "set NUMBA_CACHE_DIR to a folder that may be written"
)


def explained(error: Exception) -> tuple[str, int]:
    """The line, empty for a command that was interrupted, and the exit code. An error of the
    program itself is raised again."""
    if isinstance(error, click.exceptions.Abort):
        return "", 1
    if isinstance(error, click.UsageError):
        hint = f"; see {error.ctx.command_path} --help" if error.ctx is not None else ""
        return line(f"{error.format_message().rstrip('.')}{hint}"), 2
    if isinstance(error, click.ClickException):
        return line(error.format_message()), 2
    if isinstance(error, ConfigError | ControllerError | LabError | ToolError):
        return line(str(error)), 2
    if isinstance(error, DriverError | DaemonError):
        return line(str(error)), 1
    if isinstance(error, OSError):
        where = error.filename if error.filename is not None else "input or output"
        reason = (error.strerror or "cannot be used").lower()
        return line(f"{where}: {reason}; check the path, its permissions and the disk"), 2
    if isinstance(error, MemoryError):
        return line("not enough memory; process less at a time"), 2
    if isinstance(error, RuntimeError) and _NO_CACHE in str(error):
        return line(_CACHE_ADVICE), 2
    raise error


def line(text: str) -> str:
    """What is said of an error. A file name may hold a line break; this is one line whatever
    happens."""
    return f"tonus: {' '.join(text.split())}"
