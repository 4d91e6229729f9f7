"""What the robot is: geometry, masses, cables, drums, gearboxes, motors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from tonus.config.cables import LEAST_CABLES, MOST_CABLES, cells_of
from tonus.config.errors import no_such
from tonus.config.schema.axis import (
    AxisOverrides,
    Brake,
    Cable,
    DriveTrain,
    Drum,
    Gearbox,
    Motor,
)
from tonus.config.schema.base import (
    Count,
    Finite,
    Fraction,
    NonNegative,
    Positive,
    Section,
    Vector3,
)

Array = NDArray[np.float64]
Anchors = Annotated[tuple[Vector3, ...], Field(min_length=LEAST_CABLES, max_length=MOST_CABLES)]
Interval = tuple[Finite, Finite]


class Platform(Section):
    mass: Positive
    """kg"""
    inertia: tuple[Positive, Positive, Positive]
    """kg m2, principal, about the platform's centre of mass and axes"""


class Geometry(Section):
    """Anchors in cable order, one pair for each cable: their number is the robot's of cables."""

    frame: Anchors
    """m, in the base frame"""
    platform: Anchors
    """m, in the platform frame"""
    moment_length: Positive
    """m, scales moments against forces where the two meet in one norm"""

    @model_validator(mode="after")
    def _in_pairs(self) -> Geometry:
        frame, platform = len(self.frame), len(self.platform)
        if frame != platform:
            raise ValueError(
                f"frame has {frame} anchors, platform {platform}; give both one for each cable"
            )
        return self


def _axis_number(value: Any) -> Any:
    """Documents have texts as keys; a second spelling of a number would hide the first."""
    number = str(value)
    if not (number.isdecimal() and number == str(int(number))):
        raise ValueError(f"there is no axis {value}; axes are numbered from 0")
    return int(number)


AxisNumber = Annotated[int, BeforeValidator(_axis_number)]


class Workspace(Section):
    x: Interval
    y: Interval
    z: Interval
    tilt_deg: NonNegative

    @model_validator(mode="after")
    def _ordered(self) -> Workspace:
        for axis in ("x", "y", "z"):
            low, high = getattr(self, axis)
            if not low < high:
                raise ValueError(f"{axis} must run from low to high, not {low} to {high}")
        return self


class Response(Section):
    """First-order bandwidths between a command and a measurement, which the margins depend on."""

    current_loop_hz: Positive = 500.0
    """of the drives"""
    force_cell_hz: Positive = 500.0
    """of cells and amplifiers"""


class Robot(Section):
    name: str
    platform: Platform
    geometry: Geometry
    cable: Cable
    drum: Drum
    gearbox: Gearbox
    motor: Motor
    brake: Brake | None = None
    """of every axis; null: only of those that state one"""
    axes: dict[AxisNumber, AxisOverrides] = Field(default_factory=dict)
    """by axis, from 0: what it has that differs from the sections above"""
    response: Response = Response()
    workspace: Workspace
    home: Vector3
    """m: where HOLD keeps the platform"""
    rest: Vector3
    """m: where the platform lies on its cradle while the drives are off"""
    gravity: Positive

    @model_validator(mode="after")
    def _axes_are_there(self) -> Robot:
        for axis in self.axes:
            if axis >= self.cables:
                raise no_such(("axes", str(axis)), "axis", axis, self.cables)
        return self

    @model_serializer(mode="wrap")
    def _as_stated(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A robot whose axes are alike is written as one that has no ``axes``, one without brakes
        as one that has no ``brake``."""
        written: dict[str, Any] = write(self)
        for name in ("axes", "brake"):
            if not getattr(self, name):
                written.pop(name, None)
        return written

    @property
    def cables(self) -> int:
        """n: each has an axis (drive, motor, drum) and a load cell."""
        return len(self.geometry.frame)

    @property
    def cells(self) -> int:
        """Load cells, that of the contact port last."""
        return cells_of(self.cables)

    @property
    def contact_cell(self) -> int:
        """The contact port's."""
        return self.cells - 1

    @property
    def drive_trains(self) -> tuple[DriveTrain, ...]:
        """One for each cable, in their order."""
        train = DriveTrain(
            cable=self.cable,
            drum=self.drum,
            gearbox=self.gearbox,
            motor=self.motor,
            brake=self.brake,
        )
        return tuple(
            self.axes[axis].of(train) if axis in self.axes else train for axis in range(self.cables)
        )

    @property
    def signs(self) -> tuple[int, ...]:
        """Of each axis: 1 where its motor turns up, as its encoder counts, to reel the cable in; -1
        where it turns down."""
        return tuple(
            self.axes[axis].sign if axis in self.axes else 1 for axis in range(self.cables)
        )

    @property
    def kinds_of_axes(self) -> dict[DriveTrain, tuple[int, ...]]:
        """The drive trains that differ, each with its axes."""
        found: dict[DriveTrain, tuple[int, ...]] = {}
        for axis, train in enumerate(self.drive_trains):
            found[train] = (*found.get(train, ()), axis)
        return found

    def groups_of_axes(self, section: str, field: str) -> list[tuple[tuple[int, ...], bool]]:
        """Axes with the same value of one field of a drive train, and whether it is stated as their
        own or is the robot's default."""
        found: dict[tuple[bool, float], tuple[int, ...]] = {}
        for axis, train in enumerate(self.drive_trains):
            overrides = self.axes.get(axis)
            own = bool(overrides and getattr(getattr(overrides, section), field) is not None)
            key = own, float(getattr(getattr(train, section), field))
            found[key] = (*found.get(key, ()), axis)
        return [(axes, own) for (own, _), axes in found.items()]

    def whose(self, axes: Sequence[int]) -> str:
        """What a message adds to a value that only these axes have: nothing where all axes are
        of one kind."""
        if len(axes) == self.cables:
            return ""
        return f" on {'axis' if len(axes) == 1 else 'axes'} {', '.join(map(str, axes))}"

    # What follows has one value per axis, (n,), in an array that is the caller's own.

    @property
    def axial_stiffness(self) -> Array:
        """N: EA of each cable."""
        return np.array([train.cable.axial_stiffness for train in self.drive_trains])

    @property
    def cable_damping(self) -> Array:
        """N s/m"""
        return np.array([train.cable.damping for train in self.drive_trains])

    @property
    def drum_radius(self) -> Array:
        """m"""
        return np.array([train.drum.radius for train in self.drive_trains])

    @property
    def drum_inertia(self) -> Array:
        """kg m2 at the drum, motor and gearbox included"""
        return np.array([train.drum.inertia for train in self.drive_trains])

    @property
    def drum_mass(self) -> Array:
        """kg: each drum's inertia as its cable feels it"""
        return np.array([train.drum_mass for train in self.drive_trains])

    @property
    def motor_speed(self) -> Array:
        """rad/s, nominal, of the motor itself"""
        return np.array([train.motor.nominal_speed for train in self.drive_trains])

    @property
    def viscous_friction(self) -> Array:
        """N m s/rad at the drum"""
        return np.array([train.drum.viscous_friction for train in self.drive_trains])

    @property
    def gear_ratio(self) -> Array:
        """turns of the motor per turn of the drum"""
        return np.array([train.gearbox.ratio for train in self.drive_trains])

    @property
    def gearbox_efficiency(self) -> Array:
        """0 to 1"""
        return np.array([train.gearbox.efficiency for train in self.drive_trains])

    @property
    def current_limit(self) -> Array:
        """A"""
        return np.array([train.motor.current_limit for train in self.drive_trains])

    @property
    def torque_per_amp(self) -> Array:
        """N m at the drum per ampere of motor, without losses"""
        return np.array([train.torque_per_amp for train in self.drive_trains])

    @property
    def torque_limit(self) -> Array:
        """N m at the drum, of the motors' current limits, without losses"""
        return np.array([train.torque_limit for train in self.drive_trains])

    @property
    def tension_per_amp(self) -> Array:
        """N of cable per ampere of motor, gearbox losses included, while winding (eq. 6)"""
        return np.array([train.tension_per_amp for train in self.drive_trains])


class Tension(Section):
    """The bounds of eq. (4) and the levels the sequence uses, all N."""

    pre: Positive
    min: Positive
    max: Positive
    slack: Positive
    """below this a cable counts as slack"""
    referencing: Positive
    """even tension during referencing, just enough to make every cable straight"""

    @model_validator(mode="after")
    def _ordered(self) -> Tension:
        if not self.slack < self.referencing <= self.pre:
            raise ValueError("slack < referencing <= pre must hold")
        if not self.slack < self.min < self.pre < self.max:
            raise ValueError("slack < min < pre < max must hold")
        return self


class Rates(Section):
    """Fractions of the base rate, as integer divisors of it."""

    period_us: Count
    status_divisor: Count
    """of the live line on a terminal"""

    @property
    def period_ns(self) -> int:
        return self.period_us * 1000

    @property
    def period(self) -> float:
        return self.period_us * 1e-6


__all__ = [
    "LEAST_CABLES",
    "MOST_CABLES",
    "Cable",
    "Drum",
    "Fraction",
    "Gearbox",
    "Geometry",
    "Motor",
    "Platform",
    "Rates",
    "Response",
    "Robot",
    "Tension",
    "Workspace",
    "cells_of",
]
