"""The two solvers of the tension programme where a bound matters.

Both are asked for the correction x of the free minimiser T_f: minimise x' H x with T_f + x within
the bounds, so that the objective is zero where the bounds demand nothing. Neither remembers
anything: a tick's answer depends on that tick alone.

H >= I, hence a tension T within its bounds is no further from the optimum than the norm of what the
optimality conditions leave over there (Karush, Kuhn and Tucker): of the slope H (T - T_f), all of
it for a cable between its bounds, and for one at a bound what points inwards. `ActiveSet` computes
that for every answer, and gives none that is not proven to be near enough.
"""

from __future__ import annotations

import math

import clarabel
import daqp
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from tonus.config.schema.control import Distribution as Settings

Array = NDArray[np.float64]
_OPTIMAL = 1
"""DAQP's exit flag; 2 is of soft bounds, of which there are none, and below 0 there is no answer"""
_FEASIBLE, _DUAL = 1e-10, 1e-12
"""N beyond a bound, and N of slope inwards, that DAQP takes for nothing: a bound that it leaves by
more would tilt the slope of all other cables, ten thousand times as far, when it is put right"""


@njit(cache=True)
def corrected(
    normal: Array,
    free: Array,
    low: Array,
    high: Array,
    correction: Array,
    multipliers: Array,
    tensions: Array,
) -> float:
    """Put ``free`` + ``correction`` into ``tensions``, those at a bound to its last bit, and return
    how far from the optimum they can be (N), not a number where they are none. A bound's entry in
    ``multipliers`` is positive for ``high``, negative for ``low``, else zero."""
    for i in range(free.shape[0]):
        tensions[i] = min(max(free[i] + correction[i], low[i]), high[i])
        if multipliers[i] > 0.0:
            tensions[i] = high[i]
        elif multipliers[i] < 0.0:
            tensions[i] = low[i]
    total = 0.0
    for i in range(free.shape[0]):
        slope = 0.0
        for j in range(free.shape[0]):
            slope += normal[i, j] * (tensions[j] - free[j])
        if tensions[i] <= low[i]:
            slope = min(slope, 0.0)
        if tensions[i] >= high[i]:
            slope = max(slope, 0.0)
        total += slope * slope
    return math.sqrt(total)


class ActiveSet:
    """DAQP, a dual active-set method (Arnström, Bemporad and Axehill 2022): exact after as many
    steps as bounds change sides, and a few microseconds."""

    def __init__(self, settings: Settings, cables: int) -> None:
        self._most, self._largest = settings.maximum_iterations, settings.largest_error
        self._rows, self._linear = np.zeros((0, cables)), np.zeros(cables)
        self._kinds = np.zeros(cables, dtype=np.intc)

    def __call__(
        self, normal: Array, free: Array, low: Array, high: Array
    ) -> tuple[Array | None, int]:
        """Tensions (n,), None for no proven ones, and the iterations; ``normal``: H (n, n)."""
        correction, _, flag, told = daqp.solve(
            normal,
            self._linear,
            self._rows,
            high - free,
            low - free,
            self._kinds,
            primal_tol=_FEASIBLE,
            dual_tol=_DUAL,
            iter_limit=self._most,
        )
        taken = int(told["iterations"])
        if flag != _OPTIMAL:
            return None, taken
        tensions = np.empty(len(free))
        error = corrected(normal, free, low, high, correction, told["lam"], tensions)
        return (tensions if error <= self._largest else None), taken


class InteriorPoint:
    """Clarabel, an interior-point method: from nothing each time, in some ten iterations, and as
    near as its relative gap says. Its n unknowns and 2 n bounds never change their sparsity: it is
    built once, updated for each tick, and bounded by iterations, never by time."""

    def __init__(self, settings: Settings, cables: int) -> None:
        self._none = np.zeros(cables)
        self._room = np.zeros(2 * cables)
        # Clarabel stores the upper triangle column by column: the lower one row by row.
        self._triangle = np.flatnonzero(np.tri(cables))
        self._programme = self._build(settings, cables)

    def _build(self, settings: Settings, cables: int) -> clarabel.DefaultSolver:
        options = clarabel.DefaultSettings()
        options.verbose = False
        options.presolve_enable = False
        options.max_iter = settings.maximum_iterations
        options.time_limit = float("inf")
        options.tol_gap_abs = options.tol_gap_rel = options.tol_feas = settings.tolerance
        options.max_threads = 1
        # A dozen well-scaled unknowns need neither, and they are a quarter of the time.
        options.equilibrate_enable = options.iterative_refinement_enable = False
        cost = sparse.triu(np.ones((cables, cables)) + cables * np.eye(cables)).tocsc()
        eye = sparse.eye_array(cables, format="csc")
        constraints = sparse.csc_array(sparse.vstack([eye, -eye]))
        cones = [clarabel.NonnegativeConeT(2 * cables)]
        start = np.concatenate([np.ones(cables), np.zeros(cables)])
        return clarabel.DefaultSolver(
            cost, np.zeros(cables), sparse.csc_matrix(constraints), start, cones, options
        )

    def __call__(
        self, normal: Array, free: Array, low: Array, high: Array
    ) -> tuple[Array | None, int]:
        """As `ActiveSet`."""
        # What has no room is known. In its place the programme has a correction that is zero by
        # itself, and room to be zero in, which keeps its interior from vanishing.
        fixed, count = high <= low, len(low)
        linear = self._none
        if fixed.any():
            linear = np.where(fixed, 0.0, normal @ np.where(fixed, low - free, 0.0))
            normal = np.where(fixed | fixed[:, None], np.eye(count), normal)
        self._room[:count] = np.where(fixed, 1.0, high - free)
        self._room[count:] = np.where(fixed, 1.0, free - low)
        self._programme.update(P=normal.take(self._triangle), q=linear, b=self._room)
        solution = self._programme.solve()
        solved = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
        if solution.status not in solved:
            return None, solution.iterations
        return np.where(fixed, low, free + np.array(solution.x)), solution.iterations
