"""Drum angles that the daemon records against the positions that drives answer on the bus."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from tonus.config.schema.supervisor import Supervisor
from tonus.runtime.supervisor.record import CONTROLLED, Claim, Floats
from tonus.runtime.supervisor.wiring import Axis

_STILL = 0.2
"""of ``logged_length``, by which a drum that stands may turn"""


class Lengths:
    """How far the recorded length of each cable is outside of those on the bus lately. Both begin
    anywhere, so what they differed by when the drum stood last before the robot came under control
    is what they may differ by."""

    def __init__(self, axes: list[Axis], settings: Supervisor, tick_ns: int) -> None:
        self._numbers = np.array([axis.number for axis in axes], np.int64)
        self._radius = np.array([math.nan if a.radius is None else a.radius for a in axes])
        kept_ms = settings.patience_ms + settings.period_ms
        self._kept_ns = round(kept_ms * 1e6) + settings.logged_ticks * tick_ns
        self._still = _STILL * settings.logged_length
        self._lately: deque[tuple[int, Floats]] = deque()
        """when each look was, and the lengths on the bus (n,) m, for as long as a record may be
        behind"""
        self._apart = np.full(len(axes), np.nan)
        """m (n,)"""

    def __call__(self, now_ns: int, length: Floats, claim: Claim | None) -> Floats:
        """m (n,), from the newest ``length`` (n,) on the bus and the newest record; not a number
        where it is not known."""
        lately = self._lately
        lately.append((now_ns, length))
        while len(lately) > 1 and now_ns - lately[1][0] >= self._kept_ns:
            lately.popleft()
        if claim is None:
            return np.full(len(length), np.nan)
        recorded = claim.angle[self._numbers] * self._radius
        bus = np.array([each for _, each in lately])
        low, high = bus.min(axis=0), bus.max(axis=0)
        # Of a drum that turns a record that is behind would be taken for one that is elsewhere.
        anew = (claim.state not in CONTROLLED) & (high - low <= self._still)
        self._apart = np.where(anew | ~np.isfinite(self._apart), length - recorded, self._apart)
        with np.errstate(invalid="ignore"):
            place = recorded + self._apart
            off: Floats = np.maximum(place - high, low - place)
        known = np.isfinite(length * self._radius)
        off[known & ~np.isfinite(claim.angle[self._numbers])] = np.inf
        return off
