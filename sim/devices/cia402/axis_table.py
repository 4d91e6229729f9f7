"""What a new set-point of cyclic synchronous torque needs of every axis, in arrays.

Nearly every set-point finds its drive as the last one did: the controlword is the same, and the
current is within what may flow. Those are applied here for many axes at once; of all others
`AxisTable.apply` says so and changes nothing. The drives keep the rows up to date.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]

NO_WORD = -1
DONE, TARGET, OFFSET, DRIVING, LIMITED = range(5)
"""Rows of `AxisTable.integers`: controlword that changes nothing if it comes again, or `NO_WORD`;
target torque and its offset (per mille of the rated torque); whether set-points become current;
whether the last one was limited."""
PER_MILLE, LOW, HIGH = range(3)
"""Rows of `AxisTable.currents`, in A: for one per mille, and what may flow."""


@njit(cache=True)
def follow(
    integers: Integers, currents: Floats, reference: Floats, axis: int, word: int, torque: int
) -> bool:
    """Apply controlword and target torque; False: the drive has to do it."""
    if integers[DONE, axis] != word:
        return False
    if torque == integers[TARGET, axis]:
        return True
    if integers[DRIVING, axis]:
        current = (torque + integers[OFFSET, axis]) * currents[PER_MILLE, axis]
        if integers[LIMITED, axis] or not currents[LOW, axis] <= current <= currents[HIGH, axis]:
            return False
        reference[axis] = current
    integers[TARGET, axis] = torque
    return True


@njit(
    "int64(int64[:, ::1], float64[:, ::1], float64[::1], int64[::1], int64[:], int64[:],"
    " int64[::1])",
    cache=True,
)
def _apply(
    integers: Integers,
    currents: Floats,
    reference: Floats,
    axes: Integers,
    words: Integers,
    torques: Integers,
    left: Integers,
) -> int:
    count = 0
    for i in range(axes.shape[0]):
        if not follow(integers, currents, reference, axes[i], words[i], torques[i]):
            left[count] = i
            count += 1
    return count


class AxisTable:
    """``reference``: the plant's current references, A (n,)."""

    def __init__(self, reference: Floats) -> None:
        axes = len(reference)
        self.reference = reference
        self.integers = np.zeros((5, axes), np.int64)
        self.integers[DONE] = NO_WORD
        self.currents = np.zeros((3, axes))
        self._left = np.zeros(axes, np.int64)

    def apply(self, axes: Integers, words: Integers, torques: Integers) -> list[int]:
        """Controlword and target torque of each of ``axes``, (m,) each. Returns the places of those
        whose drives have to apply them themselves."""
        left = self._left
        count = _apply(self.integers, self.currents, self.reference, axes, words, torques, left)
        return left[:count].tolist() if count else []
