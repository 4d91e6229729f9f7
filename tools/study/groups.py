"""Rows that differ in their seeds alone, and what they have in common."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from tonus.config.schema.parameter_study import ParameterStudy
from tonus.tools.study.play import COMPLETED, Row

_CONFIDENCE = 0.95


@dataclass(frozen=True)
class Mean:
    """Of one figure over the seeds; ``half`` is half the width of its 95 % confidence interval by
    Student's t, None for one value."""

    count: int
    value: float
    half: float | None

    def __str__(self) -> str:
        spread = "" if self.half is None else f" ± {self.half:.2g}"
        return f"{self.value:.4g}{spread}"


@dataclass
class Group:
    labels: dict[str, Any]
    """what distinguishes it, by a column's short name"""
    rows: list[Row]

    @property
    def bad(self) -> int:
        return sum(row["verdict"] != COMPLETED for row in self.rows)

    def values(self, figure: str) -> list[float]:
        """Of the runs that were completed and have it."""
        good = [row[figure] for row in self.rows if row["verdict"] == COMPLETED]
        return [each for each in good if each is not None]

    def mean(self, figure: str) -> Mean | None:
        values = np.array(self.values(figure))
        if not len(values):
            return None
        half = None
        if len(values) > 1:
            spread = float(stats.sem(values))
            half = float(stats.t.ppf(0.5 + _CONFIDENCE / 2.0, len(values) - 1)) * spread
        return Mean(len(values), float(values.mean()), half)


def groups(study: ParameterStudy, rows: Sequence[Row]) -> list[Group]:
    """In the order of the trials. Labels have what the study varies, and nothing else."""
    found: dict[str, Group] = {}
    outer = {
        "config": len(study.configs),
        "scenario": len(study.scenarios),
        "controller": len(study.controllers),
    }
    names = short(study)
    for row in rows:
        labels = {key: row[key] for key, count in outer.items() if count > 1}
        labels |= {name: row["parameters"][key] for key, name in names.items()}
        found.setdefault(json.dumps(labels), Group(labels, [])).rows.append(row)
    return list(found.values())


def short(study: ParameterStudy) -> dict[str, str]:
    """Each parameter's name in headings, by its key: the last two words, or as many more as no
    other parameter has."""
    return {key: _ending(key, study.parameters.keys() - {key}) for key in study.parameters}


def _ending(key: str, others: Iterable[str]) -> str:
    words = key.split(".")
    for count in range(2, len(words)):
        ending = ".".join(words[-count:])
        if not any(f".{other}".endswith(f".{ending}") for other in others):
            return ending
    return key


def number(value: Any) -> str:
    """A value in tables and headings."""
    return "" if value is None else f"{value:.5g}" if isinstance(value, float) else str(value)
