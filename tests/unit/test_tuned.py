"""What is said of tuning is true: a failure is none, and another robot's gains are not ours."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner
from paper_setup import campaign

from tonus.config import load
from tonus.config.loader import load_protocol
from tonus.tools.cli.init import init
from tonus.tools.cli.paper import paper
from tonus.tools.cli.tune import tune
from tonus.tools.errors import ToolError
from tonus.tools.paper.campaign import Campaign
from tonus.tools.paper.claims import claims
from tonus.tools.paper.publish import publish
from tonus.tools.paper.verdicts import Verdict
from tonus.tools.tune.judge import Part
from tonus.tools.tune.tuned import not_tuned, robot_key
from tonus.tools.tune.work import Evaluator, Gains

CONFIG = "config/direct.yaml"


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every simulation fails, as on a robot that cannot hold itself."""

    def fail(_: Evaluator, controller: str, many: Sequence[Gains]) -> list[list[Part]]:
        return [[Part("sine", 100.0, None, None, 0.0, "never active")] for _ in many]

    monkeypatch.setattr(Evaluator, "__call__", fail)
    monkeypatch.setattr("tonus.tools.tune.search.lack", lambda *_: 0.0)


@pytest.mark.usefixtures("failing")
@pytest.mark.parametrize("as_json", [False, True])
def test_gains_that_fail_everywhere_are_no_result_and_do_not_land(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, as_json: bool
) -> None:
    def landed(*_: object) -> list[Path]:
        raise AssertionError("nothing may land")

    monkeypatch.setattr("tonus.tools.cli.tune.land", landed)
    out = tmp_path / "tuned.yaml"
    options = ["--land", "--evaluations", "6", "--jobs", "1", "--out", str(out)]
    result = CliRunner().invoke(tune, ["pd", *options, *["--json"] * as_json])
    assert result.exit_code == 1, result.output
    assert "pd is NOT tuned: its best gains still fail in sine (never active)" in result.output
    assert "the configuration is unchanged" in result.output
    written = yaml.safe_load(out.read_text())
    assert written["controllers"]["pd"]["failed_in"] == {"sine": "never active"}
    if as_json:
        assert json.loads(result.stdout) == written


def test_the_shipped_robot_is_tuned_and_any_other_is_not() -> None:
    config, _ = load(CONFIG)
    controllers = load_protocol().full.controllers
    assert not_tuned(config, controllers) == ""
    heavier, _ = load(CONFIG, overrides={"robot.platform.mass": config.robot.platform.mass + 1.0})
    assert "another robot" in not_tuned(heavier, controllers)
    softer, _ = load(CONFIG, overrides={"control.pid.stiffness": 3000.0})
    assert "control.pid.stiffness is 3000" in not_tuned(softer, controllers)
    assert not_tuned(softer, ["bio"]) == ""


def test_an_own_robot_is_tuned_by_its_own_file(tmp_path: Path) -> None:
    config, _ = load(CONFIG, overrides={"robot.platform.mass": 3.21})
    file = tmp_path / "tuned.yaml"
    damping = config.control.bio.damping_ratio
    row = {"gains": {"bio.damping_ratio": damping}, "evaluations": 8}
    found = {"robot": robot_key(config), "evaluations": 8, "controllers": {"bio": row}}
    file.write_text(yaml.safe_dump(found))
    assert not_tuned(config, ["bio"], file) == ""
    assert "no gains of pid" in not_tuned(config, ["bio", "pid"], file)
    file.write_text(yaml.safe_dump({**found, "controllers": {"bio": {**row, "evaluations": 4}}}))
    assert "4 simulations, not the budget" in not_tuned(config, ["bio"], file)
    row["failed_in"] = {"sine": "never active"}
    file.write_text(yaml.safe_dump(found))
    assert "failed in sine" in not_tuned(config, ["bio"], file)


@pytest.mark.parametrize("text", ["", "a: 1", "controllers: 3", "controllers: {a: {}}", "{", "[1]"])
def test_a_file_that_is_no_result_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "tuned.yaml"
    file.write_text(text)
    with pytest.raises(ToolError, match="not written by tonus tune"):
        not_tuned(load(CONFIG)[0], ["bio"], file)


@pytest.mark.wide
def test_controllers_that_are_not_tuned_alike_are_never_said_to_be(tmp_path: Path) -> None:
    results = campaign()
    untuned = campaign()
    untuned.untuned = "config/tuned.yaml is of another robot than mine"
    tuned_alike = {claim.name: claim for claim in claims(results, [])}
    for claim in claims(untuned, []):
        assert "here all were" not in claim.sentence
        if "here all were" in tuned_alike[claim.name].sentence:
            assert "another robot than mine" in claim.sentence
            assert claim.verdict is not Verdict.REPRODUCED
    said: list[object] = []
    assert publish(untuned, tmp_path, said.append)["not_tuned_alike"] == untuned.untuned
    assert any("NOT tuned alike" in str(each) for each in said)
    page = (tmp_path / "paper.html").read_text()
    assert "NOT tuned alike" in page
    assert "the tuned PID" not in page


@pytest.mark.wide
@pytest.mark.parametrize(
    ("mass", "tuned"), [pytest.param(None, True, marks=pytest.mark.long), (3.21, False)]
)
def test_the_command_says_of_an_own_robot_that_nothing_was_tuned_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mass: float | None, tuned: bool
) -> None:
    """Trials made up, since only what is said of them is asked."""
    played = Campaign(campaign(), [], 0.0, 0.0, 0)
    monkeypatch.setattr("tonus.tools.cli.paper.carry_out", lambda *_: played)
    folder, out = tmp_path / "mine", tmp_path / "out"
    out.mkdir()
    assert CliRunner().invoke(init, [str(folder)]).exit_code == 0
    robot = folder / "robots/paper.yaml"
    if mass is not None:
        robot.write_text(
            re.sub(r"(?m)^(\s*mass: )[0-9.]+", rf"\g<1>{mass}", robot.read_text(), count=1)
        )
    arguments = [str(folder / "direct.yaml"), "--quick", "--out", str(out), "--json"]
    done = CliRunner().invoke(paper, arguments)
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)["not_tuned_alike"]
    assert said is None if tuned else "another robot" in said
    page = (out / "paper.html").read_text()
    assert ("NOT tuned alike" in page) is not tuned
    assert ("here all were, with one budget" in page) is tuned
