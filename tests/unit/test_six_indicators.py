"""The shipped study of the six indicators: the paper's tests, robots of their own, and differences
between controllers on the same robot with the same seed."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from pydantic import ValidationError

from tonus.config import load
from tonus.config.loader import load_parameter_study, load_protocol
from tonus.config.schema.parameter_study import ParameterStudy
from tonus.tools.cli.main import tonus
from tonus.tools.errors import ToolError
from tonus.tools.paper.case import Kind
from tonus.tools.paper.protocol import Programme
from tonus.tools.paper.recorded import kind_of
from tonus.tools.study.engine import Studied
from tonus.tools.study.groups import ROBOT, differences, groups, told
from tonus.tools.study.indicators import INDICATORS
from tonus.tools.study.names import need_known
from tonus.tools.study.page import write_page
from tonus.tools.study.play import COMPLETED, Row, failed
from tonus.tools.study.provenance import loaded
from tonus.tools.study.trials import in_turn, trials

PROTOCOL = load_protocol()
SHIPPED = load_parameter_study("six_indicators")
AT_REST = "tonus.runtime.control.controllers.pid:PidAtRest"
CASES = {
    "paper_press": "press",
    "paper_move": "move_z_10mm",
    "paper_sine": "sine_z_30mm_1Hz",
    "paper_ramp": "ramp_x",
    "paper_step": "step_x",
}
SMALL: dict[str, Any] = {
    "name": "x",
    "configs": ["config/direct.yaml"],
    "scenarios": ["hold"],
    "controllers": ["pid", "bio"],
    "seeds": 2,
    "parameters": {ROBOT: [7, 8]},
    "indicators": ["settling"],
    "shown": ["settling"],
}


def study(**changes: Any) -> ParameterStudy:
    return ParameterStudy.model_validate(SMALL | changes)


def rows_of(of: ParameterStudy, values: dict[tuple[str, int, int], float | None]) -> list[Row]:
    """Completed, with ``values`` by controller, robot and seed."""
    made = []
    for trial in trials(of):
        place = (str(trial.controller), trial.parameters[ROBOT], trial.seed)
        row = failed(of, trial, "none") | {"verdict": COMPLETED, "reason": "done"}
        made.append(row | {"settling": values[place]})
    return made


def test_the_shipped_study_can_be_played_and_is_as_large_as_its_page_says() -> None:
    need_known(SHIPPED)
    planned = trials(SHIPPED)
    assert len(planned) == 5 * 3 * 200 * 5
    assert SHIPPED.controllers == ("pid", AT_REST, "bio_observer")
    assert {each.parameters[ROBOT] for each in planned} == set(range(1001, 1201))
    done = CliRunner().invoke(tonus, ["campaign", "six_indicators", "--count"])
    assert done.output.startswith("15000 runs; the first: tonus run config/direct.yaml")
    assert "--set lab.robot_seed=1001\n" in done.output


def test_its_tests_and_its_spreads_are_those_of_the_programme() -> None:
    cases = {case.name: case for case in Programme(PROTOCOL, load("config/direct.yaml")[0]).cases()}
    assert set(SHIPPED.scenarios) == set(CASES)
    for name, case in CASES.items():
        _, scenario = load("config/direct.yaml", name)
        named = {"name": scenario.name, "description": scenario.description}
        assert scenario == cases[case].scenario.model_copy(update=named), name
        assert kind_of(scenario) is cases[case].kind
    config, _ = loaded(SHIPPED, trials(SHIPPED)[0])
    assert config.lab is not None
    plant, noise = config.lab.plant.model_dump(), config.lab.noise.model_dump()
    drawn = PROTOCOL.drawn
    assert drawn.plant.items() <= plant.items()
    assert drawn.force_cell.items() <= noise["force_cell"].items()
    assert noise["tracker"]["latency_ms"] == tuple(drawn.tracker["latency_ms"])


def test_each_of_the_six_is_taken_from_a_test_of_the_study() -> None:
    kinds = {kind_of(load("config/direct.yaml", name)[1]) for name in SHIPPED.scenarios}
    assert len(SHIPPED.indicators) == 6
    assert all(INDICATORS[name] <= kinds for name in SHIPPED.indicators)
    assert INDICATORS["load_deviation_peak"] == {Kind.STEP, Kind.RAMP}


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"indicators": ["setling"], "shown": []}, "there is no indicator setling"),
        ({"controllers": ["no.such_module:Pid"]}, "controller no.such_module:Pid: "),
    ],
)
def test_what_it_names_is_looked_for_before_its_first_run(
    change: dict[str, Any], told: str
) -> None:
    with pytest.raises(ToolError, match=f"study x: {told}"):
        need_known(study(**change))


def test_a_controller_is_named_as_for_a_run() -> None:
    need_known(study(controllers=["pid", AT_REST]))
    with pytest.raises(ValidationError, match="Input should be 'bio'"):
        study(controllers=["pidd"])


def test_a_robot_is_one_sample_the_mean_over_its_seeds() -> None:
    of = study(controllers=["pid"])
    values = {("pid", 7, 1): 1.0, ("pid", 7, 2): 3.0, ("pid", 8, 1): 3.0, ("pid", 8, 2): 5.0}
    (group,) = groups(of, rows_of(of, values))
    mean = group.mean("settling")
    assert mean is not None
    assert (mean.count, mean.value, group.samples) == (2, 3.0, 2)
    # Samples 2 and 4: sem = 1, and t(0.975, 1) = 12.706.
    assert mean.half == pytest.approx(12.706, rel=1e-4)


def test_a_robot_that_does_not_settle_with_every_seed_has_no_settling_time() -> None:
    of = study(controllers=["pid"])
    values = {("pid", 7, 1): 1.0, ("pid", 7, 2): 3.0, ("pid", 8, 1): 9.0, ("pid", 8, 2): None}
    rows = rows_of(of, values)
    (group,) = groups(of, rows)
    assert told(group, "settling") == "2 (of 1 of 2)"
    rows[3]["verdict"] = "cable_torn"
    assert told(group, "settling").startswith("5.5 ± ")


def test_differences_are_taken_on_the_same_robot_with_the_same_seed() -> None:
    of = study()
    one = {("pid", 7, 1): 1.0, ("pid", 7, 2): 3.0, ("pid", 8, 1): 40.0, ("pid", 8, 2): 60.0}
    less = {("bio", 7, 1): 0.5, ("bio", 7, 2): 2.5, ("bio", 8, 1): 39.4, ("bio", 8, 2): 59.4}
    rows = rows_of(of, one | less)
    (group,) = differences(of, rows)
    assert group.labels == {"controller": "bio less pid"}
    assert [row["settling"] for row in group.rows] == pytest.approx([-0.5, -0.5, -0.6, -0.6])
    mean = group.mean("settling")
    assert mean is not None
    assert mean.value == pytest.approx(-0.55)
    assert mean.half == pytest.approx(12.706 * 0.05, rel=1e-4)
    rows[-1]["settling"] = None
    assert told(differences(of, rows)[0], "settling") == "-0.5 (of 1 of 2)"
    rows[0]["verdict"] = "cable_torn"
    assert len(differences(of, rows)[0].rows) == 3
    assert not differences(study(controllers=["pid"]), rows[:4])


def test_a_mean_of_a_part_of_the_robots_says_so() -> None:
    of = study(controllers=["pid"], seeds=1)
    (group,) = groups(of, rows_of(of, {("pid", 7, 1): 1.5, ("pid", 8, 1): None}))
    assert told(group, "settling") == "1.5 (of 1 of 2)"
    assert told(group, "effort_rms_nm") == ""


def test_what_was_played_before_an_interruption_is_the_same_of_every_controller() -> None:
    of = study(scenarios=["hold", "sine_z"])
    order = in_turn(of, trials(of))
    assert sorted(each.index for each in order) == list(range(2 * 2 * 2 * 2))
    played = [(each.seed, each.parameters[ROBOT]) for each in order]
    assert played == [(seed, robot) for seed, robot in product((1, 2), (7, 8)) for _ in range(4)]
    one = {(each.scenario, each.controller) for each in order[:4]}
    assert one == set(product(("hold", "sine_z"), ("pid", "bio")))


def test_the_page_has_the_means_of_the_robots_and_the_differences(tmp_path: Path) -> None:
    of = study()
    places = product(("pid", "bio"), (7, 8), (1, 2))
    values = {place: float(number) for number, place in enumerate(places)}
    page = write_page(of, rows_of(of, values)[:7], tmp_path).read_text()
    assert "7 of 8 runs, 0 not completed; means over the robots" in page
    assert "Differences between controllers" in page
    assert '<td>bio less pid</td><td class="n">4 ± 0</td>' in page
    alone = study(controllers=["bio"])
    assert "Differences" not in write_page(alone, rows_of(alone, values), tmp_path).read_text()


def test_an_interrupted_study_shows_what_it_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    of = study()
    values = dict.fromkeys(product(("pid", "bio"), (7, 8), (1, 2)), 1.0)
    some = rows_of(of, values)[:5]
    studied = Studied(trials(of), some, 1.0, 0, interrupted=True)
    monkeypatch.setattr("tonus.tools.cli.campaign.play.carry_out", lambda *_, **__: studied)
    (tmp_path / "study.yaml").write_text(of.model_dump_json(exclude_none=True))
    words = ["campaign", str(tmp_path / "study.yaml"), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(tonus, words)
    assert done.exit_code == 1
    assert "interrupted after 5 of 8 runs; the same command goes on" in done.output
    assert (tmp_path / "out" / "index.html").exists()
