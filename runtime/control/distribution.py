"""Tension distribution: n cables, six wrench components, one quadratic programme.

minimise    |T - T_c|^2 + rho (g . (T - T_c))^2 + weight |S (W T - w)|^2
subject to  low <= T <= high

The wrench equality is soft, so a solution always exists; what was not delivered is reported as the
deficit. S divides moments by a characteristic length. T_c carries the co-contraction: along the
null space of W the cables pull against each other towards it. The row g prefers, among the ways to
deliver a wrench, those that keep the geometric stiffness g . T along it at T_c's.

The minimiser without bounds is one linear solve. Where it lies within the bounds it is the answer;
where it does not, a solver of `tonus.runtime.control.programme` finds the correction that the
bounds demand, by DAQP or by Clarabel. Where DAQP has no answer that is proven, Clarabel is asked.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.control import Distribution as Settings
from tonus.runtime.control.distribution_kernels import SCALE, TARGET, deliver, solve
from tonus.runtime.control.programme import ActiveSet, InteriorPoint
from tonus.runtime.signals import Solver

Array = NDArray[np.float64]
# Looked up once: a member of an enumeration takes ten times as long as a name (Python 3.11).
_INTERIOR = Solver.INTERIOR


class TensionDistribution:
    """Gives tensions (n,) in N that lie in their bounds, always."""

    def __init__(self, settings: Settings, moment_length: float, cables: int) -> None:
        self.iterations = 0
        self.solver = Solver.NONE
        self.deficit = 0.0
        """N, norm of the scaled wrench that the tensions miss"""
        self.weights = (settings.wrench_weight, math.sqrt(settings.stiffness_weight))
        """of the wrench, and of the row that prefers stiffness"""
        self.wrenches = np.zeros((3, 6))
        """rows SCALE, TARGET and DELIVERED"""
        self.wrenches[SCALE] = [1.0] * 3 + [1.0 / moment_length] * 3
        self.scaled, self.normal = np.zeros((6, cables)), np.zeros((cables, cables))
        """the structure matrix times the scale, and H of the programme"""
        self._target = self.wrenches[TARGET]
        self._kept = (
            *self.weights,
            self.wrenches[SCALE],
            self.normal,
            self.scaled,
            self._target,
        )
        self._none = np.zeros(cables)
        self._active_set = ActiveSet(settings, cables) if settings.solver == "daqp" else None
        self._interior_point = InteriorPoint(settings, cables)

    def __call__(
        self,
        matrix: Array,
        wrench: Array,
        centre: Array,
        low: Array,
        high: Array,
        gradient: Array | None = None,
    ) -> Array:
        """``matrix`` (6, n), ``wrench`` (6,), ``centre``, ``low``, ``high`` (n,) in N, ``gradient``
        (n,) in 1/m: g, None for no preference.

        If no solver has an answer within the iteration limit, the closed form round ``centre``
        (Pott, Bruckmann and Mikelsons 2009), clipped to the bounds, takes its place, and `solver`
        says so.
        """
        tensions = np.empty(len(centre))
        inside, finite, deficit = solve(
            matrix,
            wrench,
            low,
            high,
            centre,
            self._none if gradient is None else gradient,
            *self._kept,
            tensions,
        )
        if inside and finite:
            self.found(deficit)
            return tensions
        return self.bounded(tensions, centre, low, high, inside=inside)

    def found(self, deficit: float) -> None:
        """The free minimiser is the answer, and misses ``deficit`` (N) of the wrench."""
        self.solver, self.iterations, self.deficit = _INTERIOR, 0, deficit

    def bounded(
        self, tensions: Array, centre: Array, low: Array, high: Array, *, inside: bool
    ) -> Array:
        """The answer where the free minimiser ``tensions`` is none: it lies beyond the bounds, or
        it is ``inside`` and no number."""
        finite = False
        if inside:
            self.iterations, self.deficit = 0, math.inf
        else:
            scaled, target = self.scaled, self._target
            tensions = self._bounded(tensions, scaled, target, centre, low, high)
            finite, self.deficit = deliver(scaled, target, low, high, tensions)
        if not finite:
            # A centre that is no number becomes the lower bound; `np.clip` would keep it.
            self.solver, tensions = Solver.FALLBACK, np.fmin(np.fmax(centre, low), high)
        return tensions

    def _bounded(
        self, free: Array, matrix: Array, wrench: Array, centre: Array, low: Array, high: Array
    ) -> Array:
        self.solver = Solver.OPTIMAL
        if self._active_set is not None:
            found, self.iterations = self._active_set(self.normal, free, low, high)
            if found is not None:
                return found
            self.solver = Solver.REFERENCE
        found, self.iterations = self._interior_point(self.normal, free, low, high)
        if found is not None:
            return found
        self.solver = Solver.FALLBACK
        return closed_form(matrix, wrench, centre)


def closed_form(matrix: Array, wrench: Array, centre: Array) -> Array:
    """Tensions nearest to ``centre`` that balance the wrench, bounds ignored."""
    normal = matrix @ matrix.T + 1e-9 * np.eye(len(wrench))
    return np.asarray(centre + matrix.T @ np.linalg.solve(normal, wrench - matrix @ centre))
