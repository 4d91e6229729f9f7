"""A run that was kept in memory, read as its log would be."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.tools.log.decode import Column
from tonus.tools.log.log import Event, Log
from tonus.tools.run.kept import Kept
from tonus.tools.run.summary import TRUTH

_PREFIX = "/tonus/"


class KeptLog(Log):
    """Its topics are those of the cycle's record, and the truth; it has no metadata."""

    def __init__(self, path: Path, cycles: Kept, truths: Kept, events: Sequence[Event]) -> None:
        """``path``: where a file of it would be."""
        self.path = path
        self.remarks = ()
        self._events = list(events)
        records, stamps = cycles.rows, cycles.stamps
        self._columns = {
            _PREFIX + name: _column(records[name], stamps) for name in records.dtype.names or ()
        }
        self._columns[TRUTH] = _column(truths.rows, truths.stamps)

    @property
    def topics(self) -> tuple[str, ...]:
        return tuple(self._columns)

    @property
    def metadata(self) -> dict[str, str]:
        return {}

    @property
    def start_ns(self) -> int:
        return min((int(c.times[0]) for c in self._columns.values() if len(c.times)), default=0)

    @property
    def damage(self) -> str | None:
        return None

    def events(self) -> list[Event]:
        return self._events


def _column(rows: NDArray[Any], stamps: NDArray[np.int64]) -> Column:
    return Column(rows, stamps, np.arange(len(rows)))
