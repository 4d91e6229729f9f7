"""Rows that differ in their seeds or robots alone: what they have in common, and how much one
controller differs from another on the same robot with the same seed."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from scipy import stats

from tonus.config.schema.parameter_study import ParameterStudy
from tonus.tools.study.play import COMPLETED, Row, figures

_CONFIDENCE = 0.95
ROBOT = "lab.robot_seed"
"""a parameter whose values are robots drawn from a population, and not settings to compare"""


@dataclass(frozen=True)
class Mean:
    """Of one figure over the samples; ``half`` is half the width of its 95 % confidence interval by
    Student's t, None for one sample."""

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

    @property
    def samples(self) -> int:
        """How many there are, of whatever verdict: its robots, or its runs where it has none."""
        return len({_sample(row) for row in self.rows})

    def values(self, figure: str) -> list[float]:
        """Of the runs that were completed and have it."""
        good = [row[figure] for row in self.rows if row["verdict"] == COMPLETED]
        return [each for each in good if each is not None]

    def mean(self, figure: str) -> Mean | None:
        """Over robots, each with its mean over the seeds; without robots over the runs. A robot of
        which a completed run does not have the figure, as one that did not settle, is left out:
        its other runs would speak for it."""
        found: dict[tuple[Any, ...], list[Any]] = {}
        for row in self.rows:
            if row["verdict"] == COMPLETED:
                found.setdefault(_sample(row), []).append(row[figure])
        values = np.array([np.mean(each) for each in found.values() if None not in each])
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
    names = {key: name for key, name in short(study).items() if key != ROBOT}
    controllers = _controllers(study)
    for row in rows:
        labels = {key: row[key] for key, count in outer.items() if count > 1}
        if "controller" in labels:
            labels["controller"] = controllers.get(row["controller"], row["controller"])
        labels |= {name: row["parameters"][key] for key, name in names.items()}
        found.setdefault(json.dumps(labels), Group(labels, [])).rows.append(row)
    return list(found.values())


def differences(study: ParameterStudy, rows: Sequence[Row]) -> list[Group]:
    """As `groups`, of each controller less each one before it in the study's list. A row is the
    difference of two completed runs that differ in nothing else, robot and seed included."""
    alike: dict[str, dict[str, Row]] = {}
    for row in rows:
        if row["verdict"] == COMPLETED:
            place = [row[key] for key in ("config", "scenario", "parameters", "seed")]
            alike.setdefault(json.dumps(place), {})[row["controller"]] = row
    made, names = [], _controllers(study)
    for of in alike.values():
        for one, other in combinations(study.controllers, 2):
            if one in of and other in of:
                less = {key: _less(of[other], of[one], key) for key in figures(study)}
                made.append(of[other] | less | {"controller": f"{names[other]} less {names[one]}"})
    return groups(study, made)


def _less(row: Row, other: Row, figure: str) -> float | None:
    """None where one of them does not have it."""
    here, there = row[figure], other[figure]
    return None if here is None or there is None else here - there


def _sample(row: Row) -> tuple[Any, ...]:
    robot = row["parameters"].get(ROBOT)
    return (row["index"],) if robot is None else (ROBOT, robot)


def short(study: ParameterStudy) -> dict[str, str]:
    """Each parameter's name in headings, by its key: the last two words, or as many more as no
    other parameter has."""
    return {key: _ending(key, study.parameters.keys() - {key}) for key in study.parameters}


def _controllers(study: ParameterStudy) -> dict[str, str]:
    """Each controller's name in headings: its class alone, unless another has that name."""
    classes = {each: each.rpartition(":")[2] for each in study.controllers}
    held = list(classes.values())
    return {each: name if held.count(name) == 1 else each for each, name in classes.items()}


def _ending(key: str, others: Iterable[str]) -> str:
    words = key.split(".")
    for count in range(2, len(words)):
        ending = ".".join(words[-count:])
        if not any(f".{other}".endswith(f".{ending}") for other in others):
            return ending
    return key


def told(group: Group, figure: str) -> str:
    """Its mean, with the number of samples where not all have one; empty where none has."""
    mean = group.mean(figure)
    if mean is None:
        return ""
    few = f" (of {mean.count} of {group.samples})" if mean.count < group.samples else ""
    return f"{mean}{few}"


def number(value: Any) -> str:
    """A value in tables and headings."""
    return "" if value is None else f"{value:.5g}" if isinstance(value, float) else str(value)
