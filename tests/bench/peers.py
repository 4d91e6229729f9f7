"""Other solvers behind one call: min 1/2 x'Px + q'x, low <= x <= high, for eight unknowns.

Each is built once where it can be, and then only updated. Those that are not installed are left
out; `make bench` has them all. quadprog is under the GPL: nothing but this bench imports it.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Array = NDArray[np.float64]
Solve = Callable[[Array, Array, Array, Array], Array]
SIZE = 8


def _quadprog() -> Solve:
    solver = import_module("quadprog")
    eye = np.eye(SIZE)
    sides = np.hstack([eye, -eye])

    def solve(p: Array, q: Array, low: Array, high: Array) -> Array:
        return np.asarray(solver.solve_qp(p, -q, sides, np.concatenate([low, -high]))[0])

    return solve


def _daqp() -> Solve:
    solver = import_module("daqp")
    nothing, kinds = np.zeros((0, SIZE)), np.zeros(SIZE, dtype=np.int32)

    def solve(p: Array, q: Array, low: Array, high: Array) -> Array:
        return np.asarray(solver.solve(p, q, nothing, high, low, kinds)[0])

    return solve


def _osqp() -> Solve:
    solver = import_module("osqp").OSQP()
    upper = np.triu_indices(SIZE)
    pattern = sparse.csc_matrix(np.triu(np.ones((SIZE, SIZE))) + SIZE * np.eye(SIZE))
    order = np.lexsort((upper[0], upper[1]))
    rows, columns = upper[0][order], upper[1][order]
    options: dict[str, Any] = {"eps_abs": 1e-6, "eps_rel": 1e-9, "max_iter": 20_000}
    ones = np.ones(SIZE)
    solver.setup(
        pattern, np.zeros(SIZE), sparse.eye(SIZE, format="csc"), -ones, ones,
        verbose=False, **options,
    )  # fmt: skip

    def solve(p: Array, q: Array, low: Array, high: Array) -> Array:
        solver.update(Px=p[rows, columns], q=q, l=low, u=high)
        return np.asarray(solver.solve(raise_error=False).x)

    return solve


def _piqp() -> Solve:
    module = import_module("piqp")
    solver = module.DenseSolver()
    solver.settings.verbose = False
    built = False

    def solve(p: Array, q: Array, low: Array, high: Array) -> Array:
        nonlocal built
        if built:
            solver.update(P=p, c=q, x_l=low, x_u=high)
        else:
            solver.setup(p, q, x_l=low, x_u=high)
            built = True
        solver.solve()
        return np.asarray(solver.result.x)

    return solve


def _proxqp() -> Solve:
    dense = import_module("proxsuite").proxqp.dense
    solver = dense.QP(SIZE, 0, 0, True)
    solver.settings.eps_abs = 1e-8
    built = False

    def solve(p: Array, q: Array, low: Array, high: Array) -> Array:
        nonlocal built
        given: dict[str, Any] = {"H": p, "g": q, "l_box": low, "u_box": high}
        if built:
            solver.update(**given)
        else:
            solver.init(H=p, g=q, A=None, b=None, C=None, l=None, u=None, l_box=low, u_box=high)
            built = True
        solver.solve()
        return np.asarray(solver.results.x)

    return solve


PEERS: dict[str, tuple[str, Callable[[], Solve]]] = {
    "quadprog": ("GPL-2.0-or-later", _quadprog),
    "DAQP": ("MIT", _daqp),
    "OSQP": ("Apache-2.0", _osqp),
    "PIQP": ("BSD-2-Clause", _piqp),
    "ProxQP": ("BSD-2-Clause", _proxqp),
}
"""Name, licence, how to build one."""


def improved_closed_form(
    matrix: Array, wrench: Array, centre: Array, low: Array, high: Array
) -> Array:
    """Pott 2013: nearest to the centre; while a cable is beyond a bound, the worst one is fixed
    there and the rest takes up what is left. Gives what it has when six cables are all that is
    left, bounds kept or not: it knows no compromise."""
    tensions = centre.copy()
    free = np.ones(len(centre), dtype=bool)
    left = wrench.copy()
    while True:
        pull = matrix[:, free]
        middle = centre[free]
        step = np.linalg.solve(pull @ pull.T, left - pull @ middle)
        tensions[free] = middle + pull.T @ step
        beyond = np.maximum(low - tensions, tensions - high)
        beyond[~free] = 0.0
        worst = int(beyond.argmax())
        if beyond[worst] <= 0.0 or free.sum() <= matrix.shape[0]:
            return tensions
        tensions[worst] = low[worst] if tensions[worst] < low[worst] else high[worst]
        free[worst] = False
        left = wrench - matrix[:, ~free] @ tensions[~free]
