"""One axis from cable to motor, and what an axis may have that the others do not."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
)

from tonus.config.schema.base import Count, NonNegative, Positive, Section, no_boolean

Sign = Annotated[Literal[1, -1], BeforeValidator(no_boolean)]
Efficiency = Annotated[float, Field(gt=0, le=1)]


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
    efficiency: Efficiency

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
    maximum_speed_rpm: Positive | None = None
    """above which its drive lets no torque drive it on (0x6080); null: the drive's own limit"""
    quick_stop_rpm_s: Positive | None = None
    """rpm/s with which its drive brakes by itself, at a quick stop, a fault or a lost connection
    (0x6085); null: the drive's own, for an EPOS4 10000"""
    thermal_time_constant: Positive | None = None
    """s, of the winding, by which its drive bounds the current (0x3001:4); null: the drive's own"""

    @property
    def increments_per_revolution(self) -> int:
        return 4 * self.encoder_pulses

    @property
    def nominal_speed(self) -> float:
        """rad/s"""
        return self.nominal_speed_rpm * 2.0 * math.pi / 60.0

    @property
    def rated_torque(self) -> float:
        """N m: what 1000 per mille of 0x6071 stand for, to the micronewton metre of 0x6076."""
        micro = round(self.nominal_current * 1e3) * round(self.torque_constant * 1e6) / 1000
        return round(micro) * 1e-6


class Brake(Section):
    """A holding brake on the motor's shaft: closed without power, opened by its drive."""

    torque: Positive
    """N m at the motor, which it holds at least"""
    opening_ms: Annotated[NonNegative, Field(le=200)]
    """from power on its coil until it is open; the supervisor does not compare torques meanwhile"""
    closing_ms: Annotated[NonNegative, Field(le=200)]
    """from power off until it holds"""


class DriveTrain(Section):
    """What one motor moves one cable with."""

    cable: Cable
    drum: Drum
    gearbox: Gearbox
    motor: Motor
    brake: Brake | None = None

    @property
    def brake_torque(self) -> float | None:
        """N m at the drum that the brake holds, without losses; None without a brake."""
        return None if self.brake is None else self.brake.torque * self.gearbox.ratio

    @property
    def drum_mass(self) -> float:
        """kg: the drum's inertia as the cable feels it."""
        return self.drum.inertia / self.drum.radius**2

    @property
    def torque_per_amp(self) -> float:
        """N m at the drum per ampere of motor, without losses."""
        return self.motor.torque_constant * self.gearbox.ratio

    @property
    def torque_limit(self) -> float:
        """N m at the drum, of the motor's current limit, without losses."""
        return self.motor.current_limit * self.motor.torque_constant * self.gearbox.ratio

    @property
    def tension_per_amp(self) -> float:
        """N of cable per ampere of motor, gearbox losses included, while winding (eq. 6)."""
        shaft = self.motor.torque_constant * self.gearbox.ratio * self.gearbox.efficiency
        return shaft / self.drum.radius


Part = TypeVar("Part", bound=Section)


class _Overrides(Section):
    """What is stated here takes the place of a default; what is not stays out of the record."""

    @field_validator("*", mode="before")
    @classmethod
    def _stated(cls, value: Any) -> Any:
        if value is None:
            raise ValueError("has no value; give one, or remove the key to keep the default")
        return value

    @model_serializer(mode="wrap")
    def _as_stated(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: value for name, value in write(self).items() if value is not None}

    def over(self, default: Part) -> Part:
        """The ``default`` with what is stated here in place of its own."""
        stated = {name: value for name, value in self if value is not None}
        return default.model_copy(update=stated)


class CableOverrides(_Overrides):
    axial_stiffness: Positive | None = None
    damping: NonNegative | None = None


class DrumOverrides(_Overrides):
    radius: Positive | None = None
    inertia: Positive | None = None
    viscous_friction: NonNegative | None = None


class GearboxOverrides(_Overrides):
    numerator: Count | None = None
    denominator: Count | None = None
    efficiency: Efficiency | None = None


class MotorOverrides(_Overrides):
    torque_constant: Positive | None = None
    nominal_current: Positive | None = None
    current_limit: Positive | None = None
    encoder_pulses: Count | None = None
    nominal_speed_rpm: Positive | None = None
    maximum_speed_rpm: Positive | None = None
    quick_stop_rpm_s: Positive | None = None
    thermal_time_constant: Positive | None = None


class AxisOverrides(_Overrides):
    """Any part of any section of a `DriveTrain`, and how the motor is mounted."""

    sign: Sign = 1
    """which way the motor turns, as its encoder counts, to reel the cable in: 1 up, -1 down"""
    cable: CableOverrides = CableOverrides()
    drum: DrumOverrides = DrumOverrides()
    gearbox: GearboxOverrides = GearboxOverrides()
    motor: MotorOverrides = MotorOverrides()
    brake: Brake | None = None
    """one of its own, whole"""

    @model_serializer(mode="wrap")
    def _as_stated(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: value for name, value in write(self).items() if value}

    def of(self, default: DriveTrain) -> DriveTrain:
        """The ``default`` with what is stated here in place of its own."""
        return DriveTrain(
            cable=self.cable.over(default.cable),
            drum=self.drum.over(default.drum),
            gearbox=self.gearbox.over(default.gearbox),
            motor=self.motor.over(default.motor),
            brake=self.brake or default.brake,
        )
