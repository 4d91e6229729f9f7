"""What has been played, a line of JSON an episode, on the disk within a tenth of a second."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any, Self

import tonus.tools.campaign
from tonus import config, drivers, runtime, sim
from tonus.config.schema.campaign import BusName, Study
from tonus.runtime.timing import clock
from tonus.tools.campaign.judge import Row
from tonus.tools.errors import ToolError
from tonus.tools.folders import make_folder

NAME = "episodes.jsonl"
_SYNC_S = 0.1
ANEW = "leave --resume out to begin anew"
_ROOMS = (config, drivers, runtime, sim, tonus.tools.campaign)


def code_digest(*rooms: ModuleType) -> str:
    """Of the code and the shipped configuration that a run depends on, and of ``rooms``."""
    code = sha256()
    for room in (*_ROOMS, *rooms):
        for folder in room.__path__:
            for file in sorted(Path(folder).rglob("*.py")) + sorted(Path(folder).rglob("*.yaml")):
                code.update(file.name.encode() + b"\0" + file.read_bytes())
    return code.hexdigest()[:16]


def fingerprint(study: Study, seed: int, buses: Sequence[BusName]) -> dict[str, Any]:
    """The journal's first line: all that its rows depend on, the code included."""
    told = sha256(study.model_dump_json().encode()).hexdigest()[:16]
    return {
        "study": study.name,
        "drawn_from": told,
        "code": code_digest(),
        "seed": seed,
        "buses": list(buses),
    }


class Journal:
    """The rows of one campaign; a row that a power failure tore is played again."""

    def __init__(
        self,
        folder: Path,
        head: dict[str, Any],
        *,
        resume: bool,
        name: str = NAME,
        anew: str = ANEW,
    ) -> None:
        """Raises `ToolError` where ``resume`` finds another campaign, or the folder is no place to
        write to."""
        make_folder(folder)
        self.path, self._anew = folder / name, anew
        self._synced_s = -_SYNC_S
        self.rows: dict[int, Row] = {}
        """by index: those of an earlier run of this campaign"""
        whole = self._read(head) if resume and self.path.exists() else 0
        try:
            self._file = self.path.open("r+b" if whole else "wb")
        except OSError as error:
            raise ToolError(f"{self.path}: {error.strerror}; choose another --out") from error
        self._file.truncate(whole)
        self._file.seek(whole)
        if not whole:
            self._write(head)

    def _read(self, head: dict[str, Any]) -> int:
        """Takes the rows; returns how many bytes are whole lines."""
        data = self.path.read_bytes()
        whole = data.rfind(b"\n") + 1
        try:
            first, *rows = [json.loads(line) for line in data[:whole].splitlines()]
            found = {row["index"]: row for row in rows}
        except (ValueError, KeyError, TypeError) as error:
            raise ToolError(f"{self.path}: is no journal; choose another --out") from error
        if first != head:
            other = ", ".join(key for key in head if first.get(key) != head[key])
            raise ToolError(
                f"{self.path}: was recorded with another {other}; {self._anew}, or choose another "
                "--out"
            )
        self.rows = found
        return whole

    def add(self, row: Row) -> None:
        self._write(row)

    def _write(self, line: dict[str, Any]) -> None:
        self._file.write(json.dumps(line, separators=(",", ":")).encode() + b"\n")
        self._file.flush()
        now_s = clock.wall_seconds()
        if now_s - self._synced_s >= _SYNC_S:  # the disk takes longer than a short row
            os.fsync(self._file.fileno())
            self._synced_s = now_s

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        os.fsync(self._file.fileno())
        self._file.close()
