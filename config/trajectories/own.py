"""A trajectory of somebody else's class, sampled."""

from __future__ import annotations

from typing import Any

import numpy as np

from tonus.config.schema.outside import OutsideError, imported, names_object, registered
from tonus.config.schema.trajectory import Object, Samples
from tonus.config.trajectories.samples import TrajectoryError, splined

ENTRY_POINTS = "tonus.trajectories"
"""the group in which an installed distribution registers its trajectories"""
_MOST_ROWS = 60_000
_SHAPES = ((3,), (6,))


def sampled(reference: Object) -> Samples:
    """Make the object and call it at each step. Raises `TrajectoryError`."""
    steps = max(round(reference.length / reference.step), 2)
    if steps >= _MOST_ROWS:
        problem = f"{steps} samples are more than {_MOST_ROWS}"
        raise TrajectoryError("step", problem, "choose a larger step")
    times = np.linspace(0.0, reference.length, steps + 1)
    pose = np.zeros((len(times), 6))
    try:
        made = _class(reference.name)(**reference.settings)
        for row, time in enumerate(times):
            found = np.asarray(made(float(time)), dtype=np.float64)
            if found.shape not in _SHAPES or not np.isfinite(found).all():
                problem = f"{reference.name} gives at {time:.3f} s no 3 or 6 finite numbers"
                raise TrajectoryError("name", problem, "correct the class")
            pose[row, : len(found)] = found
    except TrajectoryError:
        raise
    except Exception as error:  # whatever a class of somebody else's raises
        problem = f"{reference.name} cannot be sampled: {type(error).__name__}: {error}"
        raise TrajectoryError("name", problem, "correct the class or its settings") from error
    return splined(times, pose, reference.approach)


def _class(name: str) -> Any:
    try:
        return imported(ENTRY_POINTS, name)
    except OutsideError as error:
        remedy = "put its folder on PYTHONPATH, or install its distribution"
        if not names_object(name):
            known = ", ".join(registered(ENTRY_POINTS)) or "none is there"
            remedy = f"write package.module:Class, or one of: {known}"
        raise TrajectoryError("name", f"{name}: {error}", remedy) from error
