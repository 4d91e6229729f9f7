"""What a run does: the reference the daemon follows and the script the lab plays."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from tonus.config.schema.base import Direction, NonNegative, Positive, Section, Vector3
from tonus.config.schema.expectation import Expectation
from tonus.config.schema.fault_section import LONGEST_S
from tonus.config.schema.lab import LabScript
from tonus.config.schema.trajectory import Circle, Lissajous, Object, Table, Waypoints


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


class Press(Section):
    """Goes up to a body and presses on it: min-jerk ``approach``, then the force grows over
    ``fade`` to ``force`` and swings round it. The reference moves on by force over ``stiffness``,
    the only thing a position controller is given of the body."""

    kind: Literal["press"]
    direction: Direction
    distance: NonNegative
    """m from home to the body's surface"""
    approach: Positive
    """s"""
    fade: Positive
    """s"""
    force: Positive
    """N"""
    swing: NonNegative = 0.0
    """N"""
    frequency: Positive = 0.5
    stiffness: Positive
    """N/m, of the body, as estimated"""

    @model_validator(mode="after")
    def _pressing(self) -> Press:
        if not self.swing < self.force:
            raise ValueError("swing < force must hold, or contact is lost")
        return self


Reference = Annotated[
    Hold | Sine | Multisine | Path | Press | Circle | Lissajous | Waypoints | Table | Object,
    Field(discriminator="kind"),
]


class Command(Section):
    """What an operator does."""

    at: Annotated[NonNegative, Field(le=LONGEST_S)]
    """s after arming"""
    command: Literal["start", "hold", "stop", "estop"]


class Scenario(Section):
    name: str
    description: str
    duration: Positive
    """s in ACTIVE"""
    reference: Reference
    lab: LabScript = LabScript()
    operator: tuple[Command, ...] = ()
    """commands of an operator, in the order of time; the run starts and stops by itself only after
    the last of them"""
    expect: tuple[Expectation, ...] = ()
    """what `tonus verify` judges the run by"""

    @model_validator(mode="after")
    def _in_order(self) -> Scenario:
        times = [command.at for command in self.operator]
        if times != sorted(times):
            raise ValueError("operator: the commands must run forward in time")
        return self
