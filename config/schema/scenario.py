"""What a run does: the reference the daemon follows and the script the lab plays."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from config.schema.base import Direction, NonNegative, Positive, Section, Vector3
from config.schema.lab import LabScript


class Hold(Section):
    kind: Literal["hold"]


class Sine(Section):
    """Starts from rest: the amplitude fades in and out over whole periods."""

    kind: Literal["sine"]
    direction: Direction
    amplitude: Positive
    frequency: Positive
    fade: NonNegative
    """s"""


class Component(Section):
    """One sine of several."""

    direction: Direction
    amplitude: Positive
    frequency: Positive


class Multisine(Section):
    """Several sines at once; all fade in together."""

    kind: Literal["multisine"]
    components: Annotated[tuple[Component, ...], Field(min_length=1)]
    fade: NonNegative
    """s"""


class Waypoint(Section):
    position: Vector3
    """m, relative to home"""
    duration: Positive
    """s of minimum-jerk motion to get there"""
    pause: NonNegative = 0.0


class Path(Section):
    kind: Literal["path"]
    waypoints: Annotated[tuple[Waypoint, ...], Field(min_length=1)]


Reference = Annotated[Hold | Sine | Multisine | Path, Field(discriminator="kind")]


class Scenario(Section):
    name: str
    description: str
    duration: Positive
    """s in ACTIVE"""
    reference: Reference
    lab: LabScript = LabScript()
