"""Fair comparison of rows: the same cases, the same seeds, paired."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonus.tools.paper.case import Kind
from tonus.tools.paper.indicators import r_squared, rms
from tonus.tools.paper.printed import Indicator
from tonus.tools.paper.results import Results, Row, Traces
from tonus.tools.paper.table import Spread

Array = NDArray[np.float64]
REFERENCE = "pid"
"""the controller against which improvements are counted"""
BIO = "bio"
VARIANTS = ("bio_integral", "bio_observer")
MATCHED = "pd_matched"
LITERAL = "eq9_literal"
STAGES = (1, 2, 3)


def usual(results: Results) -> Results:
    """Without what runs only to show a point: the envelope switched off, eq. (9) as printed."""
    return Results(
        [
            row
            for row in results
            if row.indicators.get("envelope_enabled", 1.0) and row.controller != LITERAL
        ],
        results.traces,
        results.untuned,
    )


def of(results: Results, indicator: Indicator, *, plant: str = "lab") -> Results:
    """The rows an indicator is taken from."""
    return usual(results).select(kind=indicator.kinds, plant=plant)


@dataclass(frozen=True)
class Compared:
    """One indicator of every controller, seed by seed, over the cases that all of them have."""

    indicator: Indicator
    cases: tuple[str, ...]
    values: dict[str, dict[int, float]]
    """controller -> seed -> mean over the cases, in the indicator's unit"""

    def spread(self, controller: str) -> Spread | None:
        return Spread.of(self.values.get(controller, {}).values())

    def improvements(self, controller: str, reference: str = REFERENCE) -> list[float]:
        """% by which it is better than the reference, for every seed that both have; negative:
        worse. Without a meaning, and so empty, where the reference is at zero."""
        base, own = self._raised(reference), self._raised(controller)
        sign = 1.0 if self.indicator.more_is_better else -1.0
        return [
            sign * 100.0 * (own[seed] - base[seed]) / abs(base[seed])
            for seed in sorted(base.keys() & own.keys())
            if base[seed] != 0.0
        ]

    def _raised(self, controller: str) -> dict[int, float]:
        """Seed by seed, nothing below the indicator's floor."""
        values = self.values.get(controller, {})
        return {seed: max(value, self.indicator.floor) for seed, value in values.items()}

    def standing(self, controller: str, reference: str = REFERENCE) -> str | None:
        """``better`` or ``worse`` than the reference with every seed, else ``even``."""
        found = self.improvements(controller, reference)
        if not found:
            return None
        if all(value > 0.0 for value in found):
            return "better"
        return "worse" if all(value < 0.0 for value in found) else "even"

    def best(self) -> str | None:
        """The controller with the best mean."""
        spreads = {name: self.spread(name) for name in self.values}
        means = {name: found.mean for name, found in spreads.items() if found is not None}
        if not means:
            return None
        choose = max if self.indicator.more_is_better else min
        return choose(means, key=lambda name: means[name])


def compared(results: Results, indicator: Indicator, *, plant: str = "lab") -> Compared:
    """Every controller's figure over the same cases. A seed counts only if it has all of them."""
    rows = of(results, indicator, plant=plant)
    found: dict[str, dict[int, dict[str, float]]] = {}
    for row in rows:
        value = row.get(indicator.key)
        if value is not None:
            seeds = found.setdefault(row.controller, {})
            seeds.setdefault(row.seed, {})[row.case] = value * indicator.scale
    having = [set().union(*(set(cases) for cases in seeds.values())) for seeds in found.values()]
    common = set.intersection(*having) if having else set()
    order = tuple(case for case in rows.names("case") if case in common)
    values = {
        controller: {
            seed: float(np.mean([cases[case] for case in order]))
            for seed, cases in sorted(seeds.items())
            if common <= cases.keys()
        }
        for controller, seeds in found.items()
    }
    return Compared(indicator, order, {name: seeds for name, seeds in values.items() if seeds})


@dataclass(frozen=True)
class Match:
    """How well the model foretells the lab in one case."""

    case: str
    r2: float
    """of what the case excites: the contact force where there is contact, else the position"""
    force_r2: float
    """of the cables' resultant, three components, which in slow motion hardly varies"""
    force_percent: float
    """RMS of that resultant's difference in % of its RMS"""


def matches(results: Results, controller: str = BIO) -> list[Match]:
    """Model against lab, case by case, from the curves that were kept. Stages 2 and 3, but for
    standing still, which excites nothing."""
    lab, model = (
        {row.case: row for row in _curved(results, controller, plant)} for plant in ("lab", "model")
    )
    found = []
    for case in lab.keys() & model.keys():
        real, foretold = results.traces(lab[case].key), results.traces(model[case].key)
        if real is None or foretold is None:
            continue
        touched = float(real["contact"].max()) > 0.0
        response = r_squared(*_aligned(real, foretold, "contact" if touched else "position"))
        measured, told = _aligned(real, foretold, "cable_force")
        force = r_squared(measured, told)
        if response is not None and force is not None:
            off, size = rms(measured - told), rms(measured)
            found.append(Match(case, response, force, 100.0 * off / size))
    order = results.names("case")
    return sorted(found, key=lambda match: order.index(match.case))


def _aligned(real: Traces, foretold: Traces, name: str) -> tuple[Array, Array]:
    """A curve of both (m, k) at the first one's times, as far as both go."""
    there, here = foretold["time"].astype(np.float64), real["time"].astype(np.float64)
    chosen = here <= there[-1]
    time = here[chosen]
    measured = real[name][chosen].astype(np.float64).reshape(len(time), -1)
    columns = foretold[name].astype(np.float64).reshape(len(there), -1).T
    return measured, np.column_stack([np.interp(time, there, column) for column in columns])


def _curved(results: Results, controller: str, plant: str) -> list[Row]:
    rows = usual(results).select(controller=controller, plant=plant)
    seeds = [row.seed for row in rows]
    return [
        row
        for row in rows
        if row.completed and row.stage in (2, 3) and row.kind != Kind.HOLD
        if row.seed == min(seeds)
    ]
