"""The commands and files of docs/trajectories.md and docs/verify.md, as they stand there."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from markdown_it import MarkdownIt

from tests.command import command
from tonus.config.loader import load_scenario

DOCS = Path(__file__).resolve().parents[2] / "docs"


def blocks(page: str, language: str) -> list[str]:
    found = MarkdownIt().parse((DOCS / page).read_text(encoding="utf-8"))
    return [
        each.content for each in found if each.type == "fence" and each.info.startswith(language)
    ]


def indented(page: str) -> list[str]:
    """Commands, which stand by themselves."""
    found = MarkdownIt().parse((DOCS / page).read_text(encoding="utf-8"))
    text = "".join(each.content for each in found if each.type == "code_block")
    return [line for line in text.splitlines() if line.startswith("tonus ")]


@pytest.mark.parametrize("kind", ["table", "object"])
def test_a_trajectory_of_ones_own_is_checked(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)  # as PYTHONPATH does it
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    (code,) = blocks("trajectories.md", "python")
    Path("mine.py").write_text(code)
    rows = "".join(f"{time},0,0,{0.01 * time}\n" for time in range(4))
    Path("motion.csv").write_text("t,x,y,z\n" + rows)
    (reference,) = (each for each in blocks("trajectories.md", "yaml") if f"kind: {kind}" in each)
    Path("own.yaml").write_text(f"name: own\ndescription: mine\nduration: 4.0\n{reference}")
    (line,) = indented("trajectories.md")
    done = command(*shlex.split(line)[1:])
    assert done.code == 0, done.out + done.err
    assert re.search(r"all \d+ checks passed", done.out), done.out


def test_the_acceptance_test_of_the_page_is_the_shipped_one() -> None:
    (text,) = blocks("verify.md", "yaml")
    shown: dict[str, Any] = yaml.safe_load(text)
    full = load_scenario("acceptance").model_dump(mode="json")
    shipped = yaml.safe_load((DOCS.parent / "config/scenarios/acceptance.yaml").read_text())
    assert full["duration"] == shown.pop("duration")
    assert shown.pop("reference") == shipped["reference"]
    assert shown.pop("lab") == shipped["lab"]
    for key in ("operator", "expect"):
        assert all(each in shipped[key] for each in shown.pop(key))
    assert not shown


@pytest.mark.long
def test_acceptance_tests_of_ones_own_are_played(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shipped, own = indented("verify.md")
    assert command(*shlex.split(shipped)[1:]).code == 0
    assert command("init", "mine").code == 0
    Path("tests").mkdir()
    (text,) = blocks("verify.md", "yaml")
    expect = [{"kind": "ends", "state": "STANDBY"}, {"kind": "replays"}]
    for name in ("one", "two"):
        data = {"name": name, "description": "", "duration": 0.2, "expect": expect}
        data["reference"] = yaml.safe_load(text)["reference"]
        Path("tests", f"{name}.yaml").write_text(yaml.safe_dump(data))
    words = shlex.split(own)[1:]
    at = words.index("tests/*.yaml")
    words[at : at + 1] = ["tests/one.yaml", "tests/two.yaml"]  # as a shell does it
    done = command(*words)
    assert done.code == 0, done.out + done.err
    assert Path("report.xml").read_text().count("<testcase") >= 2
