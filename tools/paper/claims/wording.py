"""How a claim is put together from its figures."""

from __future__ import annotations

from dataclasses import dataclass

from tonus.tools.paper.case import Kind
from tonus.tools.paper.compare import BIO, usual
from tonus.tools.paper.results import Results
from tonus.tools.paper.table import Spread, number
from tonus.tools.paper.verdicts import Claim, Judgement, Verdict

LOADS = (Kind.RAMP, Kind.STEP)


@dataclass(frozen=True)
class Text:
    """What is said beside the figures: always, and if the verdict is the lower one."""

    always: str = ""
    if_not: str = ""


def claim_of(
    head: tuple[str, str, str],
    value: float | None,
    unit: str,
    ours: Spread | None,
    judged: Judgement,
    text: Text | None = None,
) -> Claim:
    """``head``: name, claim, and how the paper puts it."""
    text = text or Text()
    if ours is None:
        sentence = "No trial of this run bears on it."
    else:
        parts = [f"Ours: {_figure(ours, unit)}."]
        if text.always:
            parts.append(text.always)
        if judged.verdict is Verdict.NOT_REPRODUCED and text.if_not:
            parts.append(text.if_not)
        sentence = " ".join(parts)
    name, claim, paper = head
    return Claim(name, claim, paper, value, unit, ours, judged.verdict, judged.rule, sentence)


def _figure(ours: Spread, unit: str) -> str:
    shown = f"{number(ours.mean)} {unit}".strip()
    if ours.count == 1:
        return f"{shown} (one value)"
    return f"{shown} on average, {number(ours.low)} to {number(ours.high)} in {ours.count}"


def over_trials(
    results: Results,
    key: str,
    kind: Kind | tuple[Kind, ...] | None = None,
    controller: str = BIO,
    scale: float = 1.0,
) -> Spread | None:
    """Over every trial in the lab."""
    rows = usual(results).select(kind=kind, controller=controller)
    spread = Spread.of(rows.values(key))
    return None if spread is None else spread.times(scale)
