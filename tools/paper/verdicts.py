"""How a claim is judged: three rules on figures, and nothing else decides."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from tonus.tools.paper.table import Spread, number

EXACT, NEAR = 0.10, 0.25
"""shares of the paper's value within which a figure reproduces it, or is consistent with it"""

HALF = 0.5
"""share of the paper's improvement under which ours is not the same thing"""


class Verdict(StrEnum):
    """What our data say about a claim."""

    REPRODUCED = "reproduced"
    CONSISTENT = "consistent"
    NOT_REPRODUCED = "not reproduced"
    MISSING = "missing data"


_WORSE = (Verdict.REPRODUCED, Verdict.CONSISTENT, Verdict.NOT_REPRODUCED)


@dataclass(frozen=True)
class Judgement:
    """A verdict and the rule that gave it."""

    verdict: Verdict
    rule: str

    def at_most(self, ceiling: Verdict, why: str) -> Judgement:
        """No better than ``ceiling``."""
        if self.verdict in _WORSE and _WORSE.index(self.verdict) < _WORSE.index(ceiling):
            return Judgement(ceiling, f"{self.rule}; no better than {ceiling}: {why}")
        return self


def limit(ours: Spread | None, bound: float, *, least: bool = False) -> Judgement:
    """Every value within the bound: reproduced; the mean is: consistent."""
    word = "at least" if least else "at most"
    rule = (
        f"reproduced: every value is {word} {number(bound)}; consistent: their mean is; "
        "else not reproduced"
    )
    if ours is None:
        return Judgement(Verdict.MISSING, rule)
    worst = ours.low if least else ours.high
    sign = -1.0 if least else 1.0
    if sign * worst <= sign * bound:
        return Judgement(Verdict.REPRODUCED, rule)
    if sign * ours.mean <= sign * bound:
        return Judgement(Verdict.CONSISTENT, rule)
    return Judgement(Verdict.NOT_REPRODUCED, rule)


def match(ours: Spread | None, value: float) -> Judgement:
    """The mean lies near a value."""
    rule = (
        f"reproduced: mean within {EXACT:.0%} of {number(value)}; consistent: within {NEAR:.0%}; "
        "else not reproduced"
    )
    if ours is None:
        return Judgement(Verdict.MISSING, rule)
    off = abs(ours.mean - value) / abs(value)
    if off <= EXACT:
        return Judgement(Verdict.REPRODUCED, rule)
    return Judgement(Verdict.CONSISTENT if off <= NEAR else Verdict.NOT_REPRODUCED, rule)


def gain(ours: Spread | None, margin: float) -> Judgement:
    """An improvement in %, paired by seed."""
    rule = (
        f"reproduced: mean improvement at least {number(margin)} % and better with every seed, of "
        f"two at least; consistent: better with every seed, by {HALF:.0%} of that; else not "
        "reproduced"
    )
    if ours is None:
        return Judgement(Verdict.MISSING, rule)
    if ours.low <= 0.0 or ours.mean < HALF * margin:
        return Judgement(Verdict.NOT_REPRODUCED, rule)
    if ours.mean >= margin and ours.count > 1:
        return Judgement(Verdict.REPRODUCED, rule)
    return Judgement(Verdict.CONSISTENT, rule)


@dataclass(frozen=True)
class Claim:
    """One claim of the paper and what became of it."""

    name: str
    claim: str
    paper: str
    """as it stands there"""
    paper_value: float | None
    unit: str
    ours: Spread | None
    verdict: Verdict
    rule: str
    sentence: str

    def as_json(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "claim": self.claim,
            "paper": self.paper,
            "paper_value": self.paper_value,
            "unit": self.unit,
            "ours": None if self.ours is None else self.ours.as_json(),
            "verdict": str(self.verdict),
            "rule": self.rule,
            "sentence": self.sentence,
        }
