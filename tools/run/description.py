"""What a running daemon tells those who watch it: a file beside its rings."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from tonus.config.places import runtime_dir
from tonus.tools.draft import write_whole
from tonus.tools.errors import ToolError

_FILE = "run.json"
_PREFIX = "run-"


@dataclass(frozen=True)
class Description:
    """One run, as its viewers have to know it."""

    config: str
    """YAML, as in the log"""
    scenario: str
    """YAML, likewise"""
    others: str
    """YAML, scenarios that may be chosen instead, likewise; empty where there are none"""
    name: str
    virtual: bool
    served: bool
    socket: str | None
    """path of the control socket, None where there is none"""
    log: str


def describe_run(rings: Path, description: Description) -> None:
    """Written once, before the first tick, complete or not at all."""
    write_whole(rings / _FILE, json.dumps(asdict(description)))


def read_description(rings: Path) -> Description:
    """Raises `ToolError` where there is none, or that of another version."""
    try:
        return Description(**json.loads((rings / _FILE).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError) as error:
        raise ToolError(
            f"{rings / _FILE}: no description of a run ({error}); "
            "watch a daemon of this version of Tonus"
        ) from error


def running() -> list[Path]:
    """The ring folders of all runs of this user that are alive, the newest last."""
    found = [
        path.parent
        for path in runtime_dir().glob(f"{_PREFIX}*/{_FILE}")
        if Path("/proc", path.parent.name.removeprefix(_PREFIX)).exists()
    ]
    return sorted(found, key=lambda folder: folder.stat().st_mtime_ns)
