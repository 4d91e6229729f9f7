"""A trajectory of somebody else's class, sampled."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

import numpy as np

from tonus.config.schema.controller import names_class
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
    place = name
    if not names_class(name):
        found = sorted({each.value for each in entry_points(group=ENTRY_POINTS, name=name)})
        if len(found) != 1:
            known = sorted({each.name for each in entry_points(group=ENTRY_POINTS)})
            problem = f"{name} is registered {len(found)} times in {ENTRY_POINTS}"
            remedy = f"write package.module:Class, or one of: {', '.join(known) or 'none is there'}"
            raise TrajectoryError("name", problem, remedy)
        place = found[0]
    module, _, path = place.partition(":")
    try:
        there: Any = import_module(module)
        for part in path.split("."):
            there = getattr(there, part)
    except Exception as error:  # whatever a module of somebody else's raises
        problem = f"{name} cannot be imported: {type(error).__name__}: {error}"
        remedy = "put its folder on PYTHONPATH, or install its distribution"
        raise TrajectoryError("name", problem, remedy) from error
    return there
