"""The least stop under a load: the push against the plant, an episode's break, the command."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from plant_setup import CONFIG, LAB, ROBOT, UPRIGHT, balanced, frictionless, plant

pytest.importorskip("casadi", reason="the least stop is computed with the extra bench")

from tests.bench.least_stop.__main__ import main
from tests.bench.least_stop.against_plant import speeds
from tests.bench.least_stop.begin import case_of, played, still
from tests.bench.least_stop.episode import case_in, constants_of, reached
from tests.bench.least_stop.grid import LOADED, UNLOADED
from tests.bench.least_stop.hold import Hold
from tests.bench.least_stop.loaded import Least, Reached, compared
from tests.bench.least_stop.model import LEFT, Constants, Model
from tests.bench.least_stop.problem import Case, Problem, Solution
from tests.bench.least_stop.push import NO_PUSH, Push
from tonus.config.loader import load_study
from tonus.sim.plant import Plant
from tonus.tools.campaign.draw import episodes
from tonus.tools.campaign.observed import Observed
from tonus.tools.campaign.play import play
from tonus.tools.errors import ToolError

pytestmark = pytest.mark.wide

TORN = 0
CENTRE = (0.0, 0.0, 0.0)
MODEL = Model(Constants.of(ROBOT, LAB))
PROBLEM = Problem(MODEL)
LEFT_OF_TORN = [i for i in range(LEFT + 1) if i != TORN]
EPISODE = ("88", "direct", "104")
"""friction in drum 2, cable 1 cut in HOLD, and a load 6 ms later"""


def placed(position: tuple[float, float, float], **arguments: object) -> tuple[Plant, Hold]:
    p = plant(**arguments)
    p.position[:] = position
    p.quaternion[:] = UPRIGHT
    hold = Hold(np.array(position), np.array(UPRIGHT), balanced(p))
    p.place(hold.position, hold.quaternion, hold.tension)
    return p, hold


def pushed(share: float) -> Push:
    """So much of 40 N towards the torn cable's anchor, from the break on."""
    anchor = np.array(ROBOT.geometry.frame[TORN])
    x, y, z = (float(each) for each in 40.0 * share * anchor / np.linalg.norm(anchor))
    return Push((x, y, z))


def stop(case: Case) -> Solution:
    begin = PROBLEM.unknowns(case, still(case))
    return PROBLEM.solve(case, begin, weights=(2.0, 0.0), speed_limit=5.0, tension_limit=200.0)


def centre(push: Push = NO_PUSH) -> Case:
    _, hold = placed(CENTRE)
    return case_of(MODEL, ROBOT.geometry, hold, TORN, np.zeros(3), push)


@pytest.fixture(scope="module")
def run() -> Observed:
    study, index = load_study("faults"), int(EPISODE[2])
    drawn = episodes(study, int(EPISODE[0]), ["direct"], index + 1)[index]
    return play(drawn, tail=study.times.tail, longest=study.times.longest, named=study.named)


def test_the_model_moves_under_a_push_as_the_plant_does_without_friction() -> None:
    robot = ROBOT.model_copy(
        update={"drum": ROBOT.drum.model_copy(update={"viscous_friction": 0.0})}
    )
    push = Push((40.0, -30.0, -35.0), (0.03, 0.02, -0.04), begin=0.006, rise=0.009)
    p, hold = placed((0.1, -0.05, 0.05), robot=robot, lab=frictionless())
    case = case_of(MODEL, robot.geometry, hold, TORN, np.zeros(3), push)
    p.cut_cable(TORN)
    p.advance(p.now_ns + 6_000_000)
    p.defects.push(push.force, push.point, push.rise)
    p.advance(p.now_ns + 18_000_000)
    state = played(MODEL, case, lambda x, pulls: case.force)[8]
    # Without the push the platform goes elsewhere, and does not turn like that.
    alone = played(MODEL, replace(case, push=NO_PUSH), lambda x, pulls: case.force)[8]
    assert np.linalg.norm(alone[6:9] - p.velocity) > 0.2
    assert np.linalg.norm(alone[9:12] - p.angular_velocity) > 0.5
    assert state[0:3] - hold.position == pytest.approx(p.position - hold.position, abs=1e-4)
    # Cables go slack under it, which the model rounds: up to a newton in each.
    assert state[6:9] == pytest.approx(p.velocity, abs=0.015 * np.linalg.norm(p.velocity))
    turned = state[9:12]
    assert turned == pytest.approx(p.angular_velocity, abs=0.03 * np.linalg.norm(turned))


@pytest.mark.parametrize("begin", [0.006, -1.0], ids=["coming", "there already"])
def test_the_optimal_torques_under_a_push_do_in_the_plant_what_they_do_in_the_model(
    begin: float,
) -> None:
    push = replace(pushed(-1.0), begin=begin, rise=0.003)
    case, hold = centre(push), placed(CENTRE)[1]
    found = stop(case)
    pulls = PROBLEM.tensions(0.5 * (found.early[:-1] + found.early[1:]), case)
    _, true, wanted = speeds(CONFIG, hold, TORN, np.zeros(3), case, found, pulls)
    assert true == pytest.approx(wanted, abs=0.04 * wanted.max())
    assert true.max() == pytest.approx(wanted.max(), rel=0.03)


@pytest.mark.parametrize("grid", [UNLOADED, LOADED], ids=["unloaded", "loaded"])
def test_no_impulse_of_a_push_is_lost_between_the_nodes(grid) -> None:
    brief = Push((60.0, 0.0, -30.0), begin=0.0177, rise=0.0014, duration=0.17)
    impulse = grid.steps @ brief.means(grid.times)
    assert impulse == pytest.approx(0.17 * np.array(brief.force), rel=1e-9)
    before = replace(brief, begin=-0.1, rise=0.0)
    assert before.means(grid.times)[0] == pytest.approx(brief.force)
    rest = grid.steps @ before.means(grid.times)
    assert rest == pytest.approx(0.07 * np.array(brief.force), rel=1e-4)
    stays = Push(brief.force, begin=0.3, rise=0.2)
    left = grid.times[-1] - 0.4
    assert grid.steps @ stays.means(grid.times) == pytest.approx(left * np.array(brief.force))
    late = Push(brief.force, begin=1.0, rise=0.2)
    assert not late.means(grid.times).any()


def test_a_push_that_replaces_the_lost_force_slows_the_optimum_and_the_opposite_one_does_not() -> (
    None
):
    replaced, alone, added = (stop(centre(pushed(share))) for share in (1.0, 0.0, -1.0))
    assert replaced.converged
    assert alone.converged
    assert added.converged
    assert replaced.peak_speed < 0.6 * alone.peak_speed
    assert added.peak_speed > 1.2 * alone.peak_speed


def test_a_drum_without_force_makes_the_optimum_faster_and_gets_none() -> None:
    weak, lost = LEFT_OF_TORN.index(2), np.zeros(LEFT)
    lost[weak] = 2.0 * MODEL.constants.driving_force
    found = stop(replace(centre(), lost=lost))
    assert found.converged
    rates = 0.5 * (found.early[1:-1] + found.early[2:])[:, -LEFT + weak]
    assert found.forces[1:, weak] == pytest.approx(-MODEL.constants.viscous * rates, abs=1e-3)
    assert found.peak_speed > stop(centre()).peak_speed


def test_an_episode_begins_as_truth_has_it_just_before_the_break(run: Observed) -> None:
    model = Model(constants_of(run.config, 1))
    case = case_in(run, model)
    before = run.truth[run.truth["cut"].any(axis=1).argmax() - 1]
    left = [i for i in range(LEFT + 1) if i != 1]
    pulls = Problem(model).tensions(case.state[None], case)[0]
    assert pulls == pytest.approx(before["tension"][left], abs=0.05)
    # In HOLD the drums stand.
    assert case.force == pytest.approx(before["tension"][left], abs=1.0)
    assert case.lost == pytest.approx([0.0, 35.33, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert case.push.begin == pytest.approx(0.006)
    assert not case_in(run, model, sound=True).lost.any()


def test_a_slack_cable_has_the_length_that_its_drum_gave_it(run: Observed) -> None:
    model = Model(constants_of(run.config, 1))
    taut = case_in(run, model)
    before = int(run.truth["cut"].any(axis=1).argmax()) - 1
    truth = run.truth.copy()
    # Cable 0 paid out by 5 mm within the last row.
    out = 0.005 / run.config.robot.drum.radius
    truth["drum_angle"][before, 0] -= out
    truth["tension"][before, 0] = 0.0
    slack = case_in(replace(run, truth=truth), model)
    free = slice(6 * LEFT, 7 * LEFT)
    longer = slack.geometry[free] - taut.geometry[free]
    assert longer == pytest.approx([0.005, *[0.0] * 6], abs=1e-5)


def test_what_was_reached_is_counted_from_the_break_on(run: Observed) -> None:
    did = reached(run)
    speed = np.linalg.norm(run.truth["velocity"], axis=1)
    assert did.speed == pytest.approx(speed.max())
    assert did.tension == pytest.approx(run.truth["tension"].max())
    assert 0.0 < did.after < 0.2


def test_a_run_without_a_torn_cable_has_no_such_stop(run: Observed) -> None:
    with pytest.raises(ToolError, match="0 cables are torn"):
        case_in(replace(run, strikes=[]), MODEL)


def test_the_lowest_optimum_that_converged_counts() -> None:
    good = stop(centre())
    low = replace(good, peak_speed=0.1, defect=1.0)
    high = replace(good, peak_speed=1.0)
    did = Reached(2.0 * good.peak_speed, 0.05, 2.0 * good.peak_tension)
    both = [Least("still", low, low), Least("damping", high, high), Least("standing", good, good)]
    assert "2.00 and 2.00 times" in compared(both, did)
    assert "not converged, nan N" in str(both[0])
    assert "none converges" in compared(both[:1], did)


def test_the_command_plays_an_episode_and_compares_it_with_its_optimum() -> None:
    result = CliRunner().invoke(main, ["episode", *EPISODE, "--start", "still"])
    assert result.exit_code == 0, result.output
    assert "61 N from 6 ms" in result.output
    found = re.search(r"least ([\d.]+) m/s.*reached ([\d.]+) m/s.*: ([\d.]+) and", result.output)
    assert found, result.output
    least, did, ratio = (float(each) for each in found.groups())
    assert 0.3 < least < 0.45
    assert ratio == pytest.approx(did / least, abs=0.02)


@pytest.mark.parametrize("words", [["83", "direct", "--", "-1"], ["83", "usb", "3"]])
def test_a_wrong_argument_ends_with_one_line(words: list[str]) -> None:
    result = CliRunner().invoke(main, ["episode", *words])
    assert result.exit_code == 2
    assert "Invalid value" in result.output
