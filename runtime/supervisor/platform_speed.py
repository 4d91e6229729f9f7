"""How fast the platform moves, by what drums and cables show of it."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from tonus.config import Config
from tonus.runtime.supervisor.observation import Observation
from tonus.runtime.supervisor.record import Floats

_LOOKS = 2
"""over which a tension's change is taken"""


class PlatformSpeed:
    """The least speed and turning rate that any of the poses tried needs."""

    def __init__(self, config: Config) -> None:
        robot, settings = config.robot, config.supervisor
        assert settings is not None
        self._slack = config.control.tension.slack
        self._rows, lengths = _rows(config, settings.spread)
        self._inverted: dict[bytes, Floats] = {}
        """of these rows, by the cables that tell"""
        self._compliance = lengths / robot.axial_stiffness
        """m/N of each cable, in the middle of the workspace"""
        # Of looks that come as late as SUP-24 lets them; what lies between is not known.
        self._longest_ns = round(_LOOKS * settings.longest_look_ms * 1e6)
        self._tensions: deque[tuple[int, Floats]] = deque(maxlen=_LOOKS + 1)

    def __call__(
        self,
        seen: Observation,
        rates: Floats,
        telling: NDArray[np.bool_] | None = None,
        stretching: Floats | float = 0.0,
    ) -> tuple[float, ...]:
        """In m/s and rad/s, for drums that reel in at these ``rates``, m/s, cables that stretch as
        `stretching` says; not a number where a rate is not known. ``telling``: which cables count;
        else all but those without power that are slack, whose drums turn by themselves. None counts
        whose encoder reports what no motor can make."""
        if len(rates) != self._rows.shape[1]:
            return math.nan, math.nan  # some of the axes are on another bus
        if telling is None:
            telling = seen.enabled | ~(seen.tension < self._slack)
        told = np.empty(len(rates), bool)
        told[seen.axes] = telling & ~seen.incredible
        rate = np.empty(len(rates))
        rate[seen.axes] = rates - stretching
        key = told.tobytes()
        if key not in self._inverted:
            self._inverted[key] = np.linalg.pinv(self._rows[:, told]).astype(np.float64)
        twists = (self._inverted[key] @ rate[told]).reshape(-1, 2, 3)
        speeds: list[float] = np.sqrt((twists**2).sum(axis=2).min(axis=0)).tolist()
        return tuple(speeds)

    def stretching(self, seen: Observation) -> Floats:
        """m/s by which each cable grows longer by its tension (n,), over the last looks; 0 where
        that is not known. Call it once a look."""
        kept = self._tensions
        kept.append((seen.now_ns, seen.tension))
        (first_ns, first), (last_ns, last) = kept[0], kept[-1]
        if not 0 < last_ns - first_ns <= self._longest_ns:
            return np.zeros(len(last))
        with np.errstate(invalid="ignore"):
            change = (last - first) / ((last_ns - first_ns) * 1e-9)
        return np.where(np.isfinite(change), change, 0.0) * self._compliance[seen.axes]


def _rows(config: Config, spread: float) -> tuple[Floats, Floats]:
    """From the platform's velocity and angular velocity (6,) to the rates of the cables (n,),
    reeling in, at each of 27 poses round the workspace's middle: the structure matrix, transposed
    (27, n, 6); and their lengths (n,) there, in m."""
    geometry = config.robot.geometry
    frame, platform = np.array(geometry.frame), np.array(geometry.platform)
    space = config.robot.workspace
    middle = np.array([sum(space.x), sum(space.y), sum(space.z)]) / 2.0
    steps = np.array(np.meshgrid(*[(-spread, 0.0, spread)] * 3)).reshape(3, -1).T
    found = []
    for position in middle + steps:
        along = frame - position - platform
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        found.append(np.hstack([along, np.cross(platform, along)]))
    lengths: Floats = np.linalg.norm(frame - middle - platform, axis=1)
    return np.array(found), lengths
