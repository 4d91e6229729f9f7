"""Folders that are written to."""

from __future__ import annotations

import os
from pathlib import Path

from tonus.tools.errors import ToolError


def make_folder(folder: Path, remedy: str = "choose another with --out") -> None:
    """One this process may write to, made where there is none. Raises `ToolError`."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        there = next(each for each in (folder, *folder.parents) if os.path.lexists(each))
        raise ToolError(f"{there}: is no folder; {remedy}") from error
    except OSError as error:
        raise ToolError(f"{folder}: {error.strerror}; {remedy}") from error
    if not os.access(folder, os.W_OK):
        raise ToolError(f"{folder}: cannot be written; {remedy}")
