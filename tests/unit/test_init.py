"""`tonus init`: what it writes is complete, runs as it is, and needs nothing outside its folder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from loop import QUICK

from tonus.config import load
from tonus.config.document import read
from tonus.config.loader import HERE
from tonus.tools.cli.check import check
from tonus.tools.cli.init import init
from tonus.tools.cli.run import run
from tonus.tools.errors import ToolError

COMPLETE = ("can", "direct", "ethercat", "mixed", "one_channel", "robot", "unlike_axes")


@pytest.mark.parametrize("like", COMPLETE)
def test_it_is_what_is_shipped_and_stands_by_itself(tmp_path: Path, like: str) -> None:
    folder = tmp_path / "mine"
    done = CliRunner().invoke(init, [str(folder), "--like", f"config/{like}.yaml"])
    assert done.exit_code == 0, done.output
    shipped, scenario = load(f"config/{like}.yaml")
    written, played = load(folder / "robot.yaml")
    assert written.name == "mine"
    alike = {"name": "mine", "scenario": f"scenarios/{scenario.name}.yaml"}
    assert written == shipped.model_copy(update=alike)
    assert played == scenario
    for name in read(folder / "robot.yaml").folders:
        assert Path(name).resolve().is_relative_to(folder.resolve())
    assert load(folder / "direct.yaml")[0].robot == written.robot


def test_comments_are_kept(tmp_path: Path) -> None:
    CliRunner().invoke(init, [str(tmp_path / "mine")])
    for file in (tmp_path / "mine").rglob("*.yaml"):
        assert "#" in file.read_text(), file
    robot = (HERE / "robots/paper.yaml").read_text()
    assert (tmp_path / "mine/robots/paper.yaml").read_text() == robot
    assert "tonus check" in (tmp_path / "mine/robot.yaml").read_text()


def test_it_runs_as_it_is_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path / "runtime"))
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(init, ["mine"]).exit_code == 0
    assert CliRunner().invoke(check, ["mine/robot.yaml"]).exit_code == 0
    arguments = ["mine/direct.yaml", "--virtual", "--duration", "0.2", "--json"]
    arguments += [f"--set={key}={value}" for key, value in QUICK.items()]
    done = CliRunner().invoke(run, arguments)
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["state"] == "STANDBY"
    (folder,) = (each for each in (tmp_path / "out").iterdir() if not each.is_symlink())
    assert (tmp_path / "out/latest").resolve() == folder.resolve()
    assert folder.name.endswith("-direct-load_test")


def test_what_is_there_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text("mine")
    raised = CliRunner().invoke(init, [str(tmp_path)]).exception
    assert isinstance(raised, ToolError)
    assert "is not empty" in str(raised)
    assert (tmp_path / "robot.yaml").read_text() == "mine"


def test_only_what_is_shipped_can_be_started_from(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text((HERE / "direct.yaml").read_text().replace("!include ", f"!include {HERE}/"))
    raised = CliRunner().invoke(init, [str(tmp_path / "new"), "--like", str(own)]).exception
    assert isinstance(raised, ToolError)
    assert not (tmp_path / "new").exists()
