"""The cradle: a level table with friction, and cups that centre what lands in them."""

from __future__ import annotations

import numpy as np
import pytest
from plant_setup import LAB, ROBOT, TICK_NS, plant, run

from tonus.config.schema.lab import Load
from tonus.sim.plant import Plant

WEIGHT = ROBOT.platform.mass * ROBOT.gravity
REST = np.array(ROBOT.rest)
TABLE = REST[2] + LAB.cradle.depth
"""m: height of a platform that lies flat on the table, outside the cups"""
SUBSTEP_NS = LAB.plant.substep_us * 1000


def loose(position: tuple[float, float, float], load: Load | None = None) -> Plant:
    """A platform on no cable."""
    p = plant(load=load)
    p.place(position, (1.0, 0.0, 0.0, 0.0), np.zeros(8))
    p.parameters["start_length"] += 10.0
    return p


def test_at_rest_it_lies_still_where_the_robot_says() -> None:
    p = plant()
    run(p, 0.5)
    assert p.position == pytest.approx(REST, abs=1e-12)
    assert p.losses == pytest.approx(0.0, abs=1e-12)


def test_it_catches_and_never_pulls() -> None:
    p = loose((0.0, 0.0, 0.0))
    run(p, 3.0)
    assert p.position == pytest.approx(REST, abs=1e-5)
    p.velocity[2] = 1.0
    run(p, 0.05)
    assert p.velocity[2] == pytest.approx(1.0 - ROBOT.gravity * 0.05, abs=0.06)


@pytest.mark.parametrize("aside", [0.004, 0.007])
def test_what_lands_in_the_cups_slides_to_their_middle(aside: float) -> None:
    p = loose((aside, -0.3 * aside, REST[2] + 0.02))
    run(p, 2.0)
    slope = 4.0 * LAB.cradle.depth / LAB.cradle.radius**2
    assert np.hypot(*p.position[:2]) < 1.1 * LAB.cradle.friction / slope
    assert p.energy().kinetic < 1e-9


@pytest.mark.parametrize("aside", [(0.012, 0.0), (-0.05, 0.08), (0.0, 0.4)])
def test_what_lands_beside_them_stays_where_it_touched(aside: tuple[float, float]) -> None:
    """Before, the middle pulled at it with 20 N per millimetre."""
    p = loose((*aside, REST[2] + 0.02))
    start = p.energy().total
    run(p, 1.0)
    assert p.position == pytest.approx([*aside, TABLE], abs=1e-5)
    assert p.energy().total < start
    assert p.energy().kinetic < 1e-9


def test_it_slides_as_far_as_friction_lets_it() -> None:
    """v^2 / (2 mu g) on a level table, rotation left to itself; and it stops level."""
    p = loose((0.1, 0.0, TABLE))
    run(p, 0.2)
    p.velocity[0] = 1.0
    p.advance(p.now_ns + 1)
    start = p.energy()
    run(p, 1.0)
    way = 1.0 / (2.0 * LAB.cradle.friction * ROBOT.gravity)
    assert p.position[0] - 0.1 == pytest.approx(way, rel=0.01)
    assert p.position[1:] == pytest.approx([0.0, TABLE], abs=1e-4)
    end = p.energy()
    assert end.losses - start.losses == pytest.approx(0.5 * ROBOT.platform.mass, rel=0.01)
    assert abs(end.balance - start.balance) < 1e-3


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_it_holds_up_to_its_limit(share: float) -> None:
    """A push at the height of the table, by so much of what friction holds."""
    push = Load.model_validate(
        {
            "direction": (1.0, 0.0, 0.0),
            "point": (0.0, 0.0, min(tip[2] for tip in ROBOT.geometry.platform)),
            "profile": [
                {"at": 0.0, "force": 0.0},
                {"at": 0.1, "force": share * LAB.cradle.friction * WEIGHT},
            ],
        }
    )
    p = loose((0.1, 0.0, TABLE), load=push)
    run(p, 0.2)
    p.start_schedule(p.now_ns)
    run(p, 1.0)
    assert bool(p.position[0] - 0.1 > 0.05) is (share > 1.0)


def test_turning_on_the_table_ends_by_friction() -> None:
    p = loose((0.1, 0.0, TABLE))
    run(p, 0.2)
    p.angular_velocity[2] = 4.0
    p.advance(p.now_ns + 1)
    start = p.energy()
    run(p, 1.0)
    end = p.energy()
    assert end.kinetic < 1e-9
    spun = 0.5 * ROBOT.platform.inertia[2] * 4.0**2
    assert end.losses - start.losses == pytest.approx(spun, rel=0.02)


def test_a_corner_that_lands_first_tips_the_platform_flat() -> None:
    p = loose((0.1, 0.0, REST[2] + 0.08))
    p.quaternion[:] = np.array([0.99, 0.1, 0.06, 0.0]) / np.linalg.norm([0.99, 0.1, 0.06, 0.0])
    run(p, 3.0)
    assert p.state["rotation"][0, 2, 2] == pytest.approx(1.0, abs=1e-6)
    assert p.position[2] == pytest.approx(TABLE, abs=1e-5)


def test_it_carries_a_platform_on_any_side() -> None:
    p = loose((0.0, 0.0, REST[2] + 0.3))
    p.quaternion[:] = (0.0, 1.0, 0.0, 0.0)
    run(p, 3.0)
    assert p.position[2] == pytest.approx(TABLE, abs=1e-3)


def test_no_step_of_a_landing_gives_energy_back() -> None:
    p = loose((0.006, 0.002, REST[2] + 0.01))
    p.velocity[:] = (2.0, -1.0, -2.0)
    p.angular_velocity[:] = (2.0, 1.0, -3.0)
    p.advance(p.now_ns + 1)
    start, last = p.energy().balance, float(p.losses)
    for _ in range(2 * TICK_NS // SUBSTEP_NS * 1000):
        p.advance(p.now_ns + SUBSTEP_NS)
        assert p.losses >= last
        last = float(p.losses)
    assert abs(p.energy().balance - start) < 2e-3 * last
    assert p.energy().kinetic < 1e-9
