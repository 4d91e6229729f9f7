"""One thing a doctor looked at: what was found, how good that is, what would better it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum


class Verdict(StrEnum):
    """In order, the best first."""

    GOOD = "good"
    BETTER = "could be better"
    BAD = "bad"


_ORDER = list(Verdict)


@dataclass(frozen=True)
class Finding:
    """``remedy`` is a command, or a line of a file, as it is to be typed."""

    name: str
    measured: str
    verdict: Verdict = Verdict.GOOD
    remedy: str = ""
    figures: dict[str, float] = field(default_factory=dict)
    """what was measured, for a script; units in the names"""


def worst(findings: Iterable[Finding]) -> Verdict:
    """The verdict on all of them."""
    return max((finding.verdict for finding in findings), key=_ORDER.index, default=Verdict.GOOD)


def graded(value: float, good: float, bad: float) -> Verdict:
    """By two limits, whichever way round they stand."""
    if good < bad:
        value, good, bad = -value, -good, -bad
    if value >= good:
        return Verdict.GOOD
    return Verdict.BETTER if value >= bad else Verdict.BAD
