"""Events as lines of text while they happen: for a terminal, or with a level for the journal."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.recording.ring import RingReader
from tonus.runtime.recording.taps import EVENT, Level

EVENT_RING = "events.ring"
_AT_ONCE = 256
_JOURNAL = {
    Level.DEBUG: 7,
    Level.INFO: 6,
    Level.WARNING: 4,
    Level.ERROR: 3,
    Level.FATAL: 2,
}
"""sd-daemon(3): a level in front of a line, <3> for an error"""


def for_journal(environment: Mapping[str, str]) -> bool:
    """Whether standard output is the journal's."""
    return "JOURNAL_STREAM" in environment


class EventLines:
    """Reads the ring beside the recorder, whose cursor it leaves alone."""

    def __init__(self, rings: Path, *, journal: bool, stream: TextIO | None = None) -> None:
        self._path, self._journal = rings / EVENT_RING, journal
        self._stream = stream or sys.stdout
        # Now, before the recorder moves the cursor on.
        self._reader = RingReader.open(self._path) if self._path.exists() else None

    def tell(self) -> None:
        """Print what is new."""
        if self._reader is None:
            if not self._path.exists():
                return
            self._reader = RingReader.open(self._path)
        while len(payload := self._reader.drain(_AT_ONCE)[1]):
            self._print(payload.view(EVENT).reshape(-1))

    def _print(self, records: NDArray[np.void]) -> None:
        for record in records:
            level = Level(int(record["level"]))
            name, where, text = (record[key].decode() for key in ("name", "where", "text"))
            place = f" {where}" if where and where not in text else ""
            prefix = f"<{_JOURNAL[level]}>" if self._journal else f"{record['tick']:>9} "
            word = "" if level is Level.INFO else f"{level.name} "
            print(f"{prefix}{word}{name}{place}: {text}", file=self._stream, flush=True)
