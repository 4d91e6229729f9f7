"""Tension distribution: eight cables, six wrench components, one quadratic programme a tick.

minimise  |T - T_c|^2 + weight |S (W T - w)|^2   subject to  low <= T <= high

The wrench equality is soft, so a solution always exists; what was not delivered is reported as the
deficit. S divides moments by a characteristic length. T_c carries the co-contraction: along the
null space of W the cables pull against each other towards it. Eliminating the slack of the equality
leaves eight unknowns and sixteen bounds, whose sparsity never changes: the problem is built once,
from configuration alone (results then depend on no history), and updated each tick.
"""

from __future__ import annotations

import math

import clarabel
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from config.schema.control import Distribution as Settings
from config.schema.robot import CABLES
from runtime.signals import Solver

Array = NDArray[np.float64]


@njit(cache=True)
def _assemble(
    matrix: Array,
    wrench: Array,
    centre: Array,
    weight: float,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    quadratic: Array,
    linear: Array,
) -> None:
    """Cost of the programme: upper triangle of I + weight W^T W, and -T_c - weight W^T w."""
    for k in range(rows.shape[0]):
        i, j = rows[k], columns[k]
        total = 0.0
        for row in range(6):
            total += matrix[row, i] * matrix[row, j]
        quadratic[k] = weight * total + (1.0 if i == j else 0.0)
    for i in range(centre.shape[0]):
        total = 0.0
        for row in range(6):
            total += matrix[row, i] * wrench[row]
        linear[i] = -centre[i] - weight * total


@njit(cache=True)
def _deliver(
    matrix: Array, wrench: Array, low: Array, high: Array, tensions: Array
) -> tuple[bool, float]:
    """Put the tensions into their bounds to the last bit; whether all are numbers, and the norm of
    the wrench they miss."""
    for i in range(tensions.shape[0]):
        if not math.isfinite(tensions[i]):
            return False, math.inf
        tensions[i] = min(max(tensions[i], low[i]), high[i])
    total = 0.0
    for row in range(6):
        miss = -wrench[row]
        for i in range(tensions.shape[0]):
            miss += matrix[row, i] * tensions[i]
        total += miss * miss
    return True, math.sqrt(total)


class TensionDistribution:
    """Gives tensions (8,) in N that lie in their bounds, always."""

    def __init__(self, settings: Settings, moment_length: float) -> None:
        self.iterations = 0
        self.solver = Solver.NONE
        self.deficit = 0.0
        """N, norm of the scaled wrench that the tensions miss"""
        self._weight = settings.wrench_weight
        self._scale = np.array([1.0] * 3 + [1.0 / moment_length] * 3)
        self._column = self._scale[:, None]
        # Clarabel stores the upper triangle column by column.
        self._columns, self._rows = np.tril_indices(CABLES)
        self._quadratic = np.zeros(len(self._rows))
        self._linear = np.zeros(CABLES)
        self._bounds = np.zeros(2 * CABLES)
        self._programme = self._build(settings)

    def _build(self, settings: Settings) -> clarabel.DefaultSolver:
        options = clarabel.DefaultSettings()
        options.verbose = False
        options.presolve_enable = False
        options.max_iter = settings.maximum_iterations
        options.time_limit = float("inf")
        options.tol_gap_abs = options.tol_gap_rel = options.tol_feas = settings.tolerance
        options.max_threads = 1
        cost = sparse.triu(np.ones((CABLES, CABLES)) + CABLES * np.eye(CABLES)).tocsc()
        eye = sparse.eye_array(CABLES, format="csc")
        constraints = sparse.csc_array(sparse.vstack([eye, -eye]))
        cones = [clarabel.NonnegativeConeT(2 * CABLES)]
        start = np.concatenate([np.ones(CABLES), np.zeros(CABLES)])
        return clarabel.DefaultSolver(
            cost, np.zeros(CABLES), sparse.csc_matrix(constraints), start, cones, options
        )

    def __call__(
        self, matrix: Array, wrench: Array, centre: Array, low: Array, high: Array
    ) -> Array:
        """``matrix`` (6, 8), ``wrench`` (6,), ``centre``, ``low``, ``high`` (8,) in N.

        If no solution comes back within the iteration limit, the closed form round ``centre``
        (Pott, Bruckmann and Mikelsons 2009), clipped to the bounds, takes its place, and `solver`
        says so.
        """
        scaled = matrix * self._column
        target = wrench * self._scale
        _assemble(
            scaled,
            target,
            centre,
            self._weight,
            self._rows,
            self._columns,
            self._quadratic,
            self._linear,
        )
        self._bounds[:CABLES] = high
        np.negative(low, out=self._bounds[CABLES:])
        self._programme.update(P=self._quadratic, q=self._linear, b=self._bounds)
        solution = self._programme.solve()
        self.iterations = solution.iterations
        if solution.status in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
            self.solver = Solver.OPTIMAL
            tensions: Array = np.array(solution.x)
        else:
            self.solver = Solver.FALLBACK
            tensions = closed_form(scaled, target, centre)
        finite, self.deficit = _deliver(scaled, target, low, high, tensions)
        if not finite:
            self.solver, tensions = Solver.FALLBACK, np.clip(centre, low, high)
        return tensions


def closed_form(matrix: Array, wrench: Array, centre: Array) -> Array:
    """Tensions nearest to ``centre`` that balance the wrench, bounds ignored."""
    normal = matrix @ matrix.T + 1e-9 * np.eye(len(wrench))
    return np.asarray(centre + matrix.T @ np.linalg.solve(normal, wrench - matrix @ centre))
