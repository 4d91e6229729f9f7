"""The Dynamic Safety Envelope: eq. (4) and (14), predicted over a horizon and graded.

Green leaves the run untouched. Amber: a bound is predicted to be met within the horizon, so the
stiffness cap falls and the reference slows, if necessary to standstill, at once; both return slowly
and only when the distance to the bound has grown by a band. Without that hysteresis the platform
oscillates between soft and stiff. Red: a bound is met, and the state machine stops the robot.

The order is law, cap, limiter: the law raises the stiffness with force, the cap limits it near the
contact limit.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.control import StiffnessLaw
from tonus.config.schema.robot import Robot, Tension
from tonus.config.schema.safety import Envelope as Settings
from tonus.runtime.signals import Bound, Grade
from tonus.runtime.states import Fault

Array = NDArray[np.float64]
_GRADED = (Bound.CONTACT, Bound.SPEED, Bound.WORKSPACE, Bound.TENSION_HIGH)
# Looked up once: a member of an enumeration takes ten times as long as a name (Python 3.11).
_NO_FAULT = Fault.NONE
_GREEN = Grade.GREEN
_AMBER = Grade.AMBER
_RED = Grade.RED
_NO_BOUND = Bound.NONE
_CONTACT = Bound.CONTACT
_TENSION_HIGH = Bound.TENSION_HIGH
_TENSION_LOW = Bound.TENSION_LOW


@njit(cache=True)
def _tension_margins(
    tension: Array,
    last: Array,
    reach: float,
    bearing: NDArray[np.bool_],
    bounds: tuple[float, float, float],
    over: NDArray[np.int64],
    under: NDArray[np.int64],
) -> tuple[float, float, int, int]:
    """Smallest distance (N) to T_max and T_min, predicted; and the most ticks any cable has spent
    beyond T_max or slack. ``bounds``: T_min, T_max, T_slack."""
    low, high, slack = bounds
    to_high, to_low = high, high
    for i in range(tension.shape[0]):
        ahead = tension[i] + reach * (tension[i] - last[i])
        last[i] = tension[i]
        over[i] = over[i] + 1 if tension[i] > high else 0
        under[i] = under[i] + 1 if bearing[i] and tension[i] < slack else 0
        if bearing[i]:
            to_high = min(to_high, high - ahead)
            to_low = min(to_low, ahead - low)
    return to_high, to_low, over.max(), under.max()


@njit(cache=True)
def _place_and_speed(
    position: Array, velocity: Array, horizon: float, low: Array, high: Array
) -> tuple[float, float, float]:
    """m to the nearest face of the box, negative outside, now and a horizon on; and m/s."""
    now, then, square = math.inf, math.inf, 0.0
    for i in range(3):
        ahead = position[i] + horizon * velocity[i]
        now = min(now, position[i] - low[i], high[i] - position[i])
        then = min(then, ahead - low[i], high[i] - ahead)
        square += velocity[i] * velocity[i]
    return now, then, math.sqrt(square)


@njit(cache=True)
def _shares(
    left: tuple[float, float, float, float], held: Array, band: float, release: float
) -> tuple[int, float]:
    """Which share of ``held`` (4,), each 0 to 1, is the least, and that share. Each goes down with
    what is ``left`` at once, and up by ``release`` a tick once that is a band above."""
    least = 0
    for i in range(held.shape[0]):
        if left[i] < held[i]:
            held[i] = max(left[i], 0.0)
        elif left[i] - band > held[i]:
            held[i] = min(left[i] - band, 1.0, held[i] + release)
        if held[i] < held[least]:
            least = i
    return least, held[least]


@njit(cache=True)
def _foresee(
    tension: Array,
    contact: float,
    position: Array,
    velocity: Array,
    bearing: NDArray[np.bool_],
    last_contact: float,
    swell: float,
    last: Array,
    beyond: NDArray[np.int64],
    held: Array,
    box: Array,
    enabled: bool,
    numbers: Array,
) -> tuple[float, float, float, float, float, float, float, float, int, int, int, float]:
    """All that is computed of a tick: the ``swell`` (N/s) of the contact force; the shares that are
    left of the tensions' spans, of contact and of speed, and the distance (m) to the box; then what
    is met now: speed (m/s), place (m) and ticks beyond a tension; last, if ``enabled``, which bound
    has least left and how much of it, as `_shares` has them. ``beyond`` (2, n): ticks that a cable
    has spent beyond T_max, and slack; ``box`` (2, 3); ``numbers`` as `Envelope` keeps them."""
    horizon, period, follow = numbers[0], numbers[1], numbers[2]
    bounds, span_high, span_low = (numbers[3], numbers[4], numbers[5]), numbers[6], numbers[7]
    contact_limit, speed_limit, soft_force = numbers[8], numbers[9], numbers[10]
    warn_force, soft_speed, warn_speed = numbers[11], numbers[12], numbers[13]
    edge, margin, band, release = numbers[14], numbers[15], numbers[16], numbers[17]
    to_high, to_low, longest_over, longest_under = _tension_margins(
        tension, last, horizon / period, bearing, bounds, beyond[0], beyond[1]
    )
    swell += follow * ((contact - last_contact) / period - swell)
    force = max(contact, contact + horizon * swell)
    inside, workspace, speed = _place_and_speed(position, velocity, horizon, box[0], box[1])
    tension_high = to_high / span_high
    place, share = 0, 1.0
    if enabled:
        left = (
            (soft_force - force) / (soft_force - warn_force),
            (soft_speed - speed) / (soft_speed - warn_speed),
            workspace / margin if margin != 0.0 else math.inf,
            tension_high / edge,
        )
        place, share = _shares(left, held, band, release)
    return (
        swell,
        tension_high,
        to_low / span_low,
        (contact_limit - force) / contact_limit,
        (speed_limit - speed) / speed_limit,
        workspace,
        speed,
        inside,
        longest_over,
        longest_under,
        place,
        share,
    )


class Envelope:
    """Grades one tick; `cap`, `progress` and `fault` are what the cycle acts on."""

    def __init__(
        self, settings: Settings, tension: Tension, law: StiffnessLaw, robot: Robot, period: float
    ) -> None:
        self._settings, self._law = settings, law
        sides, cables = robot.workspace, robot.cables
        self._box = np.array([sides.x, sides.y, sides.z]).T.copy()
        self._beyond = np.zeros((2, cables), dtype=np.int64)
        self._over, self._under = self._beyond
        self._last_tension = np.zeros(cables)
        self._last_contact = self._swell = 0.0
        self._held = np.ones(len(_GRADED))
        """what is left of each graded bound, over 1 untouched, as it is acted on"""
        self._follow = 1.0 - math.exp(-2.0 * math.pi * settings.rate_cutoff_hz * period)
        self._edge = 1.0 - settings.tension_warning
        # Full softness is reached a hysteresis short of the limit, so that the platform comes to
        # rest inside the bound and not on it.
        s, t = settings, tension
        self._kept = (
            self._last_tension,
            self._beyond,
            self._held,
            self._box,
            s.enabled,
            np.array(
                [
                    *(s.horizon, period, self._follow),
                    *(t.min, t.max, t.slack, t.max - t.pre, t.pre - t.min),
                    *(s.contact_limit, s.speed_limit),
                    s.contact_limit * (1.0 - s.hysteresis),
                    s.contact_limit * s.contact_warning,
                    s.speed_limit * (1.0 - s.hysteresis),
                    s.speed_limit * s.speed_warning,
                    *(self._edge, s.workspace_margin, s.release_band, s.release_rate * period),
                ]
            ),
        )
        self.reset()

    def reset(self) -> None:
        self.cap = self._law.maximum
        """N/m"""
        self.progress = 1.0
        """rate of the scenario's time"""
        self.grade = _GREEN
        self.bound = _NO_BOUND
        self.fault = _NO_FAULT
        self.where = -1
        self.tension_high = self.tension_low = self.contact = self.speed = self.workspace = 1.0
        self._beyond[:] = 0
        self._held[:] = 1.0
        self._first = True

    def __call__(
        self,
        tension: Array,
        contact: float,
        position: Array,
        velocity: Array,
        bearing: NDArray[np.bool_],
    ) -> None:
        """Grade a tick from filtered tensions (n,), filtered contact force, pose estimate and the
        mask ``bearing`` (n,) of cables that ought to carry tension."""
        if self._first:
            self._first = False
            self._last_tension[:] = tension
            self._last_contact, self._swell = contact, 0.0
        (
            self._swell,
            self.tension_high,
            self.tension_low,
            self.contact,
            self.speed,
            self.workspace,
            speed,
            inside,
            over,
            under,
            place,
            share,
        ) = _foresee(
            tension,
            contact,
            position,
            velocity,
            bearing,
            self._last_contact,
            self._swell,
            *self._kept,
        )
        self._last_contact = contact
        if self._settings.enabled:
            self._judge(contact, speed, inside, over, under)
            self._soften(_GRADED[place], share)

    def _judge(self, contact: float, speed: float, inside: float, over: int, under: int) -> None:
        """Red: what is met now, not what is predicted."""
        s, ticks = self._settings, self._settings.over_tension_ticks
        self.fault, self.where = _NO_FAULT, -1
        if contact >= s.contact_limit:
            self.fault = Fault.CONTACT_LIMIT
        elif over >= ticks:
            self.fault, self.where = Fault.OVER_TENSION, int(self._over.argmax())
        elif under >= ticks:
            self.fault, self.where = Fault.SLACK_CABLE, int(self._under.argmax())
        elif speed >= s.speed_limit:
            self.fault = Fault.SPEED_LIMIT
        elif inside < 0.0:
            self.fault = Fault.WORKSPACE_LIMIT

    def _soften(self, bound: Bound, share: float) -> None:
        """Amber: of the ``bound`` that decides only a ``share`` is left, 1 untouched, 0 used up."""
        low, high = self._law.minimum, self._law.maximum
        stiffening = bound in (_CONTACT, _TENSION_HIGH)
        self.cap = low + share * (high - low) if stiffening else high
        self.progress = share
        amber = share < 1.0 or self.tension_low < -self._edge
        if self.fault is not _NO_FAULT:
            self.grade = _RED
        elif amber:
            self.grade = _AMBER
        else:
            self.grade = _GREEN
        self.bound = bound if share < 1.0 else (_TENSION_LOW if amber else _NO_BOUND)
