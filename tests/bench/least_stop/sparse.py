"""The programme's Jacobian, put together from equal blocks."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Places = NDArray[np.int64]


class Blocks:
    """A sparse matrix from vectors of values and their places; equal places add up."""

    def __init__(self, rows: int, columns: int) -> None:
        self._shape = (rows, columns)
        self._rows: list[Places] = []
        self._columns: list[Places] = []
        self._values: list[ca.MX] = []

    def constant(self, value: float, rows: Places, columns: Places) -> None:
        self._add(ca.MX(ca.DM(np.full(rows.size, value))), rows, columns)

    def stages(
        self,
        slopes: ca.MX,
        scale: Array,
        rows: Places,
        columns: Places,
        begin: int,
        factor: float,
    ) -> None:
        """Blocks of equal pattern side by side in ``slopes``, one for each row of ``rows`` and
        ``columns``; of their columns those from ``begin`` on, as many as ``columns`` names.
        ``scale`` (stages, rows or 1) and ``factor`` multiply the values."""
        number, width = columns.shape
        row, column = (np.array(each) for each in slopes.sparsity().get_triplet())
        one = row.size // number
        row, column = row[:one], column[:one]
        chosen = np.flatnonzero((column >= begin) & (column < begin + width))
        nonzero = (np.arange(number)[:, None] * one + chosen).ravel()
        factors = factor * np.broadcast_to(scale, rows.shape)[:, row[chosen]]
        values = slopes.nz[nonzero.tolist()] * ca.DM(factors.ravel())
        self._add(values, rows[:, row[chosen]], columns[:, column[chosen] - begin])

    def _add(self, values: ca.MX, rows: Places, columns: Places) -> None:
        assert values.numel() == rows.size == columns.size
        self._values.append(values)
        self._rows.append(rows.ravel())
        self._columns.append(columns.ravel())

    def matrix(self) -> ca.MX:
        rows, columns = np.concatenate(self._rows), np.concatenate(self._columns)
        height, width = self._shape
        places, at = np.unique(columns * height + rows, return_inverse=True)
        pattern = ca.Sparsity.triplet(
            height, width, (places % height).tolist(), (places // height).tolist()
        )
        order, ones = list(range(at.size)), ca.DM.ones(at.size)
        gather = ca.DM.triplet(at.ravel().tolist(), order, ones, len(places), at.size)
        return ca.MX(pattern, gather @ ca.vertcat(*self._values))
