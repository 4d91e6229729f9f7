"""The paper's test programme: what is played on which robots, and how often."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from tonus.config.schema.base import Count, Direction, NonNegative, Positive, Section
from tonus.config.schema.controller import ControllerName

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
"""Part of a test's name, and so of a file's."""
Overrides = dict[str, Any]
"""Keys of a section of the configuration and values in place of its own; checked there"""


class Body(Section):
    """The phantom's material; where it stands is the test's."""

    model: Literal["kelvin_voigt", "standard_linear_solid"]
    stiffness: Positive
    damping: NonNegative
    relaxing_stiffness: NonNegative
    relaxation_time: Positive


class Slope(Section):
    """Stage 1: up and down against the phantom at constant tension."""

    distance: Positive
    speed: Positive
    cycles: Count
    """in the one run of the model; a run in the lab is one cycle, and there are several"""
    pressed: NonNegative
    """m: how deep the platform is in the phantom where it starts"""
    wait: Positive
    """s in ACTIVE before the first cycle"""
    grip_stiffness: Positive
    grip_damping: NonNegative


class SineSet(Section):
    """Every amplitude at every frequency."""

    amplitudes: Annotated[tuple[Positive, ...], Field(min_length=1)]
    frequencies: Annotated[tuple[Positive, ...], Field(min_length=1)]


class Sines(Section):
    sets: Annotated[tuple[SineSet, ...], Field(min_length=1)]
    fade: NonNegative
    periods: Count
    """whole ones after the fade, at least"""
    least: Positive
    """s after the fade, at least"""


class Steps(Section):
    """Stage 2: minimum-jerk steps there and back."""

    distance: Positive
    duration: Positive
    pause: Positive


class Ramp(Section):
    force: Positive
    rate: Positive
    """N/s"""
    hold: Positive
    """s at full force"""


class Jump(Section):
    """A load that is there at once."""

    force: Positive
    hold: Positive
    rise: Positive
    """s it takes to be there"""


class Contact(Section):
    """A move whose way is blocked."""

    gap: Positive
    """m from home to the body's surface"""
    clear: Positive
    """m from the way home to the surface, at least, for a bring-up that is shared with trials
    without a body"""
    back: Positive
    """m from home, away from the body, to where it starts"""
    approach: Positive
    """s to get there"""
    settle: NonNegative
    """s to stand there"""
    distance: Positive
    """m beyond the body's surface to where it is sent"""
    duration: Positive
    pause: Positive


class PressTest(Section):
    distance: NonNegative
    approach: Positive
    fade: Positive
    force: Positive
    swing: NonNegative
    frequency: Positive
    periods: Count


class DrawnTest(Section):
    """The one short test of every drawn plant: a load that comes and goes while a sine fades in."""

    direction: Direction
    amplitude: Positive
    frequency: Positive
    periods: Count
    fade: Positive
    load: Jump

    @model_validator(mode="after")
    def _apart(self) -> DrawnTest:
        if self.load.hold >= self.fade:
            raise ValueError("the load's hold must end before the sine's fade does")
        return self


class Robots(Section):
    """How the plant of a kind differs from the configuration's lab section."""

    plant: Overrides = Field(default_factory=dict)
    force_cell: Overrides = Field(default_factory=dict)
    tracker: Overrides = Field(default_factory=dict)


class Selection(Section):
    """What of the programme is run."""

    repetitions: Count
    controllers: Annotated[tuple[ControllerName, ...], Field(min_length=1)]
    cases: tuple[str, ...] | None = None
    """None: all"""
    slope_cycles: Count
    drawn: Annotated[int, Field(ge=0)]
    sample: tuple[str, ...]
    """cases that are repeated on CAN frames, once in the lab"""
    sample_controllers: tuple[ControllerName, ...]


class Protocol(Section):
    name: str
    directions: Annotated[dict[Name, Direction], Field(min_length=1)]
    lead: Positive
    """s in ACTIVE before a load comes"""
    body: Body
    slope: Slope
    sines: Sines
    still: Positive
    """s of holding still"""
    steps: Steps
    ramp: Ramp
    jump: Jump
    contact: Contact
    press: PressTest
    literal: Positive
    """s of the loop of eq. (9) as printed"""
    drawn_test: DrawnTest
    model: Robots
    """nominal plant, no noise"""
    frictionless: Overrides
    """of the plant, in the model of stage 1"""
    lab: Robots
    drawn: Robots
    full: Selection
    quick: Selection
    contact_only: tuple[ControllerName, ...]
    """controllers that without contact are another one: they take no part in what has none"""
    canopen: str
    """the configuration whose fieldbus repeats the sample"""
