"""What guards the robot: the ways to stop, the residuals of each cable, the envelope."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from tonus.config.schema.base import Count, Fraction, NonNegative, Positive, Section


class Stop(Section):
    """A stop without a path to keep: in descent with the cables that are left, or passive, each
    drum by itself (`tonus.runtime.safety.guard`)."""

    moment_length: Positive
    """m by which moments are divided in a descent: long beside the platform, so that forces come
    first, and not so long that moments do not count"""
    level_speed: Positive = 2.0
    """rad/s at which the platform is to turn back to level in a descent at most: a larger moment
    than cables can give is asked for in vain, and tightens those that turn it farther"""
    damping: Positive
    """N s/m against the platform's motion in a descent"""
    load_free: Positive = 15.0
    """N of a load from outside that a descent does not balance: errors of the estimate"""
    load_most: NonNegative = 50.0
    """N beyond that it balances at most"""
    load_unrest: Positive = 1.5
    """times the estimator's drift of a load in a descent, so that it ends soon with the load"""
    sink: Fraction
    """share of its weight by which the platform is let sink, once its path goes down"""
    fewest_doubted: Annotated[int, Field(ge=5)] = 7
    """cables that a descent needs once one was excluded by a contradiction, which may have named
    the wrong one: with six no length contradicts another one"""
    landed: Positive
    """m above the cradle that counts as landed"""
    landing_s: NonNegative
    """s that a descent waits for it, before it becomes a passive stop; and that a stop which lets
    go waits for the drums to stand"""
    settle_s: Positive
    """s after the beginning of a descent in which the platform may rise"""
    rise: Positive
    """m by which it may rise later, before the descent becomes a passive stop"""
    unsupported: Positive = 0.55
    """share of the weight by which the plans of a descent without several cables may miss their
    wrench, its moments divided by `moment_length`"""
    unsupported_s: Positive = 0.05
    """s for which they may miss more, before the descent becomes a passive stop"""
    unrest: Positive
    """times the estimator's process noise in a descent"""
    length_sigma: Positive
    """m, noise of a cable's length in a descent, from one tick to the next"""
    offset_sigma: NonNegative = 2.0e-3
    """m by which any length may be wrong when a descent begins: its damping, the cell's lag, and
    slips that no event has named"""
    offset_drift: NonNegative = 2.0e-4
    """m per sqrt(s) by which that changes in a descent"""
    tracker_leap: Positive = 0.75
    """m/s by which the tracker may move faster than the estimate in a descent, from one pose to the
    next; a faster one was moved itself, and is not used until it is moved back"""
    least_tension: Positive
    """N: least that a taut cable is asked for in a descent"""
    most_tension: Positive
    """N: most, likewise"""
    proportional: NonNegative
    """of the tension loop in a descent: faster than where a person is to be met softly"""
    calm: NonNegative = 20.0
    """the same once nothing throws the platform any more, or more than one cable is lost"""
    throw_s: Positive = 0.3
    """s after the loss of a cable in which it may; the gain then changes within `ease_s`"""
    pay_out_s: NonNegative = 0.15
    """s after the loss of one torn cable in which the drum of a cable that pulls more than it is
    asked for pays out as fast as the platform takes the cable"""
    ease_s: Positive
    """s in which the tensions ease off from what they were when it began"""
    tension_rate: Positive
    """N/s: bound on how fast a tension reference may move in a descent"""
    release_s: Positive
    """s, time constant with which a given-up cable on a free drum goes slack"""
    taut_tension: Positive
    """N above which a cable counts as taut, and below half of which it counts as slack"""
    take_up_speed: Positive
    """m/s by which the drum of a slack cable turns faster than the platform comes nearer"""
    take_up_damping: Positive
    """N s/m that keeps it there"""
    reel_in: Positive
    """m/s that a drum reels in at most while the robot stops"""
    reel_out: Positive
    """m/s that a drum reels out before it brakes while the robot stops"""
    reel_damping: Positive
    """N s/m beyond these speeds"""
    tank: NonNegative
    """J that a drum may put in beyond the passive tension in a descent"""
    passive_tension: Positive
    """N that a drum gives by itself"""
    passive_damping: Positive
    """N s/m by which it damps its own motion"""
    passive_damping_in: Positive | None = None
    """N s/m, the same of a drum that reels in: with less of it a slack cable keeps up with a
    platform that sinks; none: `passive_damping`"""
    passive_speed: Positive = 0.15
    """m/s beyond which the damping is `reel_damping`; once all drums have been slower for as long
    as lowering takes on the path, a passive stop reduces its tension"""
    passive_force: Positive
    """N: bound on the sum of both"""
    rest_speed: Positive
    """m/s of cable below which a drum counts as standing"""
    rest_s: Positive
    """s that all drums have to stand before a passive stop lets go, and again before drives are
    disabled"""
    passive_s: Positive
    """s after which it lets go in any case, and for which it waits at least for drums to stand"""

    @model_validator(mode="after")
    def _ordered(self) -> Stop:
        if not self.least_tension <= self.passive_tension <= self.most_tension:
            raise ValueError("least_tension <= passive_tension <= most_tension must hold")
        if self.passive_damping_in is not None and self.passive_damping_in > self.passive_damping:
            raise ValueError("passive_damping_in <= passive_damping must hold")
        return self


class Isolation(Section):
    """When a measurement contradicts the others (`tonus.runtime.safety.isolation`)."""

    length_jump: Positive
    """m from one tick to the next that no platform makes: cable, drum, cell or encoder"""
    jump_ticks: Count
    """ticks in a row until it is a fault; the sample is left out from the first on"""
    tension_error: Positive
    """N between a cable's reference and its filtered tension"""
    tension_error_s: Positive
    """s that it may last"""
    torque_error: Positive
    """N at the cable that a drum's torque may leave unexplained: friction"""
    torque_share: Fraction
    """and of the torque itself: the gearbox's efficiency"""
    torque_s: Positive
    """s, time constant of the observer"""
    torque_ticks: Count
    """in a row"""
    torque_descent_ticks: Count
    """in a row, in a descent or a passive stop, of a drum that turns"""
    given_up_tension: Positive = 240.0
    """N, the most that a cable without a usable cell may pull: what a drum's torque and motion say
    beyond it is the drum's"""
    sample_doubt: Positive
    """s of uncertainty of the time of a sample, beyond which it is not compared with its torque"""
    unobserved_s: Positive
    """s in which samples do not allow a drum to be compared with its torque, until it is an
    event"""
    acceleration: Positive
    """times what a drum's motor can give, at its current limit and without a cable"""
    overwound: Positive
    """m by which a slack cable's length falls short of its way to the platform"""
    travel: Positive
    """m that the platform's motion shortens a cable by while its drum does not turn at all"""
    innovation: Positive
    """m, mean innovation of a cable's length that counts as a contradiction"""
    elongation_doubt: NonNegative = 3.0
    """sigmas of a changing elongation, with the cable's compliance as well known as it is so far,
    that say nothing in it"""
    innovation_descent: Positive = 3.5e-3
    """m that the length of a cable that pulls becomes wrong by in a descent"""
    innovation_descent_s: Positive = 0.2
    """s that it lasts"""
    prominence: Positive
    """times the second largest: the largest then tells which cable it is"""
    innovation_s: Positive
    """s over which it is averaged"""
    frozen_change: Positive
    """N that a tension's reference moves while its cell's reading does not"""
    frozen_ticks: Count
    """fresh samples in a row to the last bit equal: a load cell has noise"""
    frozen_band: Positive = 0.4
    """N that a reading stays within, although its reference moves by `frozen_step`, for as many
    samples: the force is frozen, and its noise is not"""
    frozen_step: Positive = 8.0
    """N"""
    frozen_travel: Positive = 0.02
    """m that the drum of a failed drive winds, while the reading of its cable stays within that and
    is more than `torque_error`: no drive pays out so far at one force"""
    freed_travel: Positive = 0.003
    """m that a drum turns which stood against its torque when it was named: it may damp again"""
    witness: Positive = 4.0e-3
    """m that a length changes by, less its distance as the tracker sees it, in `witness_s`"""
    witness_s: Positive = 0.4
    """s: longer than a slip lasts, shorter than calibration takes to change"""
    witness_share: Fraction = 0.2
    """and of the change of its elongation: compliance is known to that"""


class Freshness(Section):
    measurement_ticks: Count
    """a measurement older than this carries no torque"""
    stale_stop_ticks: Count
    """ticks without a fresh measurement until the controlled stop; left out, it is what
    `tonus.config.schema.place` says"""


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
    rate_cutoff_hz: Positive
    """first-order low-pass of the contact force's rate that the prediction uses"""
    hysteresis: Fraction
    """share of a limit by which full softness comes before it"""
    release_band: NonNegative
    """share of the amber zone by which a bound must recede before the envelope lets go"""
    release_rate: Positive
    """1/s: how fast it lets go"""
    over_tension_ticks: Count
    """ticks beyond T_max or below slack before red"""
