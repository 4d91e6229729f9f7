"""The lab in software: what the plant has that the controller does not know."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from tonus.config.schema.base import (
    Count,
    Direction,
    Finite,
    Fraction,
    NonNegative,
    Number,
    Positive,
    Section,
    Share,
    Vector3,
)
from tonus.config.schema.faults import Fault

Spread = Annotated[Number, Field(ge=0, lt=1)]
"""A true value is drawn once per seed, evenly within this share of the nominal one either way."""


class Stribeck(Section):
    """Friction rises towards standstill: times 1 + share exp(-(v/speed)^2)."""

    share: Positive
    speed: Positive
    """m/s of cable"""


class Stiffening(Section):
    """A cable's EA grows linearly with its tension: EA (1 - share + share T/tension)."""

    tension: Positive
    """N, where EA is as configured"""
    share: Share


class Backlash(Section):
    """Play in the gearbox; rotor and drum are then two bodies. All values at the drum."""

    play_deg: Positive
    """from flank to flank"""
    rotor_share: Share
    """of the drum's inertia, viscous and Coulomb friction that belongs to the rotor"""
    stiffness: Positive
    """N m/rad, of the teeth in contact"""
    damping: NonNegative
    """N m s/rad"""


class Plant(Section):
    substep_us: Count
    coulomb_friction: NonNegative
    """N at the cable, per drum"""
    load_friction: NonNegative
    """share of the tension that adds to the Coulomb friction"""
    gearbox_losses: bool
    """gearbox efficiency acts against the direction of motion"""
    stribeck: Stribeck | None = None
    backlash: Backlash | None = None
    winding_resistance: Positive
    """ohm, of a motor as its current sees it"""
    current_loop_hz: Positive
    pulley_radius: NonNegative = 0.0
    """m: at each frame anchor an upright pulley that turns about the vertical; 0: none"""
    stiffening: Stiffening | None = None
    stiffness_scale: Positive = 1.0
    """true EA over the nominal one"""
    stiffness_spread: Spread = 0.0
    """each cable by itself, about stiffness_scale"""
    damping_scale: NonNegative = 1.0
    """true damping of the cables over the nominal one"""
    mass_scale: Positive = 1.0
    """of the platform's mass and inertia"""
    mass_spread: Spread = 0.0
    """about mass_scale"""
    friction_spread: Fraction = 0.0
    """each drum's Coulomb and load-dependent friction by itself"""
    anchor_sigma: NonNegative = 0.0
    """m, drawn once per seed for each frame anchor coordinate"""
    slack_at_start: tuple[NonNegative, NonNegative]
    """m: range from which every cable's slack in the cradle is drawn; loose enough to lie still,
    short enough to be reeled in during referencing"""

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
    latency_ms: tuple[NonNegative, NonNegative] | None = None
    """range from which the true mean latency is drawn once per seed; none: the nominal one"""
    position_bias_sigma: NonNegative = 0.0
    """m, base frame, drawn once per seed for each coordinate"""
    rotation_bias_sigma: NonNegative = 0.0
    """rad, platform frame, likewise: how the markers are mounted"""
    dropout_probability: Fraction = 0.0
    """that the platform is lost from sight at an exposure"""
    dropout_ms: NonNegative = 0.0
    """for how long it then stays lost; 0: that exposure only"""

    @model_validator(mode="after")
    def _ordered(self) -> TrackerNoise:
        if self.latency_ms is not None and self.latency_ms[0] > self.latency_ms[1]:
            low, high = self.latency_ms
            raise ValueError(f"latency_ms must run from low to high, not {low} to {high}")
        return self


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
    """Where the platform lies while the drives are off: a level table with friction, and in it a
    cup for each lower corner of the platform, a box about its cable anchors. What lands farther
    off than a cup's rim lies where it touched."""

    stiffness: Positive
    """N/m, of the table under all four corners"""
    damping: NonNegative
    """N s/m, of the table under all four corners"""
    friction: NonNegative
    """coefficient of Coulomb friction"""
    radius: Positive
    """m, of a cup"""
    depth: NonNegative
    """m, of a cup under the table; its slope must overcome friction to centre the platform"""


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


class Segment(Section):
    """The lab's end of an EtherCAT segment, and what its slaves' clocks and cables are like."""

    interface: str
    """network interface the slaves answer on; with the master's it is the pair of a veth"""
    redundant_interface: str | None = None
    """the same for the cable back from the last slave, where the master has one"""
    hop_ns: Count = 800
    """one slave and the cable to the next, one way"""
    clock_spread_ppm: NonNegative = 10.0
    """each slave's clock runs off by up to this much either way, drawn once per seed"""
    receive_buffer: Count = 2304
    """bytes the interface holds for a lab that is late; a frame older than that is lost"""


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
    robot_seed: Annotated[int, Field(ge=0)] | None = None
    """of the robot and of its tracker's constant errors, what docs/plant.md lists as drawn once;
    none: the run's seed, which then draws robot and noise together"""
    plant: Plant
    noise: Noise
    cradle: Cradle
    bus: Timing
    ethercat: Segment | None = None
    """for a fieldbus of that kind"""
    drive: PowerStage = PowerStage()
    phantom: Phantom | None = None
    load_release: Positive = 200.0
    """N/s at which the load port lets go when a run is stopped before its load's profile is over"""
    start_timeout_s: Positive = 180.0
    """how long its process may take until it answers"""

    def robot_seeded(self, seed: int) -> int:
        """The seed of the robot in a run with ``seed``."""
        return seed if self.robot_seed is None else self.robot_seed


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


class DisplacementPoint(Section):
    """How far the platform is to be at a time after the lab saw every drive enabled."""

    at: NonNegative
    distance: Finite
    """m"""


class Displacement(Section):
    """The load port as a testing machine: it takes hold of the platform's origin where that is at
    the first point, leads it along ``direction`` and leaves every other freedom alone; after the
    last point it lets go."""

    direction: Direction
    stiffness: Positive
    """N/m, of the grip"""
    damping: NonNegative
    """N s/m, of the grip"""
    profile: Annotated[tuple[DisplacementPoint, ...], Field(min_length=2)]
    """linear in between"""

    @model_validator(mode="after")
    def _forward(self) -> Displacement:
        times = [point.at for point in self.profile]
        if times != sorted(times):
            raise ValueError("the profile must run forward in time")
        if self.profile[0].distance != 0.0:
            raise ValueError("the profile must begin with distance 0, where it takes hold")
        return self


class Occlusion(Section):
    """The platform is hidden from the tracker."""

    at: NonNegative
    """s after the lab saw every drive enabled"""
    duration: Positive


class TrackerShift(Section):
    """The tracker's poses are off by this much, as after a knock against it."""

    at: NonNegative
    """s after the lab saw every drive enabled"""
    duration: Positive
    position: Vector3 = (0.0, 0.0, 0.0)
    """m, base frame"""
    rotation: Vector3 = (0.0, 0.0, 0.0)
    """rad, rotation vector in the platform frame"""


class LabScript(Section):
    """What a scenario asks of the lab. The daemon does not see it."""

    load: Load | None = None
    displacement: Displacement | None = None
    phantom: Phantom | None = None
    occlusions: tuple[Occlusion, ...] = ()
    tracker_shifts: tuple[TrackerShift, ...] = ()
    faults: tuple[Fault, ...] = ()

    @model_validator(mode="after")
    def _one_port(self) -> LabScript:
        if self.load is not None and self.displacement is not None:
            raise ValueError("the load port plays either a load or a displacement, not both")
        return self
