"""The tension loop and the drums' motion against their formulas in NumPy, term by term, for inputs
of every size and robots whose axes differ."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from tonus.config import load
from tonus.runtime.control.tension import TensionLoop, drum_motion

CONFIG = load("config/unlike_axes.yaml")[0]
ROBOT, PERIOD = CONFIG.robot, CONFIG.control.rates.period
SETTINGS = CONFIG.control.tension_loop.model_copy(
    update={
        "integral": 5.0,
        "integral_limit": 0.6,
        "proportional": 3.0,
        "feed_forward": 0.9,
        "lead": 0.7,
        "lead_cutoff_hz": 30.0,
        "lead_rate": 4000.0,
    }
)
N = ROBOT.cables
RADIUS, LIMIT = ROBOT.drum_radius, ROBOT.torque_limit
EVERY = np.ones(N, dtype=bool)
Array = NDArray[np.float64]


class Formula:
    """One tick after another, of all axes at once."""

    def __init__(self) -> None:
        # Stated for the robot's default drum; it goes with the inertia.
        self.damping = SETTINGS.rate_damping * ROBOT.drum_inertia / ROBOT.drum.inertia
        self.last, self.slope, self.integral = np.full(N, np.nan), np.zeros(N), np.zeros(N)

    def expected(self, tension: Array, rate: Array, acceleration: Array) -> Array:
        """Friction, inertia and the losses of the gearbox, beside the tension."""
        friction = SETTINGS.friction
        way = np.tanh(rate * RADIUS / friction.slip)
        pull = RADIUS * tension
        needed = pull + way * (RADIUS * friction.coulomb + friction.load * pull)
        needed += ROBOT.viscous_friction * rate + ROBOT.drum_inertia * acceleration
        efficiency = ROBOT.gearbox_efficiency
        through = np.where(way < 0.0, efficiency, 1.0 / efficiency)
        return needed * (1.0 + np.abs(way) * (through - 1.0)) - pull

    def torque(
        self,
        reference: Array,
        measured: Array,
        wanted_rate: Array,
        rate: Array,
        usable: NDArray[np.bool_],
        lengths: Array,
        desired: tuple[Array, Array],
    ) -> Array:
        follow = 1.0 - math.exp(-2.0 * math.pi * SETTINGS.lead_cutoff_hz * PERIOD)
        fastest = SETTINGS.lead_rate * PERIOD
        moved = reference - self.last
        self.last = reference.copy()
        known = np.isfinite(moved)
        toward = np.clip(np.where(known, moved, 0.0), -fastest, fastest)
        self.slope = np.where(known, self.slope + follow * (toward - self.slope), self.slope)
        error = reference - measured
        grown = self.integral + np.where(
            np.isfinite(error), SETTINGS.integral * PERIOD * error, 0.0
        )
        self.integral = np.clip(grown, -SETTINGS.integral_limit, SETTINGS.integral_limit)
        self.slope, self.integral = self.slope * usable, self.integral * usable
        force = SETTINGS.feed_forward * reference + SETTINGS.proportional * error + self.integral
        turn = SETTINGS.lead / (ROBOT.axial_stiffness * RADIUS * PERIOD)
        ahead = turn * lengths * self.slope
        wanted = RADIUS * force + self.damping * (wanted_rate + ahead - rate)
        wanted = wanted + SETTINGS.feed_forward * self.expected(reference, *desired)
        found = np.where(np.isfinite(wanted), np.clip(wanted, -LIMIT, LIMIT), 0.0)
        return np.where(usable, found, 0.0)


@pytest.mark.parametrize("seed", range(4))
def test_every_term_of_the_loop(seed: int) -> None:
    """Small and large inputs, some of them no numbers, some cables not usable, jumps."""
    random = np.random.default_rng(seed)
    loop, formula = TensionLoop(ROBOT, SETTINGS, PERIOD), Formula()
    lengths, off = random.uniform(0.5, 2.0, N), random.uniform(-40.0, 40.0, N)
    bounded = 0
    for tick in range(120):
        scale = 10.0 ** random.integers(-2, 4)
        reference = 60.0 + random.normal(0.0, min(scale, 30.0), N)
        measured = reference + random.normal(off, 3.0)
        rate, wanted = random.normal(0.0, scale, (2, N))
        desired = random.normal(0.0, 1.0, N), random.normal(0.0, scale, N)
        usable = random.random(N) > 0.1
        if tick % 7 == 3:
            for values in (reference, measured, rate):
                values[random.integers(N)] = random.choice([np.nan, np.inf])
        given = (reference, measured, wanted, rate, usable, lengths, desired)
        with np.errstate(invalid="ignore"):
            torque = formula.torque(*given)
        assert loop(*given) == pytest.approx(torque, rel=1e-9, abs=1e-9)
        assert loop.integral == pytest.approx(formula.integral, rel=1e-9, abs=1e-12)
        bounded += (abs(formula.integral) == SETTINGS.integral_limit).sum()
    assert loop.damping == pytest.approx(formula.damping)
    assert bounded > 100


def test_without_a_desired_motion_the_drums_are_taken_to_stand() -> None:
    loop, formula = TensionLoop(ROBOT, SETTINGS, PERIOD), Formula()
    still, reference = np.zeros(N), np.linspace(20.0, 90.0, N)
    given = (reference, reference + 1.0, still, still, EVERY, np.ones(N))
    assert loop(*given) == pytest.approx(formula.torque(*given, (still, still)))


def test_a_reset_forgets_integral_and_slope() -> None:
    loop, formula = TensionLoop(ROBOT, SETTINGS, PERIOD), Formula()
    still = np.zeros(N)
    for reference in (40.0, 80.0, 60.0):
        loop(np.full(N, reference), np.full(N, 30.0), still, still, EVERY, np.ones(N))
    assert loop.integral.all()
    before = loop.integral.copy()
    other = TensionLoop(ROBOT, SETTINGS, PERIOD)
    other.take_over(loop)
    assert other.integral.tolist() == before.tolist()
    without = TensionLoop(ROBOT, SETTINGS.model_copy(update={"integral": 0.0}), PERIOD)
    without.take_over(loop)
    assert not without.integral.any()
    loop.reset()
    assert not loop.integral.any()
    given = (np.full(N, 50.0), np.full(N, 45.0), still, still, EVERY, np.ones(N))
    assert loop(*given) == pytest.approx(formula.torque(*given, (still, still)))


def test_a_loop_that_takes_over_knows_of_the_other_its_integral_alone() -> None:
    """Its own references of before are forgotten; any integral gain goes on."""
    still, length = np.zeros(N), np.ones(N)
    low = SETTINGS.model_copy(update={"integral": 0.5})
    before, after, formula = (
        TensionLoop(ROBOT, SETTINGS, PERIOD),
        TensionLoop(ROBOT, low, PERIOD),
        Formula(),
    )
    for reference in (40.0, 80.0, 60.0):
        before(np.full(N, reference), np.full(N, 30.0), still, still, EVERY, length)
        after(np.full(N, 2.0 * reference), np.full(N, 30.0), still, still, EVERY, length)
    after.take_over(before)
    assert after.integral.tolist() == before.integral.tolist()
    assert before.integral.all()
    # At the same tension the integral does not change, whatever its gain.
    formula.integral = before.integral.copy()
    given = (np.full(N, 50.0), np.full(N, 50.0), still, still, EVERY, length)
    assert after(*given) == pytest.approx(formula.torque(*given, (still, still)))


# --- the drums' motion ---------------------------------------------------------------------------


class Motion:
    def __init__(self, seed: int = 0) -> None:
        random = np.random.default_rng(seed)
        self.matrix = random.normal(0.0, 1.0, (6, N))
        self.wrench = random.normal(0.0, 10.0, 6)
        self.tension = random.uniform(10.0, 200.0, N)
        self.twist = (random.normal(0.0, 1.0, 3), random.normal(0.0, 1.0, 3))
        self.desired = tuple(random.normal(0.0, 1.0, (4, 3)))
        self.found = np.zeros((3, N))

    def __call__(self) -> bool:
        finite = drum_motion(
            self.matrix,
            self.wrench,
            self.tension,
            self.twist,
            self.desired,  # type: ignore[arg-type]
            RADIUS,
            ROBOT.axial_stiffness,
            *self.found,
        )
        return bool(finite)


@pytest.mark.parametrize("seed", range(3))
def test_the_motion_of_the_drums(seed: int) -> None:
    motion = Motion(seed)
    assert motion()
    velocity, acceleration, turning, twisting = motion.desired
    forces, moments = motion.matrix[:3].T, motion.matrix[3:].T
    following = forces @ motion.twist[0] + moments @ motion.twist[1]
    following /= RADIUS * (1.0 + motion.tension / ROBOT.axial_stiffness)
    assert motion.found[0] == pytest.approx(following)
    assert motion.found[1] == pytest.approx((forces @ velocity + moments @ turning) / RADIUS)
    assert motion.found[2] == pytest.approx((forces @ acceleration + moments @ twisting) / RADIUS)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_any_value_that_is_no_number_is_told(bad: float) -> None:
    """Wrench, twist and desired velocities; an acceleration only leads."""
    for row in range(6):
        motion = Motion()
        motion.wrench[row] = bad
        assert not motion()
    for row in range(3):
        for part in range(2):
            motion = Motion()
            motion.twist[part][row] = bad
            assert not motion()
        for part, finite in ((0, False), (1, True), (2, False), (3, True)):
            motion = Motion()
            motion.desired[part][row] = bad
            assert motion() is finite
    for cable in (0, N - 1):
        motion = Motion()
        motion.tension[cable] = np.nan
        assert not motion()
