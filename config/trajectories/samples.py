"""Rows of time, pose and its derivatives, packed into a text and unpacked again."""

from __future__ import annotations

import zlib
from base64 import b64decode, b64encode
from binascii import Error

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.trajectory import Samples

Array = NDArray[np.float64]
COLUMNS = 19
HOME_TOLERANCE = 1e-6
"""m and rad: what a first pose may be away from home, level, without an approach"""


class TrajectoryError(Exception):
    """A reference that cannot be prepared; ``key`` is the one below ``reference`` at fault."""

    def __init__(self, key: str, problem: str, remedy: str) -> None:
        super().__init__(problem)
        self.key, self.problem, self.remedy = key, problem, remedy


def packed(times: Array, pose: Array, rate: Array, acceleration: Array) -> Samples:
    """``times`` (n,) s; ``pose``, ``rate``, ``acceleration`` (n, 6): offset, rotation vector."""
    three = (pose, rate, acceleration)
    parts = [times[:, None], *(each[:, :3] for each in three), *(each[:, 3:] for each in three)]
    rows = np.ascontiguousarray(np.hstack(parts), dtype="<f8")
    return Samples(rows=len(rows), data=b64encode(zlib.compress(rows.tobytes(), 6)).decode())


def unpacked(samples: Samples) -> Array:
    """(n, 19), as `Samples` describes them. Raises `ValueError` for data that are no rows."""
    try:
        data = zlib.decompress(b64decode(samples.data, validate=True))
    except (Error, zlib.error) as error:
        raise ValueError(f"the samples are damaged: {error}") from error
    if len(data) != samples.rows * COLUMNS * 8 or samples.rows < 2:
        raise ValueError(f"the samples are damaged: {len(data)} bytes for {samples.rows} rows")
    return np.frombuffer(data, dtype="<f8").reshape(samples.rows, COLUMNS).astype(np.float64)


def splined(times: Array, pose: Array, approach: float) -> Samples:
    """Through ``pose`` (n, 6) at ``times`` (n,), at rest at both ends, after an ``approach`` (s)
    from home. Raises `TrajectoryError` where the first pose is not home and has no approach."""
    apart = float(np.abs(pose[0]).max())
    if approach == 0.0 and apart > HOME_TOLERANCE:
        raise TrajectoryError(
            "approach",
            f"the first pose is {apart:.4g} (m or rad) away from home, and there is no way to it",
            "set approach to the seconds that the way may take, or begin at home",
        )
    from scipy.interpolate import CubicSpline  # every command would wait for it, and few need it

    curve = CubicSpline(times, pose, bc_type="clamped")
    later = times - times[0] + approach
    rows = (later, curve(times), curve(times, 1), curve(times, 2))
    if approach == 0.0:
        rows[1][0] = 0.0
        return packed(*rows)
    # A minimum-jerk motion is a quintic at rest at its ends. Two rows at one time let the
    # acceleration change there.
    still = np.zeros((2, 6))
    way = (np.array([0.0, approach]), np.vstack([still[0], pose[0]]), still, still)
    return packed(*(np.concatenate(each) for each in zip(way, rows, strict=True)))
