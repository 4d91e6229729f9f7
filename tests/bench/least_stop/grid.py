"""The programme's intervals of time, in its two phases."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
DELAY = 0.003
"""s from the break to the first torque that knows of it: noticed in the tick after the sample, a
command acts one tick later still"""


@dataclass(frozen=True)
class Grid:
    """Lengths of intervals in s, from the break on."""

    early: tuple[float, ...]
    """drums and cables are as they are"""
    late: tuple[float, ...]
    """the tensions themselves are the control"""

    @cached_property
    def steps(self) -> Array:
        return np.array(self.early + self.late)

    @cached_property
    def times(self) -> Array:
        """s, of the nodes: one more than there are intervals."""
        return np.concatenate([[0.0], np.cumsum(self.steps)])


UNLOADED = Grid((DELAY,) + (0.003,) * 20, (0.008,) * 10 + (0.020,) * 28)
"""0.7 s; the peak comes in the first 63 ms"""
LOADED = Grid((DELAY,) + (0.003,) * 60, (0.020,) * 26)
"""0.7 s: while a load pushes, the drums' inertia counts for longer"""
