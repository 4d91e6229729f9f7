"""One measured figure, and how it is taken."""

from __future__ import annotations

import timeit
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Figure:
    """A row of bench.json; the peer may be an aim. ``ratio`` is peer over ours, of what should be
    ``large`` ours over peer, so that more is better for us."""

    name: str
    value: float
    unit: str
    peer: str = ""
    peer_value: float | None = None
    note: str = ""
    large: bool = False

    @property
    def ratio(self) -> float | None:
        """None without a peer, or where the smaller of the two is nothing."""
        if self.peer_value is None:
            return None
        more, less = (self.value, self.peer_value)[:: 1 if self.large else -1]
        return more / less if less else None

    def row(self) -> dict[str, Any]:
        return {**asdict(self), "ratio": self.ratio}


def microseconds(action: Callable[[], object], repeats: int = 2000, rounds: int = 5) -> float:
    """Best mean of several rounds, in us a call: what is left of noise is somebody else's."""
    action()
    return min(timeit.repeat(action, number=repeats, repeat=rounds)) / repeats * 1e6


def fixed_loop_ms() -> float:
    """A sum in plain Python, by which hosts compare."""
    return microseconds(lambda: sum(number * number for number in range(100_000)), 1) / 1e3


def against(
    name: str, ours: Callable[[], object], peer: str, theirs: Callable[[], object], note: str = ""
) -> Figure:
    """Ours beside a peer that does the same work, in alternation."""
    first, other, second = microseconds(ours), microseconds(theirs), microseconds(ours)
    return Figure(name, min(first, second), "us", peer, other, note)
