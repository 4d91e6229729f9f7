"""MCAP files as numpy arrays: `open` a log and index it by topic.

Messages are decoded a chunk at a time, without touching one in Python. A damaged file is read up
to the damage, which `Log.damage` names.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tools.errors import ToolError
from tools.log.log import Log
from tools.log.several import SeveralLogs

__all__ = ["Log", "open"]


def open(path: str | Path | Sequence[str | Path]) -> Log:  # noqa: A001  # as in wave.open
    """Open a log, or the segments of one run as if they were one.

    Raises ToolError when a file is not a log at all.
    """
    if isinstance(path, str | Path):
        return Log(Path(path))
    paths = [Path(each) for each in path]
    if not paths:
        raise ToolError("no log is named")
    return Log(paths[0]) if len(paths) == 1 else SeveralLogs(paths)
