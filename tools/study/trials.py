"""The runs of a study: every combination of what it lists, in one order, whoever plays them."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from math import exp, log
from typing import Any

import numpy as np
from scipy.stats import qmc

from tonus.config.schema.campaign import Span
from tonus.config.schema.parameter_study import ParameterStudy, Steps
from tonus.tools.settings import settings_of


@dataclass(frozen=True)
class Trial:
    """One run. ``controller`` is None where the configuration's is taken."""

    index: int
    config: str
    scenario: str
    controller: str | None
    seed: int
    parameters: dict[str, Any]
    """by dotted key"""

    def overrides(self, study: ParameterStudy) -> dict[str, Any]:
        found = study.overrides | self.parameters
        return found if self.controller is None else found | {"control.controller": self.controller}

    def command(self, study: ParameterStudy) -> str:
        """What repeats it. ``--force``, because a study may go where `tonus check` would not."""
        words = ["tonus", "run", shlex.quote(self.config), "--virtual", "--force"]
        words += ["--scenario", shlex.quote(self.scenario), "--seed", str(self.seed)]
        if study.duration is not None:
            words += ["--duration", repr(study.duration)]
        if self.controller is not None:
            words += ["--controller", shlex.quote(self.controller)]
        for each in settings_of(study.overrides | self.parameters):
            words += ["--set", shlex.quote(each.removeprefix("--set "))]
        return " ".join(words)


def trials(study: ParameterStudy) -> list[Trial]:
    """In the order of their numbers; the seed changes fastest."""
    seeds = range(1, study.seeds + 1) if isinstance(study.seeds, int) else study.seeds
    outer = product(
        study.configs, study.scenarios, study.controllers or (None,), _combinations(study), seeds
    )
    return [
        Trial(index, config, scenario, controller, seed, parameters)
        for index, (config, scenario, controller, parameters, seed) in enumerate(outer)
    ]


def in_turn(study: ParameterStudy, planned: list[Trial]) -> list[Trial]:
    """In the order of playing: the first seed of everything before the second, and with a seed one
    combination of parameters after the other. What an interrupted study has is then the same for
    every configuration, scenario and controller, but for one combination."""
    seeds = study.seeds if isinstance(study.seeds, int) else len(study.seeds)
    points = len(_combinations(study))

    def turn(trial: Trial) -> tuple[int, int, int]:
        return trial.index % seeds, trial.index // seeds % points, trial.index

    return sorted(planned, key=turn)


def share(all_of_them: list[Trial], number: int, of: int) -> list[Trial]:
    """Every ``of``-th trial from number ``number`` (1 to ``of``) on: neighbours, which take equally
    long, go to different shares."""
    return all_of_them[number - 1 :: of]


def _combinations(study: ParameterStudy) -> list[dict[str, Any]]:
    listed = {key: _values(value) for key, value in study.parameters.items() if not _drawn(value)}
    grid = [dict(zip(listed, each, strict=True)) for each in product(*listed.values())]
    samples = list(_samples(study)) or [{}]
    # In the order of the file, so that columns and commands read as it does.
    return [
        {key: (point | sample)[key] for key in study.parameters}
        for point in grid
        for sample in samples
    ]


def bounds(value: tuple[Any, ...] | Steps | Span) -> list[Any]:
    """Every value that a parameter is to have, of a range to draw from its two ends."""
    return (
        [_scaled(value, end) for end in (0.0, 1.0)] if isinstance(value, Span) else _values(value)
    )


def _drawn(value: object) -> bool:
    return isinstance(value, Span)


def _values(value: tuple[Any, ...] | Steps | Span) -> list[Any]:
    if isinstance(value, Steps):
        spaced = np.geomspace if value.log else np.linspace
        found = spaced(value.low, value.high, value.steps).tolist()
        return [round(each) for each in found] if value.whole else found
    assert isinstance(value, tuple)
    return list(value)


def _samples(study: ParameterStudy) -> Iterator[dict[str, Any]]:
    """Ranges drawn together. The latin hypercube is SciPy's (McKay, Beckman and Conover, 1979)."""
    ranges = {key: each for key, each in study.parameters.items() if isinstance(each, Span)}
    if study.drawn is None or not ranges:
        return
    random = np.random.default_rng(study.drawn.seed)
    shape = (study.drawn.count, len(ranges))
    if study.drawn.method == "random":
        points = random.random(shape)
    else:
        points = qmc.LatinHypercube(shape[1], seed=random).random(shape[0])
    for point in points.tolist():
        yield {key: _scaled(ranges[key], at) for key, at in zip(ranges, point, strict=True)}


def _scaled(span: Span, share: float) -> float | int:
    if span.log:
        value = exp(log(span.low) + share * (log(span.high) - log(span.low)))
    else:
        value = span.low + share * (span.high - span.low)
    return round(value) if span.whole else value
