"""The bounds of each drum in a stop, by hand: passive law, taking up slack, brake and tank."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tonus.config import load
from tonus.config.schema.safety import Stop
from tonus.runtime.safety.guard import Guard

CONFIG, _ = load("config/can.yaml")
ROBOT = CONFIG.robot
N = ROBOT.cables
RADIUS = ROBOT.drum_radius
PERIOD = 0.001
SETTINGS = CONFIG.control.stop.model_copy(
    update={
        "passive_tension": 30.0,
        "passive_damping": 100.0,
        "passive_damping_in": None,
        "passive_force": 80.0,
        "passive_speed": 0.4,
        "reel_in": 0.2,
        "reel_out": 0.3,
        "reel_damping": 500.0,
        "take_up_speed": 0.05,
        "take_up_damping": 200.0,
        "tank": 0.5,
    }
)
EVERY = np.ones(N, dtype=bool)
Array = NDArray[np.float64]


@pytest.fixture
def guard() -> Guard:
    return Guard(ROBOT, SETTINGS, PERIOD)


def each(*values: float) -> Array:
    """Of the first drums; 0 of the others."""
    return np.array([*values, *[0.0] * (N - len(values))])


def test_the_passive_law_of_each_drum(guard: Guard) -> None:
    """30 N less 100 N s/m times its speed, within 80 N to both sides; a rate that is no number, or
    of a drum that is not trusted, gives no torque."""
    speeds = each(0.1, -0.2, 2.0, -2.0, np.nan, np.inf, 0.1)
    trusted = np.arange(N) != 6
    torque = guard.passive(speeds / RADIUS, trusted)
    assert torque / RADIUS == pytest.approx([20.0, 50.0, -80.0, 80.0, 0.0, 0.0, 0.0, 30.0])
    again = guard.passive(np.zeros(N), ~trusted)
    assert again / RADIUS == pytest.approx([0.0] * 6 + [30.0, 0.0]), "nothing is left of before"


def test_a_drum_that_turns_faster_brakes() -> None:
    """With 500 N s/m beyond 0.4 m/s, to both sides."""
    strong = Guard(ROBOT, SETTINGS.model_copy(update={"passive_force": 300.0}), PERIOD)
    speeds = each(0.4, 0.5, -0.4, -0.5)
    torque = strong.passive(speeds / RADIUS, EVERY)
    assert torque[:4] / RADIUS[:4] == pytest.approx([-10.0, -60.0, 70.0, 120.0])


def test_a_drum_that_reels_in_is_damped_less() -> None:
    """With 20 N s/m, up to 0.4 m/s; with 500 N s/m beyond, as one that reels out with 100."""
    changes = {"passive_force": 300.0, "passive_damping_in": 20.0}
    soft = Guard(ROBOT, SETTINGS.model_copy(update=changes), PERIOD)
    torque = soft.passive(each(0.1, 0.4, 0.5, -0.1, -0.4, -0.5) / RADIUS, EVERY)
    assert torque[:6] / RADIUS[:6] == pytest.approx([28.0, 22.0, -28.0, 40.0, 70.0, 120.0])


def test_a_drum_that_reels_in_is_damped_more_by_no_configuration() -> None:
    """`tonus check` holds the larger damping against the delay."""
    damping = CONFIG.control.stop.passive_damping
    for inward in (damping, None):
        Stop.model_validate(CONFIG.control.stop.model_dump() | {"passive_damping_in": inward})
    more = CONFIG.control.stop.model_dump() | {"passive_damping_in": damping + 1.0}
    with pytest.raises(ValueError, match="passive_damping_in <= passive_damping"):
        Stop.model_validate(more)


def test_a_slack_cable_comes_in_at_the_speed_up_to_which_a_passive_stop_does_not_brake() -> None:
    """Against friction and bearings; a platform that sinks faster is braked by the other cables."""
    stop, lab = CONFIG.control.stop, CONFIG.lab
    assert lab is not None
    bearings = ROBOT.viscous_friction[0] / RADIUS[0] ** 2
    inward = stop.passive_damping_in
    assert inward is not None
    speed = (stop.passive_tension - lab.plant.coulomb_friction) / (inward + bearings)
    assert speed == pytest.approx(stop.passive_speed, rel=0.05)


def test_a_brake_that_is_weaker_than_the_damping_adds_nothing() -> None:
    strong = {"passive_force": 300.0, "reel_damping": 90.0}
    damped = Guard(ROBOT, SETTINGS.model_copy(update=strong), PERIOD)
    torque = damped.passive(each(1.0, -1.0) / RADIUS, EVERY)
    assert torque[:2] / RADIUS[:2] == pytest.approx([-70.0, 130.0])


def test_a_share_of_the_passive_tension(guard: Guard) -> None:
    """Of all drums, or of each; the damping stays."""
    rate = np.full(N, 0.1) / RADIUS
    assert guard.passive(rate, EVERY, 0.5) / RADIUS == pytest.approx(np.full(N, 5.0))
    share = np.linspace(0.0, 1.0, N)
    assert guard.passive(rate, EVERY, share) / RADIUS == pytest.approx(30.0 * share - 10.0)


def test_slack_is_taken_up_a_little_faster_than_the_platform_comes(guard: Guard) -> None:
    """Within 0.2 m/s to both sides; a taut cable keeps its torque."""
    torque = np.full(N, 7.0)
    following = each(0.1, 0.1, 3.0, -3.0, np.nan, 0.1, 0.0)
    rate = each(0.1, 0.3, 0.0, 0.0, 0.0, np.inf, 0.0)
    guard.take_up(torque, rate / RADIUS, following / RADIUS, np.arange(N) != 7)
    forces = [10.0, -30.0, 50.0, -30.0, 0.0, 0.0, 10.0]
    assert torque[:7] / RADIUS[:7] == pytest.approx(forces)
    assert torque[7] == 7.0


def bounded(guard: Guard, force: Array, speed: Array, usable: NDArray[np.bool_] = EVERY) -> Array:
    """N"""
    torque = force * RADIUS
    guard.bound(torque, speed / RADIUS, usable)
    return torque / RADIUS


def test_a_plan_within_the_bounds_is_kept(guard: Guard) -> None:
    force, speed = each(50.0, 50.0, 40.0, -20.0), each(0.1, -0.1, 0.0, -0.2)
    assert bounded(guard, force, speed) == pytest.approx(force)


def test_a_drum_that_turns_too_fast_is_braked(guard: Guard) -> None:
    """At 0.2 m/s in it gets T_0 at most, at 0.3 m/s out nothing at least; 500 N s/m beyond."""
    guard.tank[:] = 0.0
    speed = each(0.2, 0.22, 0.3, -0.3, -0.35, -0.4)
    plan = each(100.0, 100.0, -40.0, -40.0, -40.0, 100.0)
    found = bounded(guard, plan, speed)
    assert found[:6] == pytest.approx([30.0, 20.0, -40.0, 0.0, 25.0, 100.0])


def test_no_torque_beyond_the_drives() -> None:
    guard = Guard(ROBOT, SETTINGS.model_copy(update={"reel_damping": 1e6}), PERIOD)
    most = ROBOT.torque_limit / RADIUS
    found = bounded(guard, each(1e4, -1e4, 1e4), each(0.0, 0.0, -0.1))
    assert found[:3] == pytest.approx([most[0], -most[1], most[2]])


def test_energy_beyond_the_passive_law_comes_from_the_tank(guard: Guard) -> None:
    """50 N above T_0 at 0.1 m/s for a millisecond are 5 mJ; what pulls against the motion fills it
    up to its capacity, whatever the force."""
    guard.tank[:] = 0.4
    force, speed = each(80.0, 80.0, 10.0, 10.0, 30.0, 80.0), each(0.1, -0.1, 0.1, -0.1, 0.1, 0.0)
    assert bounded(guard, force, speed) == pytest.approx(force)
    assert guard.tank[:6] == pytest.approx([0.395, 0.405, 0.402, 0.398, 0.4, 0.4])
    guard.tank[:] = 0.499
    bounded(guard, force, speed)
    assert guard.tank[1] == 0.5
    guard.tank[:] = 0.001
    bounded(guard, force, speed)
    assert guard.tank[3] == 0.0, "reeling out it is never below nothing"


def test_an_empty_tank_leaves_the_passive_tension(guard: Guard) -> None:
    """And what is in it is given to the last."""
    guard.tank[:] = [0.0, 0.002, 0.005, 0.0, *[0.5] * (N - 4)]
    found = bounded(guard, each(80.0, 80.0, 80.0, 10.0), each(0.1, 0.1, 0.1, -0.1))
    assert found[:4] == pytest.approx([30.0, 50.0, 80.0, 10.0])
    assert guard.tank[:4] == pytest.approx([0.0, 0.0, 0.0, 0.0], abs=1e-12)
    guard.reset()
    assert guard.tank.tolist() == [0.5] * N


def test_a_drum_that_is_not_usable_or_not_known(guard: Guard) -> None:
    """The one keeps what it has, the other gets nothing, and the drums after them their bounds."""
    usable = np.arange(N) != 0
    found = bounded(guard, each(1e4, 50.0, 1e4, 1e4), each(9.0, np.nan, 0.2, -np.inf), usable)
    assert found[:4] == pytest.approx([1e4, 0.0, 30.0, 0.0])
    assert guard.tank.tolist() == [0.5] * N


def test_the_tank_is_full_at_first(guard: Guard) -> None:
    assert guard.tank.tolist() == [0.5] * N
