"""Fewer points with the same picture: of every stretch of time, its lowest and highest value."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
POINTS = 900
"""stretches over the width of a picture"""


def thin(time: Array, values: NDArray[Any], points: int = POINTS) -> tuple[Array, Array]:
    """A curve (n,) as at most ``2 * points`` points through its extremes, in order of time.

    Extremes are kept exactly, so a spike of one tick stays. A stretch with nan only stays a gap.
    """
    if len(time) <= 2 * points:
        return time, np.asarray(values, np.float64)
    starts = np.unique(np.linspace(0, len(time), points, endpoint=False).astype(int))
    values = np.asarray(values, np.float64)
    known = ~np.isnan(values)
    low = np.minimum.reduceat(np.where(known, values, np.inf), starts)
    high = np.maximum.reduceat(np.where(known, values, -np.inf), starts)
    empty = low > high
    low[empty] = high[empty] = np.nan
    # Which extreme comes first makes no difference at less than a pixel, but a rising curve
    # shall rise.
    ends = np.append(starts[1:], len(time)) - 1
    falls = values[ends] < values[starts]
    first, second = np.where(falls, high, low), np.where(falls, low, high)
    return np.column_stack([time[starts], time[ends]]).ravel(), np.column_stack(
        [first, second]
    ).ravel()
