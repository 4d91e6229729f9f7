"""What the controller is told: filters, estimator, law, distribution, inner loop, envelope."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from config.schema.base import Count, Fraction, NonNegative, Positive, Section
from config.schema.robot import Rates, Tension


class Filters(Section):
    force_cutoff_hz: Positive
    """second-order Butterworth on every force cell (paper, section 3.4)"""
    plausible_force: Positive
    """N: a cell that reports more is not believed"""
    plausible_speed: Positive
    """times the motor's nominal speed: an encoder that reports more is not believed"""


class Estimator(Section):
    """Kalman filters of motion and of the cables' bias, for translation and for rotation."""

    cable_position_sigma: Positive
    """m, noise of the pose solved from the cables"""
    cable_rotation_sigma: Positive
    """rad"""
    acceleration_sigma: Positive
    """m/s2 per sqrt(Hz): what the wrench balance misses"""
    angular_acceleration_sigma: Positive
    force_drift: Positive
    """N/s per sqrt(Hz): how fast an external force may change"""
    moment_drift: Positive
    """N m/s per sqrt(Hz)"""
    bias_drift: Positive
    """m/s per sqrt(Hz)"""
    rotation_bias_drift: Positive
    gate: Positive
    """largest normalised innovation (sigmas) of a tracker pose that is still believed"""


class StiffnessLaw(Section):
    """Eq. (3) or (10) in the normalised reading: K = K0 (1 + sum of gain * ratio), each ratio
    clipped to 1."""

    profile: Literal["table1_eq3", "eq10"]
    base: Positive
    """N/m: K0"""
    minimum: Positive
    maximum: Positive
    deviation_gain: NonNegative
    velocity_gain: NonNegative
    force_gain: NonNegative
    deviation_reference: Positive
    """m"""
    velocity_reference: Positive
    """m/s"""
    force_reference: Positive
    """N"""
    velocity_source: Literal["error", "platform"]
    rise_rate: Positive
    """N/m/s: how fast the stiffness may grow (Kronander and Billard 2016)"""

    @model_validator(mode="after")
    def _ordered(self) -> StiffnessLaw:
        if not self.minimum < self.base <= self.maximum:
            raise ValueError("minimum < base <= maximum must hold")
        return self


class Impedance(Section):
    damping_ratio: Positive
    rotational_stiffness: Positive
    """N m/rad"""
    rotational_damping: NonNegative
    """N m s/rad"""


class Pid(Section):
    stiffness: Positive
    damping_ratio: Positive
    integral: NonNegative
    """N/(m s)"""
    integral_limit: Positive
    """N"""


class Distribution(Section):
    """One box-bounded quadratic programme: |T - T_ref|^2 + weight * |W T - w|^2."""

    wrench_weight: Positive
    deficit_limit: Positive
    """N: a larger part of the wrench left undelivered is reported"""
    tension_rate: Positive
    """N/s: bound on how fast a tension reference may move"""
    co_contraction: Fraction
    """share of the relative stiffness rise that the tension reference follows"""
    maximum_iterations: Count
    tolerance: Positive


class TensionLoop(Section):
    """Eq. (6) and (9), completed: feed-forward, proportional, integral, drum-rate damping."""

    proportional: NonNegative
    integral: NonNegative
    """1/s"""
    integral_limit: Positive
    """N"""
    rate_damping: NonNegative
    """N m s/rad at the drum"""
    gain_margin_db: Positive
    phase_margin_deg: Positive
    """floors that `tonus check` computes against, without friction and with the real delay"""


class Sequence(Section):
    """How long each step of bringing up may take and how smoothly it goes."""

    tare_s: Positive
    referencing_settle_s: Positive
    referencing_average_s: Positive
    pretension_s: Positive
    lift_s: Positive
    """s of minimum-jerk motion from the cradle to home"""
    stop_s: Positive
    """controlled stop: tensions ramp to the referencing level in this time"""
    lower_s: Positive
    """s of minimum-jerk motion back to the cradle"""
    enable_timeout_s: Positive
    referencing_tension_error: Positive
    """N: largest deviation from the even tension that still counts as settled"""
    referencing_spread: Positive
    """m: largest departure of a tracker pose from the mean of those it is averaged with"""
    referencing_distance: Positive
    """m: largest distance of the referenced pose from the cradle"""
    referencing_poses: Count
    """fewest tracker poses that make a reference"""
    tare_limit: Positive
    """N: a larger reading of an unloaded cell is a defect and not an offset"""
    reference_slew: Positive
    """1/s: how fast the scenario's time may slow down or pick up"""


class Freshness(Section):
    measurement_ticks: Count
    """a measurement older than this carries no torque"""
    stale_stop_ticks: Count
    """ticks without a fresh measurement until the controlled stop"""


class Envelope(Section):
    """The Dynamic Safety Envelope, eq. (4) and (14), graded."""

    enabled: bool
    contact_limit: Positive
    """N: F_lim, at the contact port"""
    contact_warning: Fraction
    """share of F_lim where the stiffness starts to come down"""
    speed_limit: Positive
    speed_warning: Fraction
    workspace_margin: NonNegative
    """m inside the box where amber starts"""
    tension_warning: Fraction
    """share of the way from T_pre to a bound where amber starts"""
    horizon: Positive
    """s: how far the bounds are predicted"""
    hysteresis: Fraction
    over_tension_ticks: Count
    """ticks beyond T_max or below slack before red"""


class Control(Section):
    controller: Literal["bio", "pid"]
    rates: Rates
    tension: Tension
    filters: Filters
    estimator: Estimator
    stiffness: StiffnessLaw
    impedance: Impedance
    pid: Pid
    distribution: Distribution
    tension_loop: TensionLoop
    freshness: Freshness
    sequence: Sequence
    envelope: Envelope


class RealTime(Section):
    """What the daemon asks of the host; each refusal is reported, none stops a lab run."""

    daemon_priority: Annotated[int, Field(ge=0, le=99)]
    """SCHED_FIFO, 0 for none"""
    lab_priority: Annotated[int, Field(ge=0, le=99)]
    recorder_priority: Annotated[int, Field(ge=0, le=99)]
    lock_memory: bool
    daemon_cpu: int | None = None
    lab_cpu: int | None = None


class Recording(Section):
    ring_s: Positive
    """seconds of cycles the ring file holds for a recorder that is late"""
    chunk_ms: Count
    """a chunk is closed after this much run time: what a killed recorder can lose of a file,
    never of the ring"""
    compression: Literal["zstd", "lz4", "none"]
    raw_frames: bool
    keyframe_s: Positive = 10.0
    """a replay may begin at one of these; a log of before there were any says nothing of them"""
