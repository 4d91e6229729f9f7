"""What a descent asks its cables and drums for, by hand and against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import nnls

from tonus.config import load
from tonus.runtime.control.controllers import CONTROLLERS, Motion
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.safety.descent import Descent
from tonus.runtime.safety.faults import Faults
from tonus.runtime.states import Fault

CONFIG, _ = load("config/can.yaml")
ROBOT = CONFIG.robot
FREE, MOST = 10.0, 40.0
LANDED = CONFIG.control.stop.landed
HIGH = LANDED + 1e-3
CONTROL = CONFIG.control.model_copy(
    update={"stop": CONFIG.control.stop.model_copy(update={"load_free": FREE, "load_most": MOST})}
)
Array = NDArray[np.float64]


@pytest.fixture
def matrix() -> Array:
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(np.array([0.05, -0.02, 0.04]), np.array([1.0, 0.0, 0.0, 0.0]))
    return kinematics.matrix


@pytest.fixture
def descent() -> Descent:
    return Descent(ROBOT, CONTROL, 0.001)


def faults(*found: tuple[Fault, int]) -> Faults:
    said = Faults(ROBOT)
    for fault, where in found:
        said.add(fault, where)
    return said


@pytest.mark.parametrize(("size", "held"), [(9.0, 0.0), (10.0, 0.0), (25.0, 15.0), (80.0, 40.0)])
def test_a_load_is_balanced_beyond_the_errors_of_the_estimate_and_not_without_bound(
    descent: Descent, matrix: Array, size: float, held: float
) -> None:
    along = np.array([2.0, -1.0, 2.0]) / 3.0
    balanced = descent.balanced(matrix, size * along, faults(), HIGH)
    assert balanced == pytest.approx(held * along)


def test_what_holds_a_platform_that_has_landed_is_the_cradle(
    descent: Descent, matrix: Array
) -> None:
    support = np.array([0.0, 0.0, 25.0])
    assert descent.balanced(matrix, support, faults(), LANDED) == pytest.approx(np.zeros(3))
    assert descent.balanced(matrix, support, faults(), HIGH) == pytest.approx(0.6 * support)


def test_what_given_up_cables_without_a_cell_may_pull_is_no_load(
    descent: Descent, matrix: Array
) -> None:
    """Their drums may be held by the drives, and the platform swings on them."""
    pull = matrix[:3, 2] * 30.0 + matrix[:3, 3] * 45.0
    lost = faults((Fault.DRIVE_LOST, 2), (Fault.CELL_LOST, 2), (Fault.CELL_BAD, 3))
    assert descent.balanced(matrix, pull, lost, HIGH) == pytest.approx(np.zeros(3), abs=0.1)
    assert np.linalg.norm(descent.balanced(matrix, pull, faults(), HIGH)) > 30.0
    one = faults((Fault.CELL_LOST, 2))
    assert np.linalg.norm(descent.balanced(matrix, pull, one, HIGH)) > 10.0


def test_no_cable_pushes(descent: Descent, matrix: Array) -> None:
    away = -40.0 * matrix[:3, 2]
    balanced = descent.balanced(matrix, away, faults((Fault.CELL_LOST, 2)), HIGH)
    assert balanced == pytest.approx(0.75 * away)


@pytest.mark.parametrize(
    "found",
    [
        pytest.param(((Fault.DRUM_TORQUE, 2),), id="its cell says what it pulls"),
        pytest.param(((Fault.CELL_LOST, 2), (Fault.CABLE_TORN, 2)), id="it is torn"),
    ],
)
def test_a_cable_of_which_that_is_known_explains_nothing(
    descent: Descent, matrix: Array, found: tuple[tuple[Fault, int], ...]
) -> None:
    pull = 40.0 * matrix[:3, 2]
    assert descent.balanced(matrix, pull, faults(*found), HIGH) == pytest.approx(0.75 * pull)


def test_any_load_and_cables_as_scipy_has_it(descent: Descent, matrix: Array) -> None:
    """Pairs whose lines are 30 degrees apart; two opposite cables explain less here, since only
    tensions that no drum has would explain more."""
    random, tried = np.random.default_rng(15), 0
    while tried < 50:
        cables = random.choice(ROBOT.cables, 2, replace=False)
        load = random.normal(size=3) * 40.0
        columns = matrix[:3, cables]
        if abs(columns[:, 0] @ columns[:, 1]) > np.cos(np.pi / 6.0):
            continue
        tried += 1
        rest = load - columns @ nnls(columns, load)[0]
        size = float(np.linalg.norm(rest))
        held = min(max(size - FREE, 0.0), MOST) / max(size, FREE)
        found = faults(*((Fault.CELL_LOST, int(cable)) for cable in cables))
        assert descent.balanced(matrix, load, found, HIGH) == pytest.approx(held * rest, abs=0.6)


def test_after_the_throw_the_loop_is_as_elsewhere(descent: Descent) -> None:
    """With a third of its gain; a cable that is lost in a later stop throws the platform again."""
    stop = CONTROL.stop
    planned, tension = np.full(ROBOT.cables, 20.0), np.full(ROBOT.cables, 26.0)
    for cable in (3, 0):
        failed = np.arange(ROBOT.cables) == cable
        assert descent.felt(planned, tension, failed) == pytest.approx(np.full(8, 26.0), abs=0.05)
        for _ in range(round(stop.throw_s / 0.001)):
            felt = descent.felt(planned, tension, failed)
        assert felt == pytest.approx(np.full(8, 26.0), abs=0.1)
        for _ in range(round(stop.ease_s / 0.001)):
            felt = descent.felt(planned, tension, failed)
        assert felt == pytest.approx(np.full(8, 22.0 + 4.0 / np.e), abs=0.1)
        for _ in range(1000):
            felt = descent.felt(planned, tension, failed)
        assert felt == pytest.approx(
            np.full(8, 20.0 + 6.0 * stop.calm / stop.proportional), abs=0.01
        )


@pytest.mark.parametrize("after_s", [0.0, 0.1, 1.0])
def test_with_two_cables_lost_the_loop_is_as_elsewhere_at_once(
    descent: Descent, after_s: float
) -> None:
    """Six cables do not hold the platform's turn: drums that yield would let it go on."""
    planned, tension = np.full(ROBOT.cables, 20.0), np.full(ROBOT.cables, 26.0)
    for _ in range(round(after_s / 0.001)):
        descent.felt(planned, tension, np.arange(ROBOT.cables) < 1)
    calm = np.full(8, 20.0 + 6.0 * CONTROL.stop.calm / CONTROL.stop.proportional)
    for _ in range(3):
        felt = descent.felt(planned, tension, np.arange(ROBOT.cables) < 2)
        assert felt == pytest.approx(calm, abs=1e-9)
    descent.begin(tension)
    one = descent.felt(planned, tension, np.arange(ROBOT.cables) < 1)
    assert one == pytest.approx(tension, abs=0.05)


def paid_out(descent: Descent, matrix: Array, found: Faults, following: float) -> Array:
    """Torques that a descent adds to none, for drums at rest whose platform wants them to follow;
    all cables but the first pull, cable 1 no more than the others are asked for."""
    tension, usable = np.full(8, 45.0), np.arange(8) > 0
    tension[1] = 3.0
    pulls = descent.pulling(tension, found)
    planned = descent.plan(matrix, np.zeros(6), np.full(8, 20.0), pulls, usable, found)
    assert planned[1:].max() < 45.0
    assert planned[1] > 3.0
    descent.felt(planned, tension, np.arange(8) < 1)
    torque, desired, nobody = np.zeros(8), np.full(8, -0.5), np.zeros(8, dtype=bool)
    follow = np.full(8, following)
    follow[2], desired[3] = 2.0, -3.0
    descent.bound(torque, np.zeros(8), follow, desired, usable, nobody)
    return torque


def test_while_a_torn_cable_throws_the_platform_drums_pay_out_what_it_takes(
    descent: Descent, matrix: Array
) -> None:
    """Damping their own rates they would pull on. A cable that is asked for more, comes nearer, or
    goes along the path as fast, is as before."""
    torn = faults((Fault.CABLE_TORN, 0))
    paid = -1.5 * descent.loop.damping
    paid[:4] = 0.0
    assert paid_out(descent, matrix, torn, -2.0) == pytest.approx(paid)
    for _ in range(round(CONTROL.stop.pay_out_s / 0.001)):
        descent.felt(np.full(8, 20.0), np.full(8, 26.0), np.arange(8) < 1)
    assert not paid_out(descent, matrix, torn, -2.0).any()


def test_rates_that_are_no_numbers_or_with_no_cable_torn_pay_nothing_out(
    descent: Descent, matrix: Array
) -> None:
    assert not paid_out(descent, matrix, faults((Fault.CABLE_TORN, 0)), np.nan).any()
    descent.begin(np.full(8, 45.0))
    assert not paid_out(descent, matrix, faults((Fault.LENGTH_JUMP, 0)), -2.0).any()


@pytest.mark.parametrize("angle", [0.02, 0.5, 2.0])
def test_a_descent_asks_for_no_faster_way_back_to_level_than_cables_can_give(angle: float) -> None:
    """A spring alone asks for 60 N m/rad. Its damper is not bounded."""
    impedance, stop = CONTROL.impedance, CONTROL.stop
    axis, still, turning = np.array([2.0, -1.0, 2.0]) / 3.0, np.zeros(3), np.array([3.0, 9.0, -5.0])
    askew = np.array([np.cos(0.5 * angle), *(np.sin(0.5 * angle) * axis)])
    motion = Motion(
        still, still, still, still, askew, still, turning, still, 0.0, still, still, still, still
    )
    wrench = CONTROLLERS["bio"](ROBOT, CONTROL).descent(motion)
    size = min(
        impedance.rotational_stiffness * angle, impedance.rotational_damping * stop.level_speed
    )
    damped = impedance.rotational_damping * turning
    assert wrench[3:] == pytest.approx(-size * axis - damped)
    assert wrench[:3] == pytest.approx([0.0, 0.0, ROBOT.platform.mass * ROBOT.gravity])


def test_the_drum_of_a_given_up_cable_damps_if_it_can_and_follows_a_slack_one(
    descent: Descent, matrix: Array
) -> None:
    """Without a torque the cable would go slack, and snap taut under a heavy drum."""
    stop, found = CONTROL.stop, faults((Fault.LENGTH_DRIFT, 2), (Fault.LENGTH_JUMP, 5))
    assert np.flatnonzero(found.damping).tolist() == [2, 5]
    carrying, tension = ~found.failed, np.full(ROBOT.cables, 20.0)
    descent.pulling(tension, faults())
    tension[5] = 0.0
    pulls = descent.pulling(tension, found)
    descent.plan(matrix, np.zeros(6), np.full(8, 20.0), pulls, carrying, found)
    torque, rate, following = np.zeros(8), np.full(8, 1.0), np.full(8, 2.0)
    descent.bound(torque, rate, following, np.zeros(8), carrying, found.damping)
    radius = ROBOT.drum_radius[2]
    assert stop.passive_damping_in is not None
    damped = radius * (stop.passive_tension - stop.passive_damping_in * radius)
    assert torque[2] == pytest.approx(damped)
    closing = stop.take_up_damping * (stop.take_up_speed + radius)
    assert torque[5] == pytest.approx(radius * closing)
    assert not torque[carrying].any()


def test_what_a_drum_that_damps_pulls_is_believed_up_to_its_own_tension(descent: Descent) -> None:
    found, tension = faults((Fault.LENGTH_DRIFT, 2)), np.full(ROBOT.cables, 40.0)
    descent.pulling(tension, faults())
    for _ in range(1000):
        pulls = descent.pulling(tension, found)
    assert pulls[2] == pytest.approx(CONTROL.stop.passive_tension, rel=1e-6)
    assert np.delete(pulls, 2) == pytest.approx(np.full(7, 40.0))
    tension[2] = 5.0
    assert descent.pulling(tension, found)[2] == 5.0
