"""Which kinds of faults have met, and in which state."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import combinations

Pair = tuple[str, str]


def pair(one: str, other: str) -> Pair:
    """Of two kinds, in no order."""
    return (one, other) if one <= other else (other, one)


class Pairs:
    """How often two kinds were together in a state, by the state in which the first struck."""

    def __init__(self) -> None:
        self._met: Counter[tuple[str, Pair]] = Counter()
        self._single: Counter[tuple[str, str]] = Counter()

    def add(self, state: str, kinds: Sequence[str]) -> None:
        self._single.update((state, kind) for kind in kinds)
        self._met.update((state, pair(*both)) for both in combinations(kinds, 2))

    def count(self, state: str, one: str, other: str) -> int:
        return self._met[state, pair(one, other)]

    def single(self, state: str, kind: str) -> int:
        return self._single[state, kind]

    def missing(self, state: str, possible: Iterable[Pair]) -> list[Pair]:
        """Pairs that have not been together in a state."""
        return [each for each in possible if not self._met[state, each]]
