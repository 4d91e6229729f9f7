"""Solve a stop in two stages: least peak speed, then least peak tension at about that speed."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tests.bench.least_stop.begin import damping, played, resampled, standing, still
from tests.bench.least_stop.grid import UNLOADED, Grid
from tests.bench.least_stop.model import Model
from tests.bench.least_stop.problem import Case, Problem, Solution

Array = NDArray[np.float64]
STARTS = ("still", "damping", "standing")
"""where the optimiser begins: nothing moves; drums that damp; drums that stand"""
LOADED_STARTS = (*STARTS, "growing", "short")
"""and under a load: the optima of smaller loads, one after the other; that of the unloaded grid"""
SLOWER = 1.02
"""the peak tension is made small among stops with up to so many times the least peak speed"""
_ANY_SPEED = 5.0
"""m/s"""
_SHARES = (0.0, 0.3, 0.6)
"""of a load that grows"""


class Solver:
    """Model and programme of a robot whose tensions are bounded by ``tension`` N."""

    def __init__(
        self, model: Model, tension: float, grid: Grid = UNLOADED, *, iterations: int = 200
    ) -> None:
        self.model, self._tension, self._iterations = model, tension, iterations
        self.problem = Problem(model, grid, iterations=iterations)

    @cached_property
    def _short(self) -> Solver:
        return Solver(self.model, self._tension, iterations=self._iterations)

    def begin(self, case: Case, start: str) -> Array:
        """The vector of unknowns to start from; a law that ran away is cut to size."""
        problem = self.problem
        if start == "still":
            return problem.unknowns(case, still(case, problem.grid))
        if start == "growing":
            return self._grown(case)
        if start == "short":
            found = self._short.fast(case, self._short.begin(case, "still"))
            return problem.unknowns(case, resampled(found, UNLOADED, problem.grid))
        law = damping(12.0, 60.0) if start == "damping" else standing()
        states = np.clip(played(self.model, case, law, problem.grid), -1.0, 1.0)
        return problem.unknowns(case, states)

    def _grown(self, case: Case) -> Array:
        unknowns = self.begin(case, "still")
        for share in _SHARES:
            x, y, z = (share * newtons for newtons in case.push.force)
            smaller = replace(case, push=replace(case.push, force=(x, y, z)))
            unknowns = self.fast(smaller, unknowns).unknowns
        return unknowns

    def fast(self, case: Case, begin: Array) -> Solution:
        """The stop of least peak speed."""
        return self.problem.solve(
            case,
            begin,
            weights=(2.0, 0.0),
            speed_limit=_ANY_SPEED,
            tension_limit=self._tension,
        )

    def solve(self, case: Case, start: str) -> tuple[Solution, Solution]:
        """The stop of least peak speed, and the one of least peak tension about that fast."""
        fast = self.fast(case, self.begin(case, start))
        gentle = self.problem.solve(
            case,
            fast.unknowns,
            weights=(0.0, 0.3),
            speed_limit=SLOWER * fast.peak_speed,
            tension_limit=self._tension,
        )
        return fast, gentle
