"""What a picture needs to know of a robot: the few sections that its first one waits for.

The whole configuration takes half a second to load and to check; a picture does not wait for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from tonus.config.schema.base import Vector3
from tonus.config.schema.robot import Rates, Robot, Tension


class Plane(NamedTuple):
    """Of a lab's phantom; ``normal`` is out of it, of any length."""

    point: Vector3
    normal: Vector3


@dataclass(frozen=True)
class Shape:
    """As it is drawn."""

    robot: Robot
    tension: Tension
    rates: Rates
    in_lab: bool
    phantom: Plane | None

    @classmethod
    def of(cls, config: Any, scenario: Any) -> Shape:
        """From both as their run wrote them, read as YAML; without a scenario that can be read the
        picture lacks the phantom. Raises `LookupError`, `TypeError` or `ValueError`."""
        control = config["control"]
        return cls(
            Robot.model_validate(config["robot"]),
            Tension.model_validate(control["tension"]),
            Rates.model_validate(control["rates"]),
            config.get("lab") is not None,
            _phantom(scenario),
        )


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


def _vector(given: Any) -> Vector3:
    x, y, z = map(float, given)
    return x, y, z
