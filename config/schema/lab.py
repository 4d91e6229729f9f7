"""The lab in software: what the plant has that the controller does not know."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from config.schema.base import (
    Count,
    Direction,
    Finite,
    Fraction,
    NonNegative,
    Positive,
    Section,
    Vector3,
)
from config.schema.faults import Fault


class Plant(Section):
    substep_us: Count
    coulomb_friction: NonNegative
    """N at the cable, per drum"""
    load_friction: NonNegative
    """share of the tension that adds to the Coulomb friction"""
    gearbox_losses: bool
    """gearbox efficiency acts against the direction of motion"""
    current_loop_hz: Positive
    stiffness_scale: Positive = 1.0
    """true EA over the nominal one"""
    mass_scale: Positive = 1.0
    anchor_sigma: NonNegative = 0.0
    """m, drawn once per seed for each frame anchor coordinate"""
    holding_brake: bool = False
    """every motor has a brake that its drive opens (0x3158) and that is closed without power"""
    slack_at_start: tuple[NonNegative, NonNegative]
    """m: range from which every cable's slack in the cradle is drawn; loose enough to lie still,
    short enough to be wound in during referencing"""

    @model_validator(mode="after")
    def _ordered(self) -> Plant:
        low, high = self.slack_at_start
        if low > high:
            raise ValueError(f"slack_at_start must run from low to high, not {low} to {high}")
        return self


class CellNoise(Section):
    sigma: NonNegative
    """N"""
    offset_sigma: NonNegative
    """N, drawn once per seed and cell"""
    bandwidth_hz: Positive
    range: Positive
    """N"""


class TrackerNoise(Section):
    position_sigma: NonNegative
    position_grid: NonNegative
    """m, resolution"""
    rotation_sigma: NonNegative
    jitter_ms: NonNegative
    """latency varies evenly by up to this much either way"""


class Noise(Section):
    force_cell: CellNoise
    tracker: TrackerNoise


class Phantom(Section):
    """A flat viscoelastic body: pushes back along ``normal`` where the port is behind ``point``."""

    point: Vector3
    normal: Direction
    model: Literal["kelvin_voigt", "standard_linear_solid"]
    stiffness: Positive
    """N/m, quasi-static"""
    damping: NonNegative
    """N s/m, kelvin_voigt"""
    relaxing_stiffness: NonNegative
    """N/m, the standard linear solid's second spring"""
    relaxation_time: Positive
    """s"""


class Cradle(Section):
    """Where the platform lies while the drives are off: a unilateral support from below."""

    stiffness: Positive
    damping: NonNegative
    rotational_stiffness: Positive
    rotational_damping: NonNegative


class Timing(Section):
    """How the lab keeps a bus in real time."""

    coalesce_us: Count
    """frames that end within this time reach a client in one batch; their timestamps stay exact"""
    drive_response_us: NonNegative
    """from the end of a SYNC to a device's answer entering its transmit queue"""
    queue_depth: Count
    """frames a node's transmit queue holds"""
    bus_off_recovers: bool = True
    """a controller in bus-off returns by itself after 128 times 11 recessive bits"""


class PowerStage(Section):
    """What the emulated drives' hardware does. Its limits are the drives' own objects; here is
    where it lives and how far a value must come back before its error can be reset."""

    supply: Positive = 48.0
    """V"""
    temperature: Finite = 30.0
    """degrees C"""
    undervoltage_recovery: NonNegative = 0.5
    """V above 0x2201:1"""
    overvoltage_recovery: NonNegative = 2.0
    """V below 0x2201:2"""
    thermal_recovery: NonNegative = 10.0
    """K below 0x3201:4"""
    continuous_current: Positive = 8.0
    """A"""
    thermal_time_constant: Positive = 15.0
    """s, of the power stage's I2t"""
    release_level: Fraction = 0.95
    """I2t at which a limited current is given back, as a share of the level that limits it"""


class Lab(Section):
    seed: Annotated[int, Field(ge=0)]
    plant: Plant
    noise: Noise
    cradle: Cradle
    bus: Timing
    drive: PowerStage = PowerStage()
    phantom: Phantom | None = None


class LoadPoint(Section):
    """Force of the active load port at a time after the lab saw every drive enabled."""

    at: NonNegative
    force: Finite


class Load(Section):
    direction: Direction
    point: Vector3
    """m, in the platform frame"""
    profile: Annotated[tuple[LoadPoint, ...], Field(min_length=2)]
    """linear in between, constant outside"""

    @model_validator(mode="after")
    def _forward(self) -> Load:
        times = [point.at for point in self.profile]
        if times != sorted(times):
            raise ValueError("the profile must run forward in time")
        return self


class LabScript(Section):
    """What a scenario asks of the lab. It cannot be heard by the daemon."""

    load: Load | None = None
    phantom: Phantom | None = None
    faults: tuple[Fault, ...] = ()
