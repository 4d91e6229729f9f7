"""Rate bound and energy tank, against figures worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tonus.config import load
from tonus.config.schema.control import Passivity
from tonus.runtime.control.passivity import Limiter, Tank, damping, felt_inertia

CONFIG, _ = load("config/can.yaml")
ROBOT, CONTROL = CONFIG.robot, CONFIG.control
LAW, TANK, RATIO = CONTROL.stiffness, CONTROL.passivity, CONTROL.impedance.damping_ratio
PERIOD = CONTROL.rates.period
ZERO = np.zeros(3)


def limiter(**changes: float) -> Limiter:
    return Limiter(LAW, TANK.model_copy(update=changes), ROBOT, RATIO, PERIOD)


def test_the_damper_is_two_zeta_root_k_m() -> None:
    assert damping(0.8, 3210.0, 2.35) == pytest.approx(138.97, abs=0.01)


def test_a_force_feels_the_drums_besides_the_platform() -> None:
    """Eight cables share their directions about evenly: 8/3 of J/r2 = 28 kg on each axis, and on
    the strongest axis of the worst corner less than all eight in line."""
    drum = ROBOT.drum.inertia / ROBOT.drum.radius**2
    found = felt_inertia(ROBOT) - ROBOT.platform.mass
    assert 8.0 / 3.0 * drum < found < 8.0 * drum


def test_the_rate_bound_is_that_of_kronander_and_billard() -> None:
    """At the bound K' + alpha D' = 2 alpha K, with D' by central difference."""
    found = limiter()
    softest = damping(RATIO, LAW.minimum, ROBOT.platform.mass)
    assert found.alpha == pytest.approx(softest / felt_inertia(ROBOT))
    for stiffness in np.linspace(LAW.minimum, LAW.maximum, 7):
        rise = found.rise_bound(stiffness)
        ahead, behind = (damping(RATIO, stiffness + d, ROBOT.platform.mass) for d in (0.5, -0.5))
        left = rise + found.alpha * (ahead - behind) * rise
        assert left == pytest.approx(2.0 * found.alpha * stiffness, rel=1e-6)


def test_the_shipped_rate_is_no_tighter_than_passivity_at_base() -> None:
    """Else 63 % of the rise would not come within the paper's 100 ms by the law's own means."""
    bound = limiter().rise_bound(LAW.base)
    assert bound < LAW.rise_rate
    assert 0.63 * LAW.force_gain * LAW.base / bound < 0.06


def test_it_climbs_at_its_bound_falls_at_once_and_the_cap_wins() -> None:
    found = limiter()
    assert found.value == LAW.minimum
    for _ in range(2000):
        before = found.value
        now = found(4000.0, LAW.maximum, ZERO, ZERO, ZERO)
        assert now <= before + found.rise_bound(before) * PERIOD
    assert now == 4000.0
    assert found(4000.0, 500.0, ZERO, ZERO, ZERO) == 500.0
    found.reset()
    assert (found.value, found.tank.level) == (LAW.minimum, TANK.tank_initial)


def test_a_stretched_spring_is_stiffened_only_as_far_as_the_tank_pays() -> None:
    """At e = 50 mm a spring that grows by dK stores 1/2 dK e2."""
    found, stretch = limiter(), np.array([0.03, 0.0, 0.04])
    for _ in range(3000):
        found(LAW.maximum, LAW.maximum, stretch, ZERO, ZERO)
    spent = TANK.tank_initial - TANK.tank_minimum
    assert found.value - LAW.minimum == pytest.approx(2.0 * spent / 0.05**2)
    assert found.tank.level == pytest.approx(TANK.tank_minimum)


def test_what_a_falling_stiffness_gives_back_may_be_spent_again_less_the_loss() -> None:
    found, stretch = limiter(tank_initial=0.1), np.array([0.02, 0.0, 0.0])
    for _ in range(3000):
        found(700.0, LAW.maximum, stretch, ZERO, ZERO)
    high = found.tank.level
    found(500.0, LAW.maximum, stretch, ZERO, ZERO)
    gained = 0.5 * 200.0 * 0.02**2 * TANK.tank_efficiency
    assert found.tank.level == pytest.approx(high + gained)


def test_the_tank_holds_no_more_than_its_capacity() -> None:
    tank = Tank(TANK)
    tank.fill(1e3)
    assert tank.level == TANK.tank_capacity


def test_the_account_is_equation_12_and_its_whole_derivative() -> None:
    found, error, rate = limiter(), np.array([0.01, 0.0, 0.0]), np.array([0.0, 0.1, 0.02])
    found(800.0, LAW.maximum, error, rate, ZERO)
    before = found.value
    force = np.array([3.0, -5.0, 1.0])
    found(800.0, LAW.maximum, error, rate, force)
    account, mass = found.account, ROBOT.platform.mass
    assert account.stiffness_rate == pytest.approx((found.value - before) / PERIOD)
    assert account.storage == pytest.approx(0.5 * mass * 0.0104 + 0.5 * found.value * 1e-4)
    assert account.stiffening == pytest.approx(0.5 * account.stiffness_rate * 1e-4)
    assert account.dissipated == pytest.approx(damping(RATIO, before, mass) * 0.0104)
    assert account.external == pytest.approx(0.48)
    total = account.stiffening - account.dissipated + account.external
    assert account.storage_rate == total


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e200])
def test_an_error_that_is_no_number_stiffens_nothing_and_leaves_the_tank_alone(bad: float) -> None:
    found = limiter()
    found(500.0, LAW.maximum, ZERO, ZERO, ZERO)
    before, level = found.value, found.tank.level
    found(4000.0, LAW.maximum, np.array([bad, 0.0, 0.0]), ZERO, ZERO)
    assert (found.value, found.tank.level) == (before, level)
    found(4000.0, LAW.maximum, ZERO, ZERO, ZERO)
    assert found.value > before
    assert found.tank.level == level


def test_schema_refuses_a_tank_that_starts_outside_itself() -> None:
    with pytest.raises(ValueError, match="tank_minimum <= tank_initial"):
        Passivity.model_validate(TANK.model_dump() | {"tank_initial": 5.0})
