"""A continuous linear system sampled, its inputs constant over each period."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm  # a tenth of the time that scipy.signal takes to load

Array = NDArray[np.float64]


def zero_order_hold(flow: Array, enter: Array, period: float) -> tuple[Array, Array]:
    """State matrix (n, n) and input matrix (n, m) of one period, for dx/dt = flow x + enter u.

    Van Loan, Computing Integrals Involving the Matrix Exponential (1978).
    """
    states, inputs = enter.shape
    both = np.zeros((states + inputs, states + inputs))
    both[:states] = period * np.hstack((flow, enter))
    both = expm(both)
    return both[:states, :states], both[:states, states:]
