"""References prepared for the tick when a scenario is loaded: files read, classes sampled,
waypoints timed. What comes out is data, so that a log replays without the file or the class."""

from __future__ import annotations

from pathlib import Path

from tonus.config.schema.trajectory import Object, Prepared, Samples, Table
from tonus.config.trajectories.own import sampled
from tonus.config.trajectories.table import tabled
from tonus.config.trajectories.waypoints import timed

__all__ = ["prepare"]


def prepare(reference: Prepared, base: Path) -> Samples:
    """``base``: the folder that a relative file name starts from. Raises `TrajectoryError`."""
    if isinstance(reference, Table):
        return tabled(reference, base)
    if isinstance(reference, Object):
        return sampled(reference)
    return timed(reference)
