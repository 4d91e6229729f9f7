"""The least stop's model against the plant, its optimum against laws, its mirror images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from plant_setup import CONFIG, LAB, ROBOT, UPRIGHT, balanced, frictionless, plant

pytest.importorskip("casadi", reason="the least stop is computed with the extra bench")

from tests.bench.least_stop.against_plant import speeds
from tests.bench.least_stop.begin import case_of, damping, played, standing, still
from tests.bench.least_stop.cases import Tear, solved_as
from tests.bench.least_stop.hold import POSITIONS, Hold
from tests.bench.least_stop.model import BODY, LEFT, Constants, Model
from tests.bench.least_stop.problem import Problem, Solution
from tonus.config.schema.lab import Lab
from tonus.config.schema.robot import Robot

pytestmark = pytest.mark.wide

TORN = 0
MODEL = Model(Constants.of(ROBOT, LAB))
PROBLEM = Problem(MODEL)


def held(position: tuple[float, float, float], robot: Robot = ROBOT, lab: Lab = LAB) -> Hold:
    p = plant(robot, lab)
    p.position[:] = position
    p.quaternion[:] = UPRIGHT
    return Hold(np.array(position), np.array(UPRIGHT), balanced(p))


def optimum(tear: Tear) -> Solution:
    case = case_of(MODEL, ROBOT.geometry, held(tear.position), tear.cable, np.zeros(3))
    begin = PROBLEM.unknowns(case, still(case))
    return PROBLEM.solve(case, begin, weights=(2.0, 0.0), speed_limit=5.0, tension_limit=200.0)


@pytest.fixture(scope="module")
def centre() -> Solution:
    return optimum(Tear(TORN, (0.0, 0.0, 0.0), "rest"))


@pytest.mark.parametrize("torn", [0, 4])
def test_the_model_moves_as_the_plant_does_without_friction(torn: int) -> None:
    robot = ROBOT.model_copy(
        update={"drum": ROBOT.drum.model_copy(update={"viscous_friction": 0.0})}
    )
    lab, hold = frictionless(), held((0.1, -0.05, 0.05))
    case = case_of(MODEL, robot.geometry, hold, torn, np.zeros(3))
    p = plant(robot, lab)
    p.place(hold.position, hold.quaternion, hold.tension)
    p.cut_cable(torn)
    p.advance(p.now_ns + 24_000_000)
    # A law of constant force: the nodes are 3 ms apart at first.
    state = played(MODEL, case, lambda x, pulls: case.force)[8]
    left = [i for i in range(LEFT + 1) if i != torn]
    reeling = p.drum_rate[left] * robot.drum.radius
    assert np.linalg.norm(p.velocity) > 0.2
    assert state[0:3] - hold.position == pytest.approx(p.position - hold.position, abs=4e-5)
    assert state[6:9] == pytest.approx(p.velocity, abs=4e-3)
    # A cable's damper loses share in the model as it goes slack: 0.2 N in 40 N.
    assert state[BODY + LEFT :] == pytest.approx(reeling, abs=2e-3)


def test_the_optimum_obeys_the_equations_and_ends_at_rest(centre: Solution) -> None:
    assert centre.converged
    assert np.linalg.norm(centre.late[-1, 6:9]) < 0.06
    assert np.abs(centre.forces).max() <= 1.05 * MODEL.constants.driving_force


def test_the_optimal_torques_do_in_the_plant_what_they_do_in_the_model(centre: Solution) -> None:
    hold = held((0.0, 0.0, 0.0))
    case = case_of(MODEL, ROBOT.geometry, hold, TORN, np.zeros(3))
    pulls = PROBLEM.tensions(0.5 * (centre.early[:-1] + centre.early[1:]), case)
    _, true, wanted = speeds(CONFIG, hold, TORN, np.zeros(3), case, centre, pulls)
    assert true.max() == pytest.approx(wanted.max(), rel=0.03)
    assert true == pytest.approx(wanted, abs=0.04 * wanted.max())


@pytest.mark.parametrize("law", [damping(12.0, 60.0), standing()], ids=["damping", "standing"])
def test_no_simple_law_beats_the_optimum(law, centre: Solution) -> None:
    case = case_of(MODEL, ROBOT.geometry, held((0.0, 0.0, 0.0)), TORN, np.zeros(3))
    early = played(MODEL, case, law)[: len(centre.early)]
    assert np.linalg.norm(early[:, 6:9], axis=1).max() > 1.2 * centre.peak_speed


def test_a_mirror_image_has_the_same_optimum() -> None:
    tear = Tear(2, (-0.1, 0.05, 0.1), "rest")
    image = solved_as(tear, ROBOT.geometry)
    assert image == Tear(0, (0.1, -0.05, 0.1), "rest")
    assert optimum(tear).peak_speed == pytest.approx(optimum(image).peak_speed, rel=0.01)


def test_every_tear_is_the_image_of_a_solved_one_at_a_pose_of_the_grid() -> None:
    frame = np.array(ROBOT.geometry.frame)
    for cable in range(LEFT + 1):
        for position in POSITIONS:
            image = solved_as(Tear(cable, position, "away"), ROBOT.geometry)
            assert image.position in POSITIONS
            assert image.motion == "away"
            assert frame[image.cable][2] == frame[cable][2]
            far, near = frame[cable] - position, frame[image.cable] - image.position
            assert np.linalg.norm(far) == pytest.approx(np.linalg.norm(near))


def test_the_modules_stay_out_of_what_is_installed() -> None:
    """The optimiser is for the bench: no room imports it."""
    root = Path(__file__).parents[2]
    rooms = [root / room for room in ("config", "drivers", "runtime", "sim", "tools")]
    assert not [
        path for room in rooms for path in room.rglob("*.py") if "casadi" in path.read_text()
    ]
