"""References that users bring: waypoints, closed curves, a table in a file, a class of their own.

All begin at home, at rest. Offsets are from home in the base frame; a rotation is a rotation vector
(rad, base frame) from level.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from tonus.config.schema.base import (
    Count,
    Direction,
    Finite,
    NonNegative,
    Positive,
    Section,
    Vector3,
)

Tilt = Annotated[Positive, Field(le=3.0)]
"""rad"""


class Samples(Section):
    """A trajectory prepared for the tick, as the log keeps it: quintic polynomials between rows of
    time, offset, velocity, acceleration, rotation vector, its rate and its acceleration."""

    rows: Count
    data: str
    """base64 of zlib of float64, little-endian, 19 in a row"""


class Turn(Section):
    """A sinusoidal tilt about an axis."""

    axis: Direction
    amplitude: Tilt
    """rad"""
    frequency: Positive
    """Hz"""
    phase_deg: Finite = 0.0


class Circle(Section):
    """Round home in any plane; the radius grows from zero over ``fade``."""

    kind: Literal["circle"]
    normal: Direction
    """of the plane; seen against it the motion is counter-clockwise"""
    radius: Positive
    """m"""
    frequency: Positive
    """Hz, turns per second"""
    fade: Positive
    """s"""
    turns: tuple[Turn, ...] = ()
    """tilts on the way; they fade in as well"""


class Oscillation(Section):
    """One component of a Lissajous figure."""

    direction: Direction
    amplitude: Positive
    """m"""
    frequency: Positive
    """Hz"""
    phase_deg: Finite = 0.0


class Lissajous(Section):
    """Sines with phases in any directions; all fade in together over ``fade``."""

    kind: Literal["lissajous"]
    components: Annotated[tuple[Oscillation, ...], Field(min_length=1)]
    fade: Positive
    """s"""
    turns: tuple[Turn, ...] = ()
    """tilts on the way; they fade in as well"""


class Corner(Section):
    """A waypoint, which is passed at the distance of the blend, or stopped at."""

    position: Vector3
    """m, relative to home"""
    rotation: Vector3 = (0.0, 0.0, 0.0)
    """rad"""
    stop: bool = False
    """come to rest there, without a blend"""


class Waypoints(Section):
    """Straight lines with blended corners, as fast as the limits allow. The rotation vector keeps
    to the same path parameter; where both move, their limits are shared."""

    kind: Literal["waypoints"]
    waypoints: Annotated[tuple[Corner, ...], Field(min_length=1)]
    speed: Positive
    """m/s"""
    acceleration: Positive
    """m/s2"""
    angular_speed: Positive = 0.5
    """rad/s, of the rotation vector"""
    angular_acceleration: Positive = 2.0
    """rad/s2"""
    blend: NonNegative = 0.01
    """m, largest distance of the path from a corner; 0: stop at each"""
    smoothing: Positive = 0.1
    """s over which an acceleration changes (S-curve): the motion takes so much longer"""
    prepared: Samples | None = None
    """computed when the scenario is loaded, and kept in the log"""


class Table(Section):
    """A CSV or Parquet file of time and pose: columns t, x, y, z (s, m) and, with orientation,
    rx, ry, rz (rad, a rotation vector) or qw, qx, qy, qz. Between the rows a cubic spline, at rest
    at both ends."""

    kind: Literal["table"]
    file: str
    """relative to the scenario's file"""
    relative_to: Literal["home", "start"] = "home"
    """what the positions are offsets from: home, or the first row's position"""
    approach: NonNegative = 0.0
    """s of minimum-jerk motion from home to the first row; needed where that is not home"""
    prepared: Samples | None = None
    """read when the scenario is loaded, and kept in the log"""


class Object(Section):
    """A class of your own. Its object is called with the time (s) and gives the offset (3,) m, or
    offset and rotation vector (6,). It is sampled when the scenario is loaded."""

    kind: Literal["object"]
    name: str
    """of an entry point in tonus.trajectories, or package.module:Class"""
    settings: dict[str, Finite | str] = Field(default_factory=dict)
    """keyword arguments of the class"""
    length: Positive
    """s"""
    step: Annotated[Positive, Field(ge=0.001)] = 0.01
    """s between samples; between them a cubic spline at rest at both ends"""
    approach: NonNegative = 0.0
    """s of minimum-jerk motion from home to the first pose; needed where that is not home"""
    prepared: Samples | None = None
    """sampled when the scenario is loaded, and kept in the log"""

    @model_validator(mode="after")
    def _several_steps(self) -> Object:
        if self.length < 2.0 * self.step:
            raise ValueError("length has to be two steps or more")
        return self


Prepared = Waypoints | Table | Object
"""references that are computed or read before they can be played"""
