"""Control: filters, estimator, law, distribution, inner loop, envelope."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from tonus.config.errors import PlacedError
from tonus.config.schema.base import Count, Fraction, NonNegative, Positive, Section
from tonus.config.schema.controller import ControllerChoice
from tonus.config.schema.robot import Rates, Tension
from tonus.config.schema.safety import Envelope, Freshness, Isolation, Stop


class Filters(Section):
    force_cutoff_hz: Positive
    """second-order Butterworth on every load cell (paper, section 3.4)"""
    plausible_force: Positive
    """N: a cell that reports more is not used"""
    plausible_speed: Positive
    """times the motor's nominal speed: an encoder that reports more is not used"""


class Estimator(Section):
    """Error-state Kalman filter of pose, twist, external wrench and the cables' calibration.
    Process noise is white: per square root of a hertz."""

    length_sigma: Positive
    """m, noise of a measured cable length, elongation included"""
    acceleration_sigma: Positive
    """m/s2 per sqrt(Hz): what the wrench balance misses"""
    angular_acceleration_sigma: Positive
    force_drift: Positive
    """N/s per sqrt(Hz): how fast an external force may change"""
    moment_drift: Positive
    """N m/s per sqrt(Hz)"""
    offset_drift: NonNegative
    """m/s per sqrt(Hz): how fast a cable's length offset may change"""
    start_speed_sigma: NonNegative
    """m/s: how far from rest the platform may be when it has been referenced"""
    compliance_sigma: NonNegative
    """relative uncertainty of EA before the first motion, of what all cables have in common; 0,
    like its spread and its drift, for no calibration"""
    compliance_spread: NonNegative = 0.1
    """the same of what each cable's EA differs by from the others'; not used with six cables"""
    compliance_drift: NonNegative
    """1/s per sqrt(Hz): how fast what they have in common may change"""
    elongation_time: Positive
    """s over which elongations are averaged before they tell compliance from offset"""
    gate: Positive
    """largest chi-square (of all lengths) of a tracker pose that is still accepted"""
    refused_poses: Count
    """so many in a row beyond the gate are no outliers"""
    refused_spread: Positive
    """times the tracker's own sigma: refused poses within it of each other are of one opinion"""
    relearn_limit: NonNegative
    """m: largest such disagreement that is taken for an error of the cables and learnt"""
    consistency_time: Positive
    """s over which the lengths' squared innovations are averaged"""
    consistency_limit: Positive
    """their largest average, in variances, that still counts as consistent"""
    condition_limit: Positive
    """of the structure matrix, moments scaled; beyond it a pose counts as singular"""


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
    smoothing_hz: Positive
    """first-order low-pass of what the law reads: noise of the estimate is no reason to stiffen"""
    rise_rate: Positive
    """N/m/s: how fast the stiffness may grow at most; `tonus.runtime.control.passivity` computes
    the bound below it"""

    @model_validator(mode="after")
    def _ordered(self) -> StiffnessLaw:
        if not self.minimum < self.base <= self.maximum:
            raise ValueError("minimum < base <= maximum must hold")
        return self


class Passivity(Section):
    """The energy tank behind the law (Ferraguti, Secchi and Fantuzzi 2013), J."""

    tank_capacity: Positive
    tank_initial: Positive
    tank_minimum: Positive
    tank_efficiency: Annotated[float, Field(gt=0, le=1)]
    """share of what the damper and a falling stiffness take out that is kept"""

    @model_validator(mode="after")
    def _ordered(self) -> Passivity:
        if not self.tank_minimum <= self.tank_initial <= self.tank_capacity:
            raise ValueError("tank_minimum <= tank_initial <= tank_capacity must hold")
        return self


class Impedance(Section):
    damping_ratio: Positive
    rotational_stiffness: Positive
    """N m/rad"""
    rotational_damping: NonNegative
    """N m s/rad"""


class Bio(Section):
    damping_ratio: Positive | None = None
    """none, here and below: the one under impedance"""


class Pd(Section):
    stiffness: Positive | None = None
    """N/m; none: the law's base"""
    damping_ratio: Positive | None = None


class Integral(Section):
    gain: NonNegative
    """N/(m s)"""
    limit: Positive
    """N"""


class Pid(Section):
    stiffness: Positive
    damping_ratio: Positive
    integral: Integral


class BioIntegral(Integral):
    damping_ratio: Positive | None = None


class PdMatched(Section):
    stiffness: Positive
    """N/m: the mean of what `bio` commands"""
    damping_ratio: Positive | None = None


class BioObserver(Section):
    cutoff_hz: Positive
    """first-order low-pass of the load that is fed forward"""
    limit: Positive
    """N: no larger load is compensated"""
    damping_ratio: Positive | None = None
    reflex: NonNegative = 0.0
    """1/s: how fast a force that a scenario asks for is made up for where the contact lacks it"""
    reflex_limit: Positive = 20.0
    """N"""
    tone: Annotated[float, Field(gt=0, le=1)] = 1.0
    """share of the pretension that is kept at rest; the law co-contracts from there"""


class PidLength(Section):
    """Per cable, in N of tension per m of unstretched length."""

    proportional: Positive
    integral: NonNegative
    """N/(m s)"""
    derivative: NonNegative
    """N s/m"""
    integral_limit: Positive
    """N"""


class Force(Section):
    proportional: NonNegative
    integral: NonNegative
    """1/s"""
    damping: NonNegative
    """N s/m"""
    integral_limit: Positive
    """N"""
    threshold: Positive
    """N at the contact port from which on there is contact"""
    release_s: Positive
    """s"""
    body_stiffness: Positive
    """N/m of a body it is meant for, which its margins are computed with"""


class Eq9Literal(Section):
    gain: Positive


class ConstantTension(Section):
    settle_s: Positive
    """s in ACTIVE before the tensions are frozen, at their mean over the second half of it"""
    integral: NonNegative = 100.0
    """1/s, of its tension loop: with no outer loop round it, and without friction, the shared gain
    would let drums and platform slowly start to swing"""


class Distribution(Section):
    """One box-bounded quadratic programme, `tonus.runtime.control.distribution`."""

    wrench_weight: Positive
    deficit_limit: Positive
    """N: a larger part of the wrench left undelivered is reported"""
    tension_rate: Positive
    """N/s: bound on how fast a tension reference may move"""
    co_contraction: Fraction
    """share of the relative stiffness rise that the tension reference follows"""
    co_contraction_hz: Positive | None = None
    """first-order low-pass between them, as a muscle's activation has one; none: at once"""
    stiffness_weight: NonNegative
    """m2: how much a change of the geometric stiffness along the wrench counts"""
    least_force: Positive
    """N below which a wrench has no direction to speak of"""
    solver: Literal["daqp", "clarabel"] = "clarabel"
    """of the programme where a bound matters. A log of before there was a choice names none, and
    was made with Clarabel; where DAQP has no proven answer, Clarabel is asked as well"""
    largest_error: Positive = 1e-6
    """N from the optimum that an answer of DAQP is proven to have at most"""
    maximum_iterations: Count
    """of each solver"""
    tolerance: Positive
    """of Clarabel's gap, N2, absolute and relative"""


class Friction(Section):
    """Drive friction as far as it is known; the gearbox's loss and the drum stand under `robot`."""

    coulomb: NonNegative
    """N at the cable"""
    load: NonNegative
    """share of the tension"""
    slip: Positive
    """m/s of cable over which friction changes sign"""


class TensionLoop(Section):
    """Eq. (6) and (9), completed: feed-forward, proportional, integral, drum-rate damping."""

    feed_forward: Fraction
    proportional: NonNegative
    integral: NonNegative
    """1/s"""
    integral_limit: Positive
    """N"""
    rate_damping: NonNegative
    """N m s/rad at the drum"""
    lead: Fraction = 0.0
    """share of the drum rate that a change of the reference takes on an elastic cable; a log of
    before there was any says nothing of it"""
    lead_cutoff_hz: Positive = 30.0
    """first-order low-pass of the reference's rate"""
    lead_rate: Positive = 1000.0
    """N/s: a faster reference is not followed any faster"""
    friction: Friction
    gain_margin_db: Positive
    phase_margin_deg: Positive
    """floors that `tonus check` computes against, without friction and with the real delay"""


class Mismatch(Section):
    """By which share a robot may differ from its description where the margins of a load observer
    are computed: to it a wrong mass, stiffness or damping looks like a load."""

    mass: Fraction = 0.0
    """of the platform"""
    axial_stiffness: Fraction = 0.0
    """of all cables together"""
    damping: Fraction = 0.0
    """of all cables"""


class Sequence(Section):
    """How long each step of bringing up may take and how smoothly it goes."""

    tare_s: Positive
    referencing_settle_s: Positive
    referencing_average_s: Positive
    slack_s: NonNegative = 0.0
    """referencing lets a cable be slack for so long beyond `tension.slack`, and then goes back to
    that tension until it pulls"""
    take_up_s: NonNegative = 0.0
    """s after which a cable that is still slack has failed; 0 in a log of before: none waits"""
    pretension_s: Positive
    lift_s: Positive
    """s of minimum-jerk motion from the cradle to home"""
    stop_s: Positive
    """controlled stop: slowing to standstill, and at its end letting the tensions down, take this
    long each"""
    lower_s: Positive
    """s of minimum-jerk motion back to the cradle"""
    release_load: Positive
    """N: a platform in its cradle is let go only while no more than this pushes it"""
    hold_s: NonNegative
    """s that a stop waits for a larger load to be taken away"""
    enable_timeout_s: Positive
    referencing_tension_error: Positive
    """N: largest deviation from the even tension that still counts as settled"""
    referencing_spread: Positive
    """m: largest departure of a tracker pose from the mean of those it is averaged with"""
    referencing_distance: Positive
    """m: largest distance of the referenced pose from the cradle"""
    referencing_turn_deg: Annotated[Positive, Field(le=180)] = 180.0
    """largest turn of that pose: a platform that lies on the rims of its cups slides into them as
    its cables pull"""
    referencing_poses: Count
    """fewest tracker poses that make a reference"""
    tare_limit: Positive
    """N: a larger reading of an unloaded cell is a defect and not an offset"""
    tare: tuple[float, ...] | None = None
    """N: an offset for each cell, stated; null: what they read unloaded at the start is measured"""
    reference_slew: Positive
    """1/s: how fast the scenario's time may slow down or pick up"""


class Control(Section):
    controller: ControllerChoice
    rates: Rates
    tension: Tension
    filters: Filters
    estimator: Estimator
    stiffness: StiffnessLaw
    passivity: Passivity
    impedance: Impedance
    bio: Bio = Bio()
    pd: Pd = Pd()
    pd_matched: PdMatched
    pid: Pid
    bio_integral: BioIntegral
    bio_observer: BioObserver
    pid_length: PidLength
    force: Force
    eq9_literal: Eq9Literal
    constant_tension: ConstantTension = ConstantTension(settle_s=1.0)
    distribution: Distribution
    tension_loop: TensionLoop
    mismatch: Mismatch = Mismatch()
    freshness: Freshness
    sequence: Sequence
    stop: Stop
    isolation: Isolation
    envelope: Envelope

    @model_validator(mode="after")
    def _sampled(self) -> Control:
        half = 0.5 / self.rates.period
        if self.filters.force_cutoff_hz >= half:
            text = f"{self.filters.force_cutoff_hz:g} Hz are not below half of the cycle's rate"
            raise PlacedError(("filters", "force_cutoff_hz"), f"{text}; choose less than {half:g}")
        return self

    @model_validator(mode="after")
    def _carried(self) -> Control:
        least, given = self.tension.max, self.isolation.given_up_tension
        if given < least:
            text = f"{given:g} N are less than control.tension.max, which a cable may carry"
            raise PlacedError(
                ("isolation", "given_up_tension"), f"{text}; choose at least {least:g}"
            )
        return self


class Recording(Section):
    ring_s: Positive
    """seconds of cycles the ring file holds for a recorder that is late"""
    chunk_ms: Count
    """a chunk is closed after this much run time: what a killed recorder can lose of a file,
    never of the ring"""
    compression: Literal["zstd", "lz4", "none"]
    raw_frames: bool
    keyframe_s: Positive = 10.0
    """a replay may begin at one of these"""
    viewer_hz: NonNegative = 0.0
    """messages a second of the robot's picture for viewers; 0: none"""
    rotate_mb: NonNegative = 0.0
    """a file that has grown this large is followed by another; 0: never"""
    rotate_s: NonNegative = 0.0
    """a file that has recorded this much run time is followed by another; 0: never"""
    keep_free_mb: NonNegative = 0.0
    """recording stops, and control continues, when the disk has less room than this"""
    keep_files: Annotated[int, Field(ge=0)] = 0
    """files of a run that rotation keeps, the oldest others are deleted; 0: all"""
