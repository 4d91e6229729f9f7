"""What a rising stiffness costs and what fills the tank, tick by tick and by hand."""

from __future__ import annotations

import math
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tonus.config import load
from tonus.runtime.control.passivity import Account, Limiter, Tank, damping, felt_inertia

CONFIG, _ = load("config/can.yaml")
CONTROL, ROBOT = CONFIG.control, CONFIG.robot
LAW = CONTROL.stiffness
PERIOD = CONTROL.rates.period
PASSIVITY = CONTROL.passivity.model_copy(
    update={
        "tank_initial": 1.0,
        "tank_minimum": 0.2,
        "tank_capacity": 2.0,
        "tank_efficiency": 0.5,
    }
)
RATIO = 0.7
MASS = ROBOT.platform.mass
HUGE = 1e12
NONE = np.zeros(3)
Array = NDArray[np.float64]


@pytest.fixture
def limiter() -> Limiter:
    return Limiter(LAW, PASSIVITY, ROBOT, RATIO, PERIOD)


def follow(
    limiter: Limiter, wanted: float, error: Array = NONE, cap: float = HUGE, ticks: int = 1
) -> float:
    for _ in range(ticks):
        value = limiter(wanted, cap, error, NONE, NONE)
    return value


def test_the_tank_keeps_a_share_of_what_comes_up_to_its_capacity() -> None:
    tank = Tank(PASSIVITY)
    tank.fill(0.6)
    assert tank.level == pytest.approx(1.3)
    for bad in (math.nan, math.inf, -math.inf):
        tank.fill(bad)
    assert tank.level == pytest.approx(1.3)
    tank.fill(9.0)
    assert tank.level == 2.0
    tank.reset()
    assert tank.level == 1.0


def test_the_tank_pays_for_a_rise_down_to_its_minimum() -> None:
    """Half the rise times the square of the stretch; a tenth of a metre: 0.8 J are 160 N/m."""
    tank = Tank(PASSIVITY)
    assert tank.admit(500.0, 600.0, 0.01) == 600.0
    assert tank.level == pytest.approx(0.5)
    assert tank.admit(600.0, 660.0, 0.01) == pytest.approx(660.0), "all there is"
    assert tank.level == pytest.approx(0.2)
    assert tank.admit(660.0, 700.0, 0.01) == pytest.approx(660.0)
    assert tank.level == pytest.approx(0.2)
    tank.reset()
    assert tank.admit(500.0, 1000.0, 0.01) == pytest.approx(660.0)
    assert tank.level == pytest.approx(0.2)


def test_a_tank_at_its_minimum_admits_a_rise_that_costs_nothing() -> None:
    """Without a stretch; with one, none of it."""
    tank = Tank(PASSIVITY.model_copy(update={"tank_initial": 0.2}))
    assert tank.admit(500.0, 600.0, 0.0) == 600.0
    assert tank.admit(500.0, 600.0, 0.01) == 500.0
    assert tank.level == 0.2


@pytest.mark.parametrize("share", [1.0, 1e-6])
def test_the_felt_inertia_is_the_largest_of_home_and_the_corners(share: float) -> None:
    """Of level poses: the square of the largest singular value of the cables' directions, each
    times the root of its drum's mass. With drums of some grams too."""
    masses = share * np.linspace(3.0, 20.0, ROBOT.cables)
    robot: Any = SimpleNamespace(
        geometry=ROBOT.geometry,
        workspace=ROBOT.workspace,
        home=(0.05, -0.1, 0.02),
        drum_mass=masses,
        platform=ROBOT.platform,
    )
    frame, platform = np.array(ROBOT.geometry.frame), np.array(ROBOT.geometry.platform)
    box, largest = ROBOT.workspace, []
    for place in (robot.home, *product(box.x, box.y, box.z)):
        way = frame - (np.array(place) + platform)
        directions = way / np.linalg.norm(way, axis=1)[:, None]
        pulled = np.sqrt(masses)[:, None] * directions
        largest.append(float(np.linalg.svd(pulled, compute_uv=False)[0]) ** 2)
    assert felt_inertia(robot) == pytest.approx(MASS + max(largest), rel=1e-12)
    robot.workspace = SimpleNamespace(x=(robot.home[0],), y=(robot.home[1],), z=(robot.home[2],))
    assert felt_inertia(robot) == pytest.approx(MASS + largest[0], rel=1e-12)


def test_a_reset_fills_the_tank_as_at_the_beginning(limiter: Limiter) -> None:
    follow(limiter, HUGE, np.array([0.0, 2.0, 0.0]))
    assert limiter.tank.level == pytest.approx(0.2)
    limiter.reset()
    assert limiter.tank.level == 1.0


def test_before_the_first_tick_there_is_no_energy_and_no_power(limiter: Limiter) -> None:
    for account in (limiter.account, Account()):
        assert (account.storage, account.stiffening, account.dissipated) == (0.0, 0.0, 0.0)
        assert (account.external, account.stiffness_rate, account.storage_rate) == (0.0, 0.0, 0.0)


def test_what_is_asked_for_stays_within_the_bounds(limiter: Limiter) -> None:
    """The least of wanted, cap and maximum; what is no number is the minimum."""
    assert limiter.value == LAW.minimum
    assert follow(limiter, HUGE, ticks=3000) == LAW.maximum
    assert follow(limiter, HUGE, cap=1000.0) == 1000.0
    assert follow(limiter, 900.0, cap=1000.0) == 900.0
    assert follow(limiter, math.nan) == LAW.minimum
    follow(limiter, HUGE, ticks=3000)
    assert follow(limiter, 0.0) == LAW.minimum
    assert follow(limiter, LAW.minimum) == LAW.minimum


def test_a_rise_is_no_faster_than_its_bound(limiter: Limiter) -> None:
    before = limiter.value
    value = follow(limiter, HUGE)
    alpha = damping(RATIO, LAW.minimum, MASS) / felt_inertia(ROBOT)
    spread = alpha * RATIO * math.sqrt(MASS / before)
    bound = min(2.0 * alpha * before / (1.0 + spread), LAW.rise_rate)
    assert limiter.rise_bound(before) == pytest.approx(bound)
    assert value == pytest.approx(before + PERIOD * bound)
    assert follow(limiter, value + 0.001) == pytest.approx(value + 0.001), "less is as asked for"


def test_the_rate_that_is_configured_bounds_it_too() -> None:
    law = LAW.model_copy(update={"rise_rate": 100.0})
    limiter = Limiter(law, PASSIVITY, ROBOT, RATIO, PERIOD)
    assert limiter.rise_bound(3000.0) == 100.0


def test_what_the_damper_took_fills_the_tank_from_the_second_tick_on(limiter: Limiter) -> None:
    """D |step|^2 / period, at the stiffness of before."""
    minimum = LAW.minimum
    follow(limiter, minimum, np.array([0.5, 0.0, 0.0]))
    assert limiter.tank.level == 1.0
    follow(limiter, minimum, np.array([0.501, 0.002, 0.002]))
    taken = damping(RATIO, minimum, MASS) * 9e-6 / PERIOD
    assert limiter.tank.level == pytest.approx(1.0 + 0.5 * taken)
    follow(limiter, minimum, np.array([0.501, 0.002, 0.002]))
    assert limiter.tank.level == pytest.approx(1.0 + 0.5 * taken)


def test_a_falling_stiffness_gives_back_what_it_stored(limiter: Limiter) -> None:
    follow(limiter, HUGE, ticks=300)
    limiter.tank.reset()
    before = limiter.value
    error = np.array([0.01, 0.02, 0.02])
    limiter.reset()
    assert limiter.value == LAW.minimum
    follow(limiter, HUGE, ticks=300)
    assert limiter.value == before
    level = limiter.tank.level
    follow(limiter, before, error)
    level += 0.5 * damping(RATIO, before, MASS) * 9e-4 / PERIOD
    level = min(level, PASSIVITY.tank_capacity)
    assert limiter.tank.level == pytest.approx(level)
    limiter.tank.reset()
    follow(limiter, before - 100.0, error)
    assert limiter.value == before - 100.0
    assert limiter.tank.level == pytest.approx(1.0 + 0.5 * 0.5 * 100.0 * 9e-4)


def test_a_stretched_spring_rises_as_far_as_the_tank_pays(limiter: Limiter) -> None:
    """2 m: 0.8 J are 0.4 N/m, and then nothing."""
    error = np.array([0.0, 2.0, 0.0])
    assert follow(limiter, HUGE, error) == pytest.approx(LAW.minimum + 0.4)
    assert follow(limiter, HUGE, error) == pytest.approx(LAW.minimum + 0.4)
    assert limiter.tank.level == pytest.approx(0.2)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_an_error_that_is_no_number_lets_it_fall_only(limiter: Limiter, bad: float) -> None:
    follow(limiter, HUGE, ticks=20)
    before, level = limiter.value, limiter.tank.level
    error = np.array([0.0, bad, 0.0])
    assert follow(limiter, HUGE, error) == before
    assert follow(limiter, HUGE, np.array([0.3, 0.0, 0.0])) >= before
    assert limiter.tank.level <= level, "a step from what was no number fills nothing"
    assert follow(limiter, before - 10.0, error) == before - 10.0


def test_the_account_of_a_tick(limiter: Limiter) -> None:
    error, rate = np.array([0.001, 0.002, -0.002]), np.array([0.1, -0.2, 0.2])
    force = np.array([3.0, 1.0, -2.0])
    limiter(LAW.minimum, HUGE, error, rate, force)
    account = limiter.account
    assert account.stiffness_rate == 0.0
    assert account.storage == pytest.approx(0.5 * (MASS * 0.09 + LAW.minimum * 9e-6))
    assert account.stiffening == 0.0
    assert account.dissipated == pytest.approx(damping(RATIO, LAW.minimum, MASS) * 0.09)
    assert account.external == pytest.approx(0.3)
    before = limiter.value
    value = limiter(HUGE, HUGE, error, rate, force)
    assert account.stiffness_rate == pytest.approx((value - before) / PERIOD)
    assert account.stiffening == pytest.approx(0.5 * (value - before) / PERIOD * 9e-6)
    assert account.dissipated == pytest.approx(damping(RATIO, before, MASS) * 0.09)
    assert account.storage == pytest.approx(0.5 * (MASS * 0.09 + value * 9e-6))
    wanted = account.stiffening - account.dissipated + 0.3
    assert account.storage_rate == pytest.approx(wanted)
