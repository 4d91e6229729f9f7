"""Runs side by side, through the command."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tests.loop import QUICK
from tests.scripted import scripted
from tonus.config import load
from tonus.config.loader import load_scenario
from tonus.config.schema.scenario import Scenario
from tonus.runtime.states import State
from tonus.tools.cli.log.compare import compare
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.paper.case import Kind
from tonus.tools.paper.printed import OURS
from tonus.tools.paper.recorded import kind_of
from tonus.tools.paper.table import text
from tonus.tools.report.compare import _as_played, load_of
from tonus.tools.report.compare import compare as put_side_by_side
from tonus.tools.report.differences import differences
from tonus.tools.testing.player import Player

pytestmark = [
    pytest.mark.tonus(config="config/direct.yaml", overrides=QUICK),
    pytest.mark.wide,
]

RUNS = (("bio", 1), ("bio", 2), ("pid", 1))
FADE, PERIOD = 0.5, 0.5
"""s, of the sine that is played"""


def played(play: Player, controller: str, seed: int, **overrides: object) -> Log:
    """One period of 5 mm at 2 Hz, after a fade."""
    sine = load_scenario("sine_z").reference.model_dump()
    sine |= {"amplitude": 0.005, "fade": FADE, "frequency": 1.0 / PERIOD}
    return play(
        scripted("sine_z", reference=sine),
        controller=controller,
        seed=seed,
        overrides=overrides,
        duration=FADE + PERIOD + 0.05,
    ).log


@pytest.fixture(scope="module")
def logs(tonus_shared_run: Player) -> dict[tuple[str, int], Log]:
    return {each: played(tonus_shared_run, *each) for each in RUNS}


def test_repetitions_are_one_column_with_their_spread(
    logs: dict[tuple[str, int], Log], tmp_path: Path
) -> None:
    files = [str(log.path) for log in logs.values()]
    page = tmp_path / "table.html"
    done = CliRunner().invoke(compare, [*files, "--json", "--out", str(page)])
    assert done.exit_code == 0, done.output
    told = json.loads(done.output)
    tracking = next(row for row in told["rows"] if "RMSE_x" in row["indicator"])
    assert tracking["controllers"]["bio"]["n"] == 2
    assert tracking["controllers"]["pid"]["n"] == 1
    assert {each["against"] for each in told["logs"]} == {"truth"}
    assert any("RMSE_F (press)" in note for note in told["notes"])
    assert "RMSE_x" in page.read_text()
    alone = [each["indicators"]["position_rmse"] for each in told["logs"][:2]]
    assert tracking["controllers"]["bio"]["mean"] == pytest.approx(1e3 * np.mean(alone))


def test_tracking_is_that_of_the_truth(logs: dict[tuple[str, int], Log]) -> None:
    log = logs["bio", 1]
    _, (judged,) = put_side_by_side([log])
    rows = log.join("/tonus/state", "/tonus/pose", "/tonus/truth")
    time = rows["state"]["scenario_time"]
    active = rows["state"]["state"] == State.ACTIVE
    whole = rows[active & (time >= FADE) & (time < FADE + PERIOD)]
    error = whole["pose"]["desired_position"] - whole["truth"]["position"]
    independent = np.sqrt((error**2).sum(axis=1).mean())
    assert judged.row.indicators["position_rmse"] == pytest.approx(independent, rel=0.02)


def test_without_truth_the_measurements_stand_in_and_that_is_said(
    logs: dict[tuple[str, int], Log], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tonus.tools.paper.recorded.TRUTH", "/tonus/no_truth")
    table, (judged,) = put_side_by_side([open_log(logs["bio", 1].path)])
    assert judged.against == "the robot's own measurements"
    assert "position_rmse" in judged.row.indicators
    assert "efficiency_percent" not in judged.row.indicators
    assert any("own measurements: 1 of 1" in note for note in table.notes)


@pytest.mark.long
def test_unlike_gains_of_one_controller_are_two_columns(
    logs: dict[tuple[str, int], Log], tonus_run: Player
) -> None:
    other = played(tonus_run, "pid", 1, **{"control.pid.integral.gain": 100.0})
    table, _ = put_side_by_side([logs["pid", 1], other])
    assert [column.name for column in table.columns[2:]] == ["pid 1", "pid 2"]


def test_what_differs_between_two_runs_is_named(logs: dict[tuple[str, int], Log]) -> None:
    files = [str(logs[key].path) for key in (("bio", 1), ("pid", 1))]
    done = CliRunner().invoke(compare, files)
    assert done.exit_code == 0, done.output
    (line,) = (line for line in done.output.splitlines() if line.startswith("differs:"))
    assert "control.controller: bio in " in line
    assert "pid in " in line
    assert differences([logs["bio", 1], logs["bio", 2]])[0].startswith("seed: 1 in ")
    assert differences([logs["bio", 1]]) == []


@pytest.mark.parametrize("width", [40, 24])
def test_a_narrow_terminal_shows_values(
    logs: dict[tuple[str, int], Log], monkeypatch: pytest.MonkeyPatch, width: int
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    table, _ = put_side_by_side(list(logs.values()))
    values = [(row[0], text(cell, 3)) for row in table.rows for cell in row[2:]]
    assert any("±" in value for _, value in values), "repetitions are the widest"
    done = CliRunner().invoke(compare, [str(log.path) for log in logs.values()])
    assert [each for each in values if each[1] not in done.output] == []


def test_a_damaged_log_is_compared_and_costs_the_exit_code(
    logs: dict[tuple[str, int], Log], tmp_path: Path
) -> None:
    data = logs["bio", 1].path.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) * 98 // 100])
    done = CliRunner().invoke(compare, [str(cut), str(logs["pid", 1].path)])
    assert done.exit_code == 1, done.output
    assert "RMSE_x" in done.output
    assert f"damaged: {cut}: " in done.output


def test_the_two_tracking_figures_are_told_apart(logs: dict[tuple[str, int], Log]) -> None:
    table, _ = put_side_by_side([logs["bio", 1]])
    assert any("tracking_rmse_m" in note and "whole periods" in note for note in table.notes)


@pytest.mark.parametrize(("rise", "kind"), [(0.0, "step"), (0.001, "step"), (5.0, "ramp")])
def test_a_load_is_named_by_what_it_is(rise: float, kind: str) -> None:
    """25 N within a millisecond is no ramp, and never one of 100 N."""
    _, scenario = load("config/direct.yaml", "load_test")
    data = scenario.model_dump()
    data["lab"]["load"]["profile"] = [
        {"at": 1.0, "force": 0.0},
        {"at": 1.0 + rise, "force": 25.0},
        {"at": 9.0, "force": 25.0},
    ]
    played = Scenario.model_validate(data)
    assert kind_of(played).value == kind
    assert load_of(played).startswith("load of 25 N within")


def test_no_label_claims_a_size(tmp_path: Path) -> None:
    labels = {_as_played(indicator.label) for indicator in OURS}
    assert not any("100 N" in label or "25 N" in label for label in labels)
    assert "Load ramp: deviation, peak" in labels


def test_every_shipped_scenario_is_of_a_kind() -> None:
    kinds = {
        name: kind_of(_scenario(name))
        for name in ("hold", "sine_x", "contact", "load_test", "identify_motion")
    }
    assert kinds == {
        "hold": Kind.HOLD,
        "sine_x": Kind.SINE,
        "contact": Kind.CONTACT,
        "load_test": Kind.RAMP,
        "identify_motion": Kind.HOLD,
    }


def _scenario(name: str) -> Scenario:
    return load("config/direct.yaml", name)[1]
