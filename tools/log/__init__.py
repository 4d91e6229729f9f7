"""MCAP files as numpy arrays: `open` a log and index it by topic.

Messages are decoded a chunk at a time, without touching one in Python. A damaged file is read up
to the damage, which `Log.damage` names.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tonus.tools.errors import ToolError
from tonus.tools.log.log import Log
from tonus.tools.log.several import SeveralLogs, gather

__all__ = ["Log", "open"]


def open(path: str | Path | Sequence[str | Path]) -> Log:  # noqa: A001  # as in wave.open
    """Open a log, or the segments of one run as if they were one: those named, or with the first
    one those that its recorder went on to (``run.2.mcap`` and so on).

    Raises ToolError when a file is not a log at all.
    """
    remarks: tuple[str, ...] = ()
    if isinstance(path, str | Path):
        paths, remarks = gather(Path(path))
    else:
        paths = [Path(each) for each in path]
    if not paths:
        raise ToolError("no log is named")
    log = Log(paths[0]) if len(paths) == 1 else SeveralLogs(paths)
    log.remarks = remarks
    return log
