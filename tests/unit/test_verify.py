"""`tonus verify`: a table of passed and failed, exit codes, JUnit."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner
from click.testing import Result as Said
from loop import QUICK

from tonus.config.loader import HERE
from tonus.sim.errors import LabError
from tonus.tools.cli.verify import verify
from tonus.tools.run.order import Order, Result
from tonus.tools.verify import play

GOOD: list[dict[str, Any]] = [
    {"kind": "ends", "state": "STANDBY"},
    {"kind": "never", "event": "cable_torn"},
    {"kind": "summary", "key": "tracking_rmse_m", "at_most": 0.001},
    {"kind": "rms", "topic": "truth", "field": "velocity", "during": ["ACTIVE"], "at_most": 0.2},
]
BAD: list[dict[str, Any]] = [
    {"kind": "event", "event": "cable_torn"},
    {"kind": "never", "event": "state"},
    {"kind": "ends", "state": "FAULT"},
    {"kind": "stays", "topic": "stiffness", "field": "k_eq", "low": 0.0, "high": 1.0},
    {"kind": "rms", "topic": "truth", "field": "position", "at_most": 1e-6, "norm": True},
    {"kind": "settles", "topic": "truth", "field": "position", "index": 2, "value": 1.0}
    | {"band": 0.1, "within": 1.0},
    {"kind": "summary", "key": "k_eq_n_per_m.max", "at_most": 1.0},
]


def scenario(folder: Path, name: str, expect: list[dict[str, Any]], **more: Any) -> str:
    data = {
        "name": name,
        "description": "",
        "duration": 0.5,
        "reference": {"kind": "hold"},
        "expect": expect,
        **more,
    }
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(data))
    return str(path)


def carried_out(folder: Path, *words: str) -> Said:
    config = folder / "quick.yaml"
    shipped = (HERE / "direct.yaml").read_text().replace("!include ", f"!include {HERE}/")
    config.write_text(f"{shipped}\nset: {json.dumps(QUICK)}\n")
    own = ["--config", str(config), "--out", str(folder / "out")]
    return CliRunner().invoke(verify, [*words, *own])


def line(result: Said) -> str:
    """The only one on standard error."""
    assert result.exit_code == 2, result.output
    (text,) = result.stderr.splitlines()
    return text


@pytest.mark.wide
def test_two_scenarios_on_two_processors(tmp_path: Path) -> None:
    good, bad = scenario(tmp_path, "good", GOOD), scenario(tmp_path, "bad", BAD)
    report = tmp_path / "report.xml"
    result = carried_out(tmp_path, good, bad, "--jobs", "2", "--junit", str(report))
    assert result.exit_code == 1, result.output
    shown = result.output.splitlines()
    assert shown[0] == f"passed  {good}"
    at = shown.index(f"FAILED  {bad}")
    assert all(each.startswith("  ok") for each in shown[1:at])
    missed = shown[at + 1 : at + 1 + len(BAD)]
    assert all(each.startswith("  FAILED") for each in missed), missed
    assert shown[-1].startswith(f"{tmp_path / 'quick.yaml'}: 1 of 2 failed")
    suite = ET.parse(report).getroot()  # written by us
    assert (suite.get("tests"), suite.get("failures")) == ("2", "1")
    failure = suite.find("testcase/failure")
    assert failure is not None
    assert len((failure.text or "").splitlines()) == len(BAD)


@pytest.mark.wide
def test_the_shipped_acceptance_test_passes(tmp_path: Path) -> None:
    result = carried_out(tmp_path, "acceptance")
    assert result.exit_code == 0, result.output
    assert result.output.splitlines()[-1].startswith(f"{tmp_path / 'quick.yaml'}: all 1 passed")


def test_a_warning_that_nobody_expects_fails(tmp_path: Path) -> None:
    cut = {"lab": {"faults": [{"kind": "cable_cut", "axis": 2, "at": 2.6}]}, "duration": 2.0}
    path = scenario(tmp_path, "cut", [{"kind": "ends", "state": "FAULT"}], **cut)
    result = carried_out(tmp_path, path)
    assert result.exit_code == 1
    assert "FAILED  no other warning or error" in result.output


def test_one_expectation_that_cannot_be_answered_leaves_the_others(tmp_path: Path) -> None:
    unanswered = {"kind": "summary", "key": "k_eq", "at_most": 1.0}
    path = scenario(tmp_path, "own", [unanswered, *GOOD])
    result = carried_out(tmp_path, path)
    assert result.exit_code == 1, result.output
    _, missed, *good, _ = result.output.splitlines()
    assert missed.startswith("  FAILED  summary key k_eq at_most 1.0; summary.json has no k_eq")
    assert [each.split()[0] for each in good] == ["ok"] * (len(GOOD) + 1)


@pytest.mark.parametrize(
    ("expect", "more", "said"),
    [
        ([], {}, "expect: is missing"),
        ([{"kind": "ends", "state": "LOST"}], {}, "expect.0.state"),
        ([{**BAD[3], "low": 2.0}], {}, "low <= high must hold"),
        (
            GOOD,
            {"reference": {"kind": "sine", "direction": [1, 0, 0], "amplitude": 0.4}
             | {"frequency": 0.01, "fade": 0.0}, "duration": 30.0},
            "leaves the workspace",
        ),
        (
            [*GOOD, {"kind": "stays", "topic": "posse", "field": "no", "low": 0, "high": 1}],
            {},
            "own.yaml: expect.4: there is no signal /tonus/posse.no; did you mean /tonus/pose?",
        ),
        (
            [{**BAD[3], "field": "k_qe"}],
            {},
            "no signal /tonus/stiffness.k_qe; did you mean k_eq?",
        ),
        (
            [{**BAD[5], "index": 3}],
            {},
            "/tonus/truth.position has no element 3; choose one from 0 to 2",
        ),
        ([{**BAD[3], "index": 0}], {}, "it is a scalar; leave it out"),
        (
            [{"kind": "never", "event": "cable_tron"}],
            {},
            "expect.0: no event is named cable_tron; did you mean cable_torn?",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_judged_is_one_line(
    tmp_path: Path, expect: list[dict[str, Any]], more: dict[str, Any], said: str
) -> None:
    text = line(carried_out(tmp_path, scenario(tmp_path, "own", expect, **more)))
    assert said in text
    assert not (tmp_path / "out").exists(), "it is refused before anything is played"


def test_what_cannot_be_played_leaves_the_others_their_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A misspelt signal is refused before anything is played, the lab's refusal comes later."""
    names = [
        scenario(tmp_path, "misspelt", [{**BAD[3], "field": "k_qe"}]),
        scenario(tmp_path, "refused", GOOD),
        scenario(tmp_path, "good", GOOD, duration=0.1),
    ]
    carry_out = play.run

    def refusing(order: Order) -> Result:
        if order.scenario.name == "refused":
            raise LabError("the lab cannot be built")
        return carry_out(order)

    monkeypatch.setattr(play, "run", refusing)
    report = tmp_path / "report.xml"
    result = carried_out(tmp_path, *names, "--junit", str(report))
    assert result.exit_code == 2, result.output
    first, second = result.stderr.splitlines()
    assert first.startswith(f"tonus: {names[0]}: expect.0: there is no signal")
    assert second == f"tonus: {names[1]}: the lab cannot be built"
    assert result.stdout.splitlines()[0] == f"passed  {names[2]}"
    assert "quick.yaml: all 1 passed, 2 refused" in result.stdout
    suite = ET.parse(report).getroot()  # written by us
    assert [suite.get(key) for key in ("tests", "failures", "errors")] == ["3", "0", "2"]
    assert len(suite.findall("testcase/error")) == 2


def test_a_mistake_in_the_configuration_is_said_once(tmp_path: Path) -> None:
    names = [scenario(tmp_path, name, GOOD) for name in ("one", "two")]
    text = line(carried_out(tmp_path, *names, "--set", "control.nothing=1"))
    assert "control.nothing" in text
