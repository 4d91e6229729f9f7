"""What the robot is: geometry, masses, cables, drums, gearboxes, motors."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from tonus.config.schema.base import (
    Count,
    Finite,
    Fraction,
    NonNegative,
    Positive,
    Section,
    Vector3,
)

CABLES = 8
EightPoints = Annotated[tuple[Vector3, ...], Field(min_length=CABLES, max_length=CABLES)]
Interval = tuple[Finite, Finite]


class Platform(Section):
    mass: Positive
    """kg"""
    inertia: tuple[Positive, Positive, Positive]
    """kg m2, principal, about the platform's centre of mass and axes"""


class Geometry(Section):
    """Anchors in cable order: 1 to 4 upper, 5 to 8 lower."""

    frame: EightPoints
    """m, in the base frame"""
    platform: EightPoints
    """m, in the platform frame"""
    moment_length: Positive
    """m, scales moments against forces where the two meet in one norm"""


class Cable(Section):
    axial_stiffness: Positive
    """N: EA, so that a cable of unstretched length L0 has stiffness EA/L0"""
    damping: NonNegative
    """N s/m"""


class Drum(Section):
    radius: Positive
    inertia: Positive
    """kg m2 at the drum, motor and gearbox included"""
    viscous_friction: NonNegative
    """N m s/rad at the drum"""


class Gearbox(Section):
    numerator: Count
    denominator: Count
    efficiency: Annotated[float, Field(gt=0, le=1)]

    @property
    def ratio(self) -> float:
        return self.numerator / self.denominator


class Motor(Section):
    torque_constant: Positive
    """N m/A"""
    nominal_current: Positive
    """A: 0x3001:1, the base of the drive's per mille torque scale"""
    current_limit: Positive
    """A: 0x3001:2"""
    encoder_pulses: Count
    """per motor revolution; the drive counts four increments per pulse"""
    nominal_speed_rpm: Positive

    @property
    def increments_per_revolution(self) -> int:
        return 4 * self.encoder_pulses

    @property
    def rated_torque(self) -> float:
        """N m: what 1000 per mille of 0x6071 stand for, to the micronewton metre of 0x6076."""
        micro = round(self.nominal_current * 1e3) * round(self.torque_constant * 1e6) / 1000
        return round(micro) * 1e-6


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
    response: Response = Response()
    workspace: Workspace
    home: Vector3
    """m: where HOLD keeps the platform"""
    rest: Vector3
    """m: where the platform lies on its cradle while the drives are off"""
    gravity: Positive

    @property
    def cable_per_increment(self) -> float:
        """m of cable per encoder increment."""
        turns = 1.0 / (self.motor.increments_per_revolution * self.gearbox.ratio)
        return turns * 2.0 * 3.141592653589793 * self.drum.radius

    @property
    def tension_per_amp(self) -> float:
        """N of cable per ampere of motor, gearbox losses included, while winding (eq. 6)."""
        shaft = self.motor.torque_constant * self.gearbox.ratio * self.gearbox.efficiency
        return shaft / self.drum.radius


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
    "CABLES",
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
]
