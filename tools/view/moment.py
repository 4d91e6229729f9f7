"""What is shown now, wherever it comes from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tonus.config.schema.root import Config
    from tonus.tools.view.shape import Shape

Array = NDArray[np.float64]
Rows = NDArray[np.void]


@dataclass(frozen=True)
class Happening:
    """An event, with the time at which it is marked."""

    time_s: float
    level: int
    name: str
    where: str
    text: str


@dataclass(frozen=True)
class Samples:
    """Cycle records (n,), with a member for each topic, their times (n,) in s, and the truth (n,)
    of a lab, None without one."""

    times: Array
    rows: Rows
    truth: Rows | None = None

    def __len__(self) -> int:
        return len(self.times)

    def between(self, start_s: float, end_s: float) -> Samples:
        """Those with start_s < time <= end_s."""
        first, last = np.searchsorted(self.times, (start_s, end_s), "right")
        part = slice(int(first), int(last))
        return Samples(
            self.times[part], self.rows[part], None if self.truth is None else self.truth[part]
        )


@dataclass(frozen=True)
class Moment:
    """What came since the last one."""

    time_s: float
    samples: Samples
    """thinned to the rate of the plots; empty if nothing came"""
    newest: Rows
    """(1,) the record of this moment; (0,) before the first"""
    truth: Rows
    """(1,) likewise, or (0,) where there is none"""
    happenings: list[Happening] = field(default_factory=list)
    jumped: bool = False
    """what was shown before is not followed by this"""


class Source(Protocol):
    """A run, live or recorded."""

    name: str
    shape: Shape

    @property
    def config(self) -> Config:
        """The whole, at the cost of half a second when it is first asked for."""


def joined(parts: list[Samples]) -> Samples:
    """One after the other; at least one."""
    truths = [part.truth for part in parts]
    known = [truth for truth in truths if truth is not None]
    return Samples(
        np.concatenate([part.times for part in parts]),
        np.concatenate([part.rows for part in parts]),
        np.concatenate(known) if len(known) == len(parts) else None,
    )
