"""What we set out to reach beyond the paper: the bounds, and what each controller gave."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tonus.tools.paper.case import Kind
from tonus.tools.paper.compare import BIO, REFERENCE, VARIANTS, matches, usual
from tonus.tools.paper.printed import SLOPE
from tonus.tools.paper.results import Results
from tonus.tools.paper.table import Cell, Column, Table

SHOWN = (BIO, *VARIANTS, REFERENCE)
_PLANTS = 200
_MOVING = (Kind.SINE, Kind.MOVE)
_SLOPE_ROOM = 0.1
Figure = Callable[[Results, str], float | None]


@dataclass(frozen=True)
class Target:
    """``of`` gives the figure of a controller that must not be over, or under, the bound."""

    name: str
    bound: float
    unit: str
    of: Figure
    least: bool = False

    def met(self, value: float) -> bool:
        return value >= self.bound if self.least else value <= self.bound


def _worst(key: str, kind: Kind | tuple[Kind, ...], scale: float = 1.0) -> Figure:
    def of(results: Results, controller: str) -> float | None:
        rows = usual(results).select(kind=kind, controller=controller)
        values = rows.values(key)
        return float(values.max()) * scale if len(values) else None

    return of


def _open_contact(results: Results, controller: str) -> float | None:
    rows = results.select(kind=Kind.CONTACT, controller=controller, plant=None, bus=None)
    peaks = [
        row.indicators["contact_peak"]
        for row in rows
        if not row.indicators.get("envelope_enabled", 1.0) and "contact_peak" in row.indicators
    ]
    return min(peaks) if peaks else None


def _least_r2(results: Results, controller: str) -> float | None:
    found = [match.r2 for match in matches(results, controller)]
    return min(found) if found else None


def _slope(results: Results, controller: str) -> float | None:  # noqa: ARG001
    values = results.select(stage=1, plant="model", bus=None).values("slope")
    return 100.0 * abs(float(values.mean()) / SLOPE - 1.0) if len(values) else None


def _drawn(key: str, reduce: Callable[[Any], Any], scale: float = 1.0) -> Figure:
    def of(results: Results, controller: str) -> float | None:
        rows = results.select(plant="plants", controller=controller, bus=None)
        values = rows.values(key)
        return float(reduce(values)) * scale if len(values) else None

    return of


def _drawn_faults(results: Results, controller: str) -> float | None:
    rows = results.select(plant="plants", controller=controller, bus=None).rows
    return float(sum(not row.completed for row in rows)) if rows else None


def _drawn_count(results: Results, controller: str) -> float | None:
    rows = results.select(plant="plants", controller=controller, bus=None).rows
    return float(len(rows)) if rows else None


TARGETS: tuple[Target, ...] = (
    Target("tracking, worst sine", 0.5, "mm", _worst("position_rmse", Kind.SINE, 1e3)),
    Target("tension error in hold, RMS", 0.5, "%", _worst("tension_percent", Kind.HOLD)),
    Target("tension error in motion, RMS", 0.5, "N", _worst("tension_rmse", _MOVING)),
    Target("K_eq reaction, 63 %", 100.0, "ms", _worst("reaction", Kind.STEP, 1e3)),
    Target("settling of a minimum-jerk step", 0.8, "s", _worst("settling_worst", Kind.MOVE)),
    Target("overshoot", 2.9, "%", _worst("overshoot_worst_percent", Kind.MOVE)),
    Target("contact peak", 25.0, "N", _worst("contact_peak", Kind.CONTACT)),
    Target("the same, envelope off", 35.0, "N", _open_contact, least=True),
    Target("force error on the phantom, RMS", 1.0, "N", _worst("contact_force_rmse", Kind.PRESS)),
    Target("R² of lab and model, least case", 0.97, "", _least_r2, least=True),
    Target("static slope, off 420 N/m", 100.0 * _SLOPE_ROOM, "%", _slope),
    Target("drawn plants", _PLANTS, "", _drawn_count, least=True),
    Target("drawn plants: error, median", 1.0, "mm", _drawn("position_rmse", np.median, 1e3)),
    Target("drawn plants: faults", 0.0, "", _drawn_faults),
    Target("drawn plants: ticks with slack", 0.0, "", _drawn("slack_ticks", np.sum)),
    Target("drawn plants: longest violation", 1.0, "ticks", _drawn("violation_longest", np.max)),
)


def targets(results: Results) -> tuple[Table, list[dict[str, Any]]]:
    """Every target with the worst figure of each controller shown; what is missed stands out."""
    having = {row.controller for row in results}
    names = [name for name in SHOWN if name in having]
    table = Table(
        "targets",
        "Our own targets: worst of all trials in the lab",
        (Column("target"), Column("bound"), *(Column(name) for name in names)),
        notes=["bold: met. –: no trial of this run bears on it"],
    )
    found = []
    for target in TARGETS:
        values = {name: target.of(results, name) for name in names}
        sign = "≥" if target.least else "≤"
        cells: list[Cell] = [target.name, f"{sign} {target.bound:g} {target.unit}".strip()]
        for place, name in enumerate(names):
            value = values[name]
            cells.append(value)
            if value is not None and target.met(value):
                table.marked.add((len(table.rows), place + 2))
        table.rows.append(cells)
        found.append(
            {
                "target": target.name,
                "bound": target.bound,
                "least": target.least,
                "unit": target.unit,
                "values": values,
                "met": {
                    name: target.met(value) for name, value in values.items() if value is not None
                },
            }
        )
    return table, found
