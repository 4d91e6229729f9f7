"""What a picture needs to know of a robot: the few values that its first one waits for.

The whole configuration takes half a second to load and to check; a picture does not wait for it.
What is taken here is checked as far as drawing needs it, and all of it as soon as there is one.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tonus.config.cables import LEAST_CABLES, MOST_CABLES
from tonus.tools.view.colours import Levels
from tonus.tools.view.moment import Array

Vector = tuple[float, float, float]


class Plane(NamedTuple):
    """Of a lab's phantom; ``normal`` is out of it, of any length."""

    point: Vector
    normal: Vector


@dataclass(frozen=True, eq=False)
class Shape:
    """As it is drawn; arrays with a row for each of n cables, m."""

    frame: Array
    """(n, 3) where each cable leaves the frame"""
    platform: Array
    """(n, 3) where it ends, in the platform's frame"""
    drum_radius: Array
    """(n,)"""
    workspace: Array
    """(3, 2) from low to high along x, y and z"""
    home: Array
    """(3,)"""
    rest: Array
    """(3,) in the cradle"""
    levels: Levels
    """N, of the tensions"""
    period: float
    """s"""
    in_lab: bool
    phantom: Plane | None

    @property
    def cables(self) -> int:
        """n."""
        return len(self.frame)

    @classmethod
    def of(cls, config: Any, scenario: Any) -> Shape:
        """From both as their run wrote them, read as YAML; without a scenario that can be read the
        picture lacks the phantom. Raises `LookupError`, `TypeError` or `ValueError`."""
        robot, control = config["robot"], config["control"]
        anchors, box, tension = robot["geometry"], robot["workspace"], control["tension"]
        n = len(anchors["frame"])
        if not LEAST_CABLES <= n <= MOST_CABLES:
            raise ValueError(f"a robot of {n} cables")
        radii = np.full(n, float(robot["drum"]["radius"]))
        axes = robot.get("axes", {})
        for axis in axes:
            with suppress(LookupError):  # it has what all have
                radii[int(axis)] = axes[axis]["drum"]["radius"]
        slack, *stops = _array([tension[name] for name in ("slack", "min", "pre", "max")], 4)
        period = 1e-6 * int(control["rates"]["period_us"])
        if not period > 0.0:
            raise ValueError("a period that is none")
        return cls(
            frame=_array(anchors["frame"], n, 3),
            platform=_array(anchors["platform"], n, 3),
            drum_radius=_array(radii, n),
            workspace=_array([box[axis] for axis in "xyz"], 3, 2),
            home=_array(robot["home"], 3),
            rest=_array(robot["rest"], 3),
            levels=(float(slack), *map(float, stops)),  # type: ignore[arg-type]
            period=period,
            in_lab=config.get("lab") is not None,
            phantom=_phantom(scenario),
        )


def _array(given: Any, *shape: int) -> Array:
    """Finite numbers, so many. Raises `TypeError` or `ValueError`."""
    array = np.array(given, np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"not {shape} finite numbers")
    return array


def _phantom(scenario: Any) -> Plane | None:
    try:
        phantom = scenario["lab"]["phantom"]
        return (
            None
            if phantom is None
            else Plane(_vector(phantom["point"]), _vector(phantom["normal"]))
        )
    except (LookupError, TypeError, ValueError):
        return None


def _vector(given: Any) -> Vector:
    x, y, z = map(float, given)
    return x, y, z
