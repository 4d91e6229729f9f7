"""Values that are right in another unit: said before anything is computed from them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from tonus.config import Config
from tonus.config.loader import load_plausible
from tonus.config.schema.axis import AxisOverrides
from tonus.config.schema.plausible import Bound
from tonus.config.schema.robot import Robot
from tonus.tools.check.finding import Finding

_BEYOND = 2.0
"""times the distance of its farthest anchor: where a platform's mass may be. R"""


def plausibility(config: Config) -> Iterator[Finding]:
    """One finding for each implausible value, or one that all are plausible."""
    bounds = load_plausible().bounds
    judged = (
        _judge(key, value, bound) for bound in bounds for key, value in _stated(config, bound)
    )
    wrong = [each for each in (*judged, _inertia(config.robot)) if each is not None]
    if not wrong:
        text = f"{len(bounds)} values are in the range expected for their units"
        yield Finding("units", True, "robot", text, "give SI units")
    yield from wrong


def _stated(config: Config, bound: Bound) -> Iterator[tuple[str, Any]]:
    """Every key at which a bound's quantity is given, with its value: an axis may have its own."""
    value: Any = config
    parts = bound.key.split(".")
    for part in parts:
        value = getattr(value, part)
    if value is not None:
        yield bound.key, value
    if parts[0] != "robot" or parts[1] not in AxisOverrides.model_fields:
        return
    _, section, field = parts
    for axis, overrides in config.robot.axes.items():
        own = getattr(getattr(overrides, section), field)
        if own is not None:
            yield f"robot.axes.{axis}.{section}.{field}", own


def _judge(key: str, value: Any, bound: Bound) -> Finding | None:
    found = bound.largest(value)
    if found == 0.0 or bound.low <= found <= bound.high:
        return None
    what = f"{found:g} {bound.unit}, where {bound.low:g} to {bound.high:g} are plausible"
    remedy = f"give it in {bound.unit}"
    if bound.low <= found / bound.factor <= bound.high:
        what += f"; it looks like {bound.mistaken}"
        remedy = f"give it in {bound.unit}: {found / bound.factor:g}"
    return Finding("units", False, key, what, remedy)


def _inertia(robot: Robot) -> Finding | None:
    """No more than all of the mass at the farthest place has."""
    reach = _BEYOND * max(math.hypot(*anchor) for anchor in robot.geometry.platform)
    most, found = robot.platform.mass * reach**2, max(robot.platform.inertia)
    if found <= most:
        return None
    what = f"{found:g} kg m2, and {robot.platform.mass:g} kg within {reach:.2g} m have {most:.2g}"
    return Finding("units", False, "robot.platform.inertia", what, "give it in kg m2")
