"""The inner loop: from tension reference to drum torque (eq. 6 and 9, completed).

Eq. (9) alone is proportional and has neither feed-forward nor damping; docs/paper.md, row 13, shows
why that cannot reach half a per cent. Here

    torque = r (T_ref + K_T (T_ref - T) + I) + C_d (rate_ref - rate) + M(T_ref, rate_d, acc_d)
    rate_ref = (u . v + lead l/EA dT_ref/dt) / r

so that the damping acts neither on the platform, whose motion the drums follow, nor on a change of
commanded tension: a cable of length l needs its drum to turn by l/(EA r) for each newton. Without
this lead a damped loop lags, and the outer loop has no phase margin (docs/control.md). It is
filtered, and bounded so that a jump of T_ref causes no torque peak. M is the torque that the drive
needs for the desired motion: the drum's inertia and friction, and the gearbox's loss, which helps
to hold a cable that is reeled out. It uses the desired motion and never the measured one: friction
compensated by its measured rate is positive feedback. Drum rate and tension are taken unfiltered: a
filter's delay would cost the phase margin that `tonus.tools.margins.tension_loop` computes.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.axis import DriveTrain
from tonus.config.schema.control import TensionLoop as Settings
from tonus.config.schema.robot import Robot

Array = NDArray[np.float64]


@njit(cache=True)
def drum_motion(
    matrix: Array,
    wrench: Array,
    tension: Array,
    twist: tuple[Array, Array],
    desired: tuple[Array, Array, Array, Array],
    radius: Array,
    axial_stiffness: Array,
    rate: Array,
    desired_rate: Array,
    desired_acceleration: Array,
) -> bool:
    """Drum rates (n,) that follow the platform's ``twist`` at constant tension (eq. 1), and rates
    and accelerations on the ``desired`` motion (velocity, acceleration, angular velocity, angular
    acceleration). ``radius`` (n,) of the drums, ``axial_stiffness`` (n,) of the cables. Whether the
    rates and the ``wrench`` are numbers.
    """
    finite = True
    for row in range(6):
        finite = finite and math.isfinite(wrench[row])
    for i in range(rate.shape[0]):
        following = wanted = bend = 0.0
        for row in range(3):
            following += matrix[row, i] * twist[0][row] + matrix[3 + row, i] * twist[1][row]
            wanted += matrix[row, i] * desired[0][row] + matrix[3 + row, i] * desired[2][row]
            bend += matrix[row, i] * desired[1][row] + matrix[3 + row, i] * desired[3][row]
        rate[i] = following / (radius[i] * (1.0 + tension[i] / axial_stiffness[i]))
        desired_rate[i] = wanted / radius[i]
        desired_acceleration[i] = bend / radius[i]
        finite = finite and math.isfinite(rate[i]) and math.isfinite(desired_rate[i])
    return finite


@njit(cache=True)
def _expected(
    tension: Array,
    rate: Array,
    acceleration: Array,
    drums: tuple[Array, Array, Array, Array],
    friction: tuple[float, float, float],
    torque: Array,
) -> None:
    """``drums`` (n,): radius, inertia, viscous friction, efficiency of the gearbox; ``friction``:
    Coulomb (N), share of the tension, cable speed (m/s) from which it acts in full."""
    radius, inertia, viscous, efficiency = drums
    coulomb, load, slip = friction
    for i in range(tension.shape[0]):
        way, pull = math.tanh(rate[i] / (slip / radius[i])), radius[i] * tension[i]
        needed = pull + way * (radius[i] * coulomb + load * pull)
        needed += viscous[i] * rate[i] + inertia[i] * acceleration[i]
        through = efficiency[i] if way < 0.0 else 1.0 / efficiency[i]
        torque[i] = needed * (1.0 + abs(way) * (through - 1.0)) - pull


@njit(cache=True)
def _torques(
    reference: Array,
    measured: Array,
    rate_reference: Array,
    rate: Array,
    expected: Array,
    usable: NDArray[np.bool_],
    drums: tuple[Array, Array, Array],
    gains: tuple[float, float, float, float],
    leading: tuple[Array, float, float],
    lengths: Array,
    past: tuple[Array, Array],
    integral: Array,
    torque: Array,
) -> None:
    """``drums`` (n,): radius, damping, largest torque; ``leading``: rate (n,) of a drum for each
    newton a tick of a cable of 1 m, share of a tick in the slope, largest slope (N)."""
    radius, damping, limit = drums
    forward, proportional, integral_step, integral_limit = gains
    turn, follow, fastest = leading
    last, slope = past
    for i in range(reference.shape[0]):
        torque[i] = 0.0
        moved = reference[i] - last[i]
        last[i] = reference[i]
        if math.isfinite(moved):  # it is not in the first tick, nor round what is no number
            slope[i] += follow * (min(max(moved, -fastest), fastest) - slope[i])
        if not usable[i]:
            integral[i] = slope[i] = 0.0
            continue
        error = reference[i] - measured[i]
        grown = integral[i] + (integral_step * error if math.isfinite(error) else 0.0)
        integral[i] = min(max(grown, -integral_limit), integral_limit)
        wanted = radius[i] * (forward * reference[i] + proportional * error + integral[i])
        ahead = turn[i] * lengths[i] * slope[i]
        wanted += damping[i] * (rate_reference[i] + ahead - rate[i]) + forward * expected[i]
        if math.isfinite(wanted):
            torque[i] = min(max(wanted, -limit[i]), limit[i])


# The rows of the table of the drums, (rows, n): constants first, then what a tick leaves behind.
(
    _RADIUS,
    _INERTIA,
    _VISCOUS,
    _EFFICIENCY,
    _DAMPING,
    _LIMIT,
    _TURN,
    _AXIAL_STIFFNESS,
    _LAST,
    _SLOPE,
    _EXPECTED,
    _INTEGRAL,
    _TORQUE,
) = range(13)
_ROWS = _TORQUE + 1
# The rows of the drums' motion, (3, n).
FOLLOWING, DESIRED_RATE, DESIRED_ACCELERATION = range(3)


@njit(cache=True)
def _tick(
    reference: Array,
    measured: Array,
    rate: Array,
    usable: NDArray[np.bool_],
    lengths: Array,
    motion: Array,
    damped: int,
    drums: Array,
    numbers: Array,
) -> None:
    """`_expected`, then `_torques`, damped against the row ``damped`` of ``motion``. ``drums`` and
    ``numbers`` as in `TensionLoop`: one table takes a tenth of the time of its rows to hand over.
    """
    desired_rate, desired_acceleration = motion[DESIRED_RATE], motion[DESIRED_ACCELERATION]
    trains = (drums[_RADIUS], drums[_INERTIA], drums[_VISCOUS], drums[_EFFICIENCY])
    friction = (numbers[0], numbers[1], numbers[2])
    expected = drums[_EXPECTED]
    _expected(reference, desired_rate, desired_acceleration, trains, friction, expected)
    _torques(
        reference,
        measured,
        motion[damped],
        rate,
        expected,
        usable,
        (drums[_RADIUS], drums[_DAMPING], drums[_LIMIT]),
        (numbers[3], numbers[4], numbers[5], numbers[6]),
        (drums[_TURN], numbers[7], numbers[8]),
        lengths,
        (drums[_LAST], drums[_SLOPE]),
        drums[_INTEGRAL],
        drums[_TORQUE],
    )


@njit(cache=True)
def _follow(
    matrix: Array,
    wrench: Array,
    velocity: Array,
    turning: Array,
    wanted_velocity: Array,
    wanted_acceleration: Array,
    wanted_turning: Array,
    wanted_bend: Array,
    follows: bool,
    reference: Array,
    measured: Array,
    felt: Array,
    rate: Array,
    usable: NDArray[np.bool_],
    lengths: Array,
    motion: Array,
    drums: Array,
    numbers: Array,
) -> bool:
    """`drum_motion`, then `_tick` for the tensions ``felt`` (n,) N, against the rates that follow
    the platform or, unless it ``follows``, the desired ones; returns what the first does."""
    finite = drum_motion(
        matrix,
        wrench,
        measured,
        (velocity, turning),
        (wanted_velocity, wanted_acceleration, wanted_turning, wanted_bend),
        drums[_RADIUS],
        drums[_AXIAL_STIFFNESS],
        motion[FOLLOWING],
        motion[DESIRED_RATE],
        motion[DESIRED_ACCELERATION],
    )
    damped = FOLLOWING if follows else DESIRED_RATE
    _tick(reference, felt, rate, usable, lengths, motion, damped, drums, numbers)
    return finite


def of_axis(settings: Settings, train: DriveTrain, robot: Robot) -> Settings:
    """The settings of one axis: they are stated for the robot's default drum, and the damping goes
    with the drum's inertia. A drum of another radius with the same mass at the cable then makes the
    same loop."""
    share = train.drum.inertia / robot.drum.inertia
    return settings.model_copy(update={"rate_damping": settings.rate_damping * share})


class TensionLoop:
    """One tick of n independent loops."""

    def __init__(self, robot: Robot, settings: Settings, period: float) -> None:
        radius = robot.drum_radius
        each = [of_axis(settings, train, robot) for train in robot.drive_trains]
        drums = self._drums = np.zeros((_ROWS, robot.cables))
        drums[_RADIUS], drums[_INERTIA] = radius, robot.drum_inertia
        drums[_VISCOUS], drums[_EFFICIENCY] = robot.viscous_friction, robot.gearbox_efficiency
        drums[_DAMPING] = [own.rate_damping for own in each]
        drums[_LIMIT], drums[_AXIAL_STIFFNESS] = robot.torque_limit, robot.axial_stiffness
        drums[_TURN] = settings.lead / (robot.axial_stiffness * radius * period)
        drums[_LAST] = np.nan
        self.damping = drums[_DAMPING]
        """N m s/rad (n,), of each drum's rate"""
        self.torque: Array = drums[_TORQUE]
        """N m, of the last tick"""
        self.integral = drums[_INTEGRAL]
        """N"""
        self._motion = np.zeros((3, robot.cables))
        self._goes_on = settings.integral > 0.0
        friction = settings.friction
        self._numbers = np.array(
            [
                *(friction.coulomb, friction.load, friction.slip),
                settings.feed_forward,
                settings.proportional,
                settings.integral * period,
                settings.integral_limit,
                1.0 - math.exp(-2.0 * math.pi * settings.lead_cutoff_hz * period),
                settings.lead_rate * period,
            ]
        )

    def reset(self) -> None:
        self.integral[:] = 0.0
        self._drums[_LAST], self._drums[_SLOPE] = np.nan, 0.0

    def take_over(self, before: TensionLoop) -> None:
        """Go on where another loop has been, if there is an integral to go on with."""
        self.reset()
        if self._goes_on:
            self.integral[:] = before.integral

    def __call__(
        self,
        reference: Array,
        measured: Array,
        rate_reference: Array,
        rate: Array,
        usable: NDArray[np.bool_],
        lengths: Array,
        desired: tuple[Array, Array] | None = None,
    ) -> Array:
        """Torque (n,) in N m at the drum, zero where ``usable`` (n,) is false. Tensions in N, rates
        in rad/s, reeling in positive, cable ``lengths`` in m; ``desired``: rate and acceleration of
        the desired motion, None for none."""
        motion = self._motion
        motion[FOLLOWING] = rate_reference
        motion[DESIRED_RATE], motion[DESIRED_ACCELERATION] = desired or (0.0, 0.0)
        kept = (motion, FOLLOWING, self._drums, self._numbers)
        _tick(reference, measured, rate, usable, lengths, *kept)
        return self.torque

    def follow(
        self,
        matrix: Array,
        wrench: Array,
        twist: tuple[Array, Array],
        desired: tuple[Array, Array, Array, Array],
        reference: Array,
        measured: Array,
        felt: Array,
        rate: Array,
        usable: NDArray[np.bool_],
        lengths: Array,
        motion: Array,
        *,
        follows: bool,
    ) -> bool:
        """A tick in which the platform is regulated: the torques, which stay in `torque`, from
        `drum_motion`, whose arguments and result these are; ``motion`` (3, n): what that writes, in
        the rows `FOLLOWING`, `DESIRED_RATE` and `DESIRED_ACCELERATION`; ``felt`` (n,) N: the
        tensions that the loop answers. The rate is damped against the platform's where it
        ``follows`` that, else against the desired."""
        return bool(
            _follow(
                matrix,
                wrench,
                *twist,
                *desired,
                follows,
                reference,
                measured,
                felt,
                rate,
                usable,
                lengths,
                motion,
                self._drums,
                self._numbers,
            )
        )
