"""The search: differential evolution (scipy) on the logarithm of the gains, under a floor of
margins, until the budget of simulations is spent or nothing new comes up."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from tonus.config import load
from tonus.config.schema.root import Config
from tonus.config.schema.tuning import Tuning
from tonus.tools.errors import ToolError
from tonus.tools.margins.tension_loop import Margins
from tonus.tools.tune.judge import Part, all_margins, lack
from tonus.tools.tune.work import Evaluator, Gains

Array = NDArray[np.float64]
_DRAWS = 4096
"""Points among which a first population that meets the floors is looked for."""
_DIGITS = 4
"""of a gain: more would only look exact"""
_GENERATIONS = 10_000
_MUTATION, _RECOMBINATION = (0.2, 0.5), 0.9
"""Bolder than usual about what is known: with budgets of tens, scipy's own get half as near."""
_IDLE = 15
"""generations in a row with nothing to simulate: the search has come together, or to a wall"""
_REFUSED = 10
"""times the budget: so many points below the floors end a search too"""
_BELOW = 1.0e6
"""cost of gains whose margins are below the floors, times one and their lack"""
Progress = Callable[[str, int, float], None]
"""Controller, simulations done, best cost."""


class _SpentError(Exception):
    """The budget is."""


@dataclass
class Found:
    """What a search came to."""

    controller: str
    gains: Gains
    cost: float
    parts: list[Part]
    before: float | None
    """cost of the gains it began with; None when their margins are below the floors"""
    evaluations: int
    refused: int
    """points below the floors, which cost no simulation"""
    margins: dict[str, Margins] = field(default_factory=dict)

    @property
    def failed_in(self) -> dict[str, str]:
        """Scenarios that even the best gains could not end, and the fault: then nothing was tuned,
        and the cost is that of failures."""
        return {part.scenario: part.fault for part in self.parts if part.fault is not None}


def present(config: Config, keys: Iterable[str]) -> Gains:
    """The configured values of dotted keys below ``control``. Raises `ToolError`."""
    found = {}
    for key in keys:
        value: object = config.control
        for part in key.split("."):
            value = getattr(value, part, None)
        if not isinstance(value, int | float):
            raise ToolError(f"control.{key} is no number in the configuration; give it one there")
        found[key] = float(value)
    return found


class Search:
    """One controller's."""

    def __init__(
        self, config: str, tuning: Tuning, controller: str, evaluator: Evaluator, say: Progress
    ) -> None:
        self._config, _ = load(config)
        self._tuning, self._controller = tuning, controller
        self._evaluator, self._say = evaluator, say
        ranges = tuning.controllers[controller]  # type: ignore[index]
        self._keys = list(ranges)
        self._low = np.log([ranges[key].low for key in self._keys])
        self._high = np.log([ranges[key].high for key in self._keys])
        self._costs: dict[tuple[float, ...], float] = {}
        self._best: tuple[float, Gains, list[Part]] | None = None
        self._lacks: dict[tuple[float, ...], float] = {}
        self._done = self._refused = self._idle = 0

    def run(self) -> Found:
        """Raises `ToolError` when no gains in the ranges meet the floors."""
        now = present(self._config, self._keys)
        start = self._rounded(np.log([now[key] for key in self._keys]))
        population = self._population(start)
        before = None
        try:
            costs = self._evaluate([self._rounded(point) for point in population])
            before = costs[0] if costs[0] < _BELOW else None
            differential_evolution(
                _unused,
                list(zip(self._low, self._high, strict=True)),
                init=population,
                maxiter=_GENERATIONS,
                tol=0.0,
                seed=np.random.default_rng([self._tuning.seed, len(self._keys)]),
                polish=False,
                mutation=_MUTATION,
                recombination=_RECOMBINATION,
                updating="deferred",
                workers=self._map,
            )
        except _SpentError:
            before = before or self._costs.get(tuple(start.values()))
        assert self._best is not None
        cost, gains, parts = self._best
        tuned = self._configured(gains)
        return Found(
            self._controller,
            gains,
            cost,
            parts,
            before,
            self._done,
            self._refused,
            all_margins(tuned, self._controller),
        )

    def _population(self, start: Gains) -> Array:
        """The present gains where they meet the floors, and the first points of a Sobol sequence
        that do."""
        size = len(self._keys)
        sequence = qmc.Sobol(size, rng=np.random.default_rng([self._tuning.seed, size]))
        span = self._high - self._low
        draws = self._low + span * sequence.random(_DRAWS)
        first = np.clip(np.log(list(start.values())), self._low, self._high)
        found = [first]
        for point in draws:
            if len(found) == self._tuning.population:
                break
            if self._lack(self._rounded(point)) == 0.0:
                found.append(point)
        if len(found) < self._tuning.population:
            raise ToolError(
                f"tuning: controllers.{self._controller}: hardly any gains in these ranges keep "
                "the margins' floors; lower them, or control.tension_loop's"
            )
        return np.array(found)

    def _map(self, function: object, points: Iterable[Array]) -> list[float]:
        """In place of the optimiser's own map: it may call it with a whole generation."""
        del function
        return self._evaluate([self._rounded(point) for point in points])

    def _evaluate(self, many: list[Gains]) -> list[float]:
        """Costs, in order. Margins first: what is below the floors is not simulated."""
        new: dict[tuple[float, ...], Gains] = {}
        for gains in many:
            at = tuple(gains.values())
            if at in self._costs or at in new:
                continue
            lacking = self._lack(gains)
            if lacking > 0.0:
                self._refused += 1
                self._costs[at] = _BELOW * (1.0 + lacking)
            else:
                new[at] = gains
        left = self._tuning.evaluations - self._done
        simulated = list(new.items())[:left]
        results = self._evaluator(self._controller, [gains for _, gains in simulated])
        for (at, gains), parts in zip(simulated, results, strict=True):
            cost = sum(part.cost for part in parts)
            self._costs[at] = cost
            if self._best is None or cost < self._best[0]:
                self._best = (cost, gains, parts)
        self._done += len(simulated)
        self._idle = 0 if new else self._idle + 1
        if simulated and self._best is not None:
            self._say(self._controller, self._done, self._best[0])
        budget = self._tuning.evaluations
        if self._done >= budget or self._refused > _REFUSED * budget or self._idle > _IDLE:
            raise _SpentError
        return [self._costs[tuple(gains.values())] for gains in many]

    def _lack(self, gains: Gains) -> float:
        at = tuple(gains.values())
        if at not in self._lacks:
            self._lacks[at] = lack(self._configured(gains), self._controller)
        return self._lacks[at]

    def _configured(self, gains: Gains) -> Config:
        data = self._config.model_dump()
        for key, value in gains.items():
            *parents, last = key.split(".")
            place = data["control"]
            for part in parents:
                place = place[part]
            place[last] = value
        return Config.model_validate(data)

    def _rounded(self, point: Array) -> Gains:
        values = np.exp(np.clip(point, self._low, self._high))
        return {
            key: float(f"{value:.{_DIGITS}g}")
            for key, value in zip(self._keys, values, strict=True)
        }


def _unused(point: Array) -> float:
    raise NotImplementedError("generations are evaluated by Search._map")
