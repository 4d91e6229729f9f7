"""What a stop after a torn cable may reach: twice the least that physics allows, from the table
that `make least-stop` computes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonus.config import load
from tonus.config.loader import load_least_stops
from tonus.config.schema.least_stop import LeastStops, Stop, Tear
from tonus.config.schema.robot import Geometry
from tonus.tools.campaign.observed import Observed

TEAR = "cable_cut"
"""kind of a fault"""
FACTOR = 2.0
"""of the optimum"""


@dataclass(frozen=True)
class Limits:
    """What physics allows in one case, where that is more than the common bounds."""

    speed: float
    """m/s, of the platform's origin"""
    tension: float
    """N, of every cable"""


Allowance = Callable[[Observed], Limits | None]
"""Gives wider limits for a case in which nobody could keep the common ones; None: they hold."""


def for_torn_cables(run: Observed) -> Limits | None:
    """The widest of its torn cables', where the robot has the geometry that the table is for."""
    geometry, table = run.config.robot.geometry, _table()
    torn = [(strike, axis) for strike in run.strikes for axis in strike.axes if strike.kind == TEAR]
    if not torn or not len(run.truth) or geometry != _shipped():
        return None
    limits = []
    for strike, axis in torn:
        row = min(int(np.searchsorted(run.truth_ns, strike.at_ns)), len(run.truth) - 1)
        before = run.truth[row]
        limits.append(allowance(geometry, axis, before["position"], before["velocity"], table))
    return Limits(max(each.speed for each in limits), max(each.tension for each in limits))


def optimum(
    geometry: Geometry,
    cable: int,
    position: ArrayLike,
    velocity: ArrayLike,
    table: LeastStops | None = None,
) -> Stop:
    """The table's entry for ``cable`` (from 0): of the motion that ``velocity`` (m/s) along the way
    to the torn cable's anchor is nearest to, at the pose nearest to ``position`` (m) that has one.
    Raises `ValueError` where the table has none."""
    table = table or _table()
    place = np.asarray(position, dtype=np.float64)
    way = np.array(geometry.frame[cable]) - place
    along = float(np.dot(np.asarray(velocity, dtype=np.float64), way) / np.linalg.norm(way))
    share = along / table.speed_limit
    known = [(tear, _motion(tear, share)) for tear in table.tears if tear.cable == cable]
    stops = [(_distance(place, tear), stop) for tear, stop in known if stop is not None]
    if not stops:
        raise ValueError(f"config/least_stop.yaml has no such stop of cable {cable}")
    return min(stops, key=lambda each: each[0])[1]


def allowance(
    geometry: Geometry,
    cable: int,
    position: ArrayLike,
    velocity: ArrayLike,
    table: LeastStops | None = None,
) -> Limits:
    """Twice the `optimum`."""
    least = optimum(geometry, cable, position, velocity, table)
    return Limits(FACTOR * least.speed, FACTOR * least.tension)


def _distance(place: NDArray[np.float64], tear: Tear) -> float:
    return float(np.linalg.norm(place - tear.position))


def _motion(tear: Tear, share: float) -> Stop | None:
    """``share`` of the speed limit, positive towards the anchor."""
    if share > 0.5:
        return tear.towards
    return tear.away if share < -0.5 else tear.rest


@cache
def _table() -> LeastStops:
    return load_least_stops()


@cache
def _shipped() -> Geometry:
    return load("config/direct.yaml")[0].robot.geometry
