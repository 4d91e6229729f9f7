"""The plugin in a project of somebody else: what passes, what fails, and what is told of it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import pytest
from loop import QUICK

from tests.foreign import pytest_in
from tonus.runtime.recording.taps import Level
from tonus.runtime.signals import SCHEMA_VERSION
from tonus.tools.expect import ExpectationError, Run
from tonus.tools.expect.timeline import Timeline
from tonus.tools.log import open as open_log
from tonus.tools.log.log import Event
from tonus.tools.testing.case import Case
from tonus.tools.testing.player import LabFactory, Player

INI = """\
[pytest]
addopts = --strict-markers
tonus_config = quick.yaml
tonus_seed = 5
"""
LIGHT = """\
import sys


def test_nothing():
    heavy = {"numpy", "can", "pydantic", "yaml", "numba", "tonus.tools", "tonus.config"}
    assert not heavy & sys.modules.keys(), heavy & sys.modules.keys()
"""
PROJECT = """\
import os

import pytest

import tonus

SHORT = {"duration": 0.1}


def test_a_run(tonus_run, tonus_measure):
    run = tonus_run("hold", **SHORT)
    assert (run.state, run.reason) == ("STANDBY", "scenario completed")
    assert run.log.metadata["seed"] == "5"
    run.signal("tension", "measured").during("HOLD", "ACTIVE").stays(1.0, 400.0)
    run.invariants(replayed=True)
    tonus_measure("position error", 1e3 * run.summary["tracking_rmse_m"], "mm", at_most=5.0)


def test_a_figure_out_of_bounds(tonus_run, tonus_seed):
    run = tonus_run("hold", seed=tonus_seed + 2, **SHORT)
    run.signal("tension", "measured").during("ACTIVE").stays(1.0, 2.0)


def test_a_warning_that_nobody_expected(tonus_run):
    tonus_run("hold", faults=[{"kind": "tracker_hidden", "at": 0.0}], **SHORT)


def test_a_held_run_that_its_test_did_not_end(tonus_held):
    robot = tonus_held()
    robot.advance(20)
    assert robot.state == "ACTIVE"


def test_a_held_run_that_nobody_asked(tonus_held):
    robot = tonus_held()
    robot.fault("cable_cut", axis=2)
    robot.advance(20)


@pytest.mark.tonus_seeds(2)
def test_seeds(tonus_lab, tonus_seed):
    assert tonus_lab.seed == tonus_seed
    assert tonus_seed in (5, 6)


@pytest.mark.tonus_needs("ethercat", "root", "realtime", "kernel-can")
def test_needs():
    pytest.skip("the host has it all")


@pytest.mark.tonus_needs("luck")
def test_needs_what_is_unknown():
    pass


@pytest.mark.tonus(config="config/six.yaml", overrides={"tracker.rate_hz": 60.0})
def test_a_mark(tonus_lab):
    assert tonus_lab.config.robot.cables == 6
    assert tonus_lab.config.tracker.rate_hz == 60.0


@pytest.mark.tonus(overrides={"tracker.rate_hz": 60.0})
class TestMarksOfAClass:
    @pytest.mark.tonus(overrides={"tracker.latency_ms": 5.0})
    def test_a_mark_adds_to_that_of_its_class(self, tonus_lab):
        tracker = tonus_lab.config.tracker
        assert (tracker.rate_hz, tracker.latency_ms) == (60.0, 5.0)


@pytest.mark.tonus(configuration="config/six.yaml")
def test_a_mark_that_is_misspelt(tonus_lab):
    pass


def test_a_folder_of_its_own(tonus_lab):
    path = os.environ["TONUS_RUNTIME_DIR"]
    assert os.path.isdir(path)
    test_a_folder_of_its_own.path = path


def test_that_folder_is_gone():
    assert not os.path.exists(test_a_folder_of_its_own.path)
    assert "TONUS_RUNTIME_DIR" not in os.environ


def test_a_bound(tonus_measure):
    tonus_measure("count", 3, "1", at_most=2)
"""


SHARED = """\
import pytest

MADE = []


@pytest.fixture(scope="module")
def run(tonus_shared_run):
    MADE.append(tonus_shared_run("hold", duration=0.1))
    return MADE[-1]


def test_a_shared_run(run):
    assert run.state == "STANDBY"
    assert run.log.metadata["seed"] == "5"


def test_it_is_one(run, tonus_lab):
    assert MADE == [run]


def test_a_shared_run_that_is_not_as_expected(run):
    run.expect("drive_lost")
"""


class Session(NamedTuple):
    folder: Path
    text: str
    code: int
    cases: dict[str, ET.Element]
    """of the JUnit file, by name"""

    def failure(self, name: str) -> str:
        found = self.cases[name].find("failure")
        assert found is not None, name
        return found.text or ""


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("project")
    (folder / "pytest.ini").write_text(INI)
    quick = {"set": QUICK}
    shipped = (Path(__file__).parents[2] / "config" / "direct.yaml").read_text()
    shipped = re.sub(r"!include (\S+)", lambda m: f"!include {CONFIG / m[1]}", shipped)
    (folder / "quick.yaml").write_text(f"{shipped}\n{json.dumps(quick)[1:-1]}\n")
    (folder / "tests").mkdir()
    (folder / "tests" / "test_light.py").write_text(LIGHT)
    (folder / "tests" / "test_project.py").write_text(PROJECT)
    (folder / "tests" / "test_shared.py").write_text(SHARED)
    return folder


CONFIG = Path(__file__).resolve().parents[2] / "config"
GOLDEN = Path(__file__).parents[1] / "replay" / "golden" / f"v{SCHEMA_VERSION}.mcap"


@pytest.fixture(scope="module")
def session(project: Path) -> Session:
    text, code = pytest_in(project, "--junitxml=junit.xml", "--tonus-durations", "tests")
    root = ET.parse(project / "junit.xml").getroot()
    return Session(
        project, text, code, {each.attrib["name"]: each for each in root.iter("testcase")}
    )


@pytest.mark.wide
def test_what_should_pass_passes_and_nothing_else(session: Session) -> None:
    bad = {
        *("test_a_figure_out_of_bounds", "test_a_warning_that_nobody_expected"),
        *("test_a_held_run_that_its_test_did_not_end", "test_a_held_run_that_nobody_asked"),
        *("test_needs_what_is_unknown", "test_a_mark_that_is_misspelt", "test_a_bound"),
        "test_a_shared_run_that_is_not_as_expected",
    }
    failed = {
        name
        for name, case in session.cases.items()
        if case.find("failure") is not None or case.find("error") is not None
    }
    assert failed == bad, session.text
    assert {"test_seeds[seed5]", "test_seeds[seed6]"} <= session.cases.keys()


def test_a_failure_says_what_when_where_and_how_to_repeat_it(session: Session) -> None:
    text = session.failure("test_a_figure_out_of_bounds")
    assert re.search(r"tension\.measured\[\d\] in ACTIVE is .* N at 2\.\d{3} s, which is not", text)
    assert "the last events until then:" in text
    assert "state: HOLD to ACTIVE" in text
    assert "again: python -m pytest tests/test_project.py::test_a_figure_out_of_bounds" in text
    case = session.cases["test_a_figure_out_of_bounds"]
    paths = {p.attrib["name"]: Path(p.attrib["value"]) for p in case.iter("property")}
    assert paths.keys() == {"tonus_log", "tonus_summary", "tonus_report"}
    for path in paths.values():
        assert path.is_relative_to(session.folder / "tonus-out")
        assert path.stat().st_size > 0
        assert str(path) in text


@pytest.mark.wide
def test_the_command_gives_the_same_bytes(session: Session) -> None:
    text = session.failure("test_a_figure_out_of_bounds")
    (command,) = re.findall(r"again: python -m pytest (.*)", text)
    (log,) = (session.folder / "tonus-out").glob("*figure_out_of_bounds/run.mcap")
    before = log.read_bytes()
    log.unlink()
    again, code = pytest_in(session.folder, *command.split())
    assert code == 1
    assert log.read_bytes() == before
    figure = re.compile(r"tension\.measured\[\d\] in ACTIVE is .*")
    assert figure.findall(again)[0] == figure.findall(text)[0]


def test_what_is_kept_of_a_good_run(tmp_path: Path) -> None:
    case = Case(
        "tests/test_a.py::test_b[seed1]",
        file=tmp_path / "tests" / "test_a.py",
        root=tmp_path,
        invoked=tmp_path / "tests",
        out=tmp_path / "kept",
        config="config/can.yaml",
        overrides={},
        seed=1,
        options=["--tonus-seed=1"],
    )
    assert case.keep(failed=False) == []
    case.runs += [Run(open_log(GOLDEN)), Run(open_log(GOLDEN))]
    kept = case.keep(failed=False)
    folder = tmp_path / "kept" / "tests-test_a.py-test_b[seed1]"
    assert kept == [
        *(("log1", folder / "run1.mcap"), ("summary1", folder / "summary1.json")),
        *(("log2", folder / "run2.mcap"), ("summary2", folder / "summary2.json")),
    ]
    assert (folder / "run2.mcap").read_bytes() == GOLDEN.read_bytes()
    assert case.command(case.nodeid) == "python -m pytest --tonus-seed=1 'test_a.py::test_b[seed1]'"
    case.close()
    assert not case.runtime.exists()
    assert folder.exists()


def test_a_warning_fails_in_the_call_phase(session: Session) -> None:
    case = session.cases["test_a_warning_that_nobody_expected"]
    assert case.find("error") is None
    assert "tracker_lost" in session.failure(case.attrib["name"])


def test_a_held_run_is_kept_and_judged_at_the_end_of_its_test(session: Session) -> None:
    text = session.failure("test_a_held_run_that_its_test_did_not_end")
    assert "run.mcap" in text
    assert "report.html" in text
    assert "the last events:" not in text, "there was none"
    assert "cable_torn" in session.failure("test_a_held_run_that_nobody_asked")


def test_a_shared_run_is_kept_by_its_file_and_repeated_by_its_test(session: Session) -> None:
    name = "test_a_shared_run_that_is_not_as_expected"
    text = session.failure(name)
    assert "no event drive_lost" in text
    assert f"again: python -m pytest tests/test_shared.py::{name}" in text
    folder = session.folder / "tonus-out" / "tests-test_shared.py"
    assert {each.name for each in folder.iterdir()} == {"run.mcap", "summary.json", "report.html"}
    assert str(folder / "run.mcap") in text
    (cost,) = re.findall(r"^ +\S+ +\S+ +\S+  tests/test_shared.py.*$", session.text, re.MULTILINE)
    assert cost.endswith("::test_a_shared_run"), "it is that of the first one"


@pytest.mark.tonus(config="config/direct.yaml", overrides=QUICK)
@pytest.mark.tonus_expect("*")
def test_a_shared_run_is_judged_when_it_is_made(tonus_run: Player) -> None:
    """So that a warning is an error of every test that asks for it, whichever is the first."""
    shared = Player(tonus_run._case, ["stop_mode"])
    faults = [{"kind": "cable_cut", "axis": 2, "at": 1.0}]
    with pytest.raises(ExpectationError, match=r"unexpected warnings or errors .* cable_torn"):
        shared("hold", faults=faults)
    Player(tonus_run._case, ["*"])("hold", faults=faults)


def test_mistakes_in_marks_are_one_line(session: Session) -> None:
    for name, words in {
        "test_needs_what_is_unknown": "tonus_needs knows ethercat, realtime, root, kernel-can",
        "test_a_mark_that_is_misspelt": "tonus takes config= and overrides=",
    }.items():
        error = session.cases[name].find("error")
        assert error is not None
        assert words in (error.text or "")


def test_figures_and_costs_are_listed(session: Session) -> None:
    assert re.search(r"position error +\S+ mm  at most 5  tests/test_project.py", session.text)
    (count,) = session.cases["test_a_bound"].iter("property")
    assert (count.attrib["name"], count.attrib["value"]) == ("count [1]", "3")
    assert "count is 3 1, and at most 2 is allowed" in session.failure("test_a_bound")
    cost = r"^ +\d+\.\d\d +\d+\.\d\d +\d+\.\d\d  tests/test_project.py::test_a_run$"
    assert re.search(cost, session.text, re.MULTILINE)


def test_collecting_loads_nothing_of_tonus(project: Path) -> None:
    text, _ = pytest_in(project, "-q", "tests/test_light.py")
    assert "1 passed" in text, text


def test_the_module_itself_needs_pytest_alone() -> None:
    code = (
        "import sys, pytest; before = set(sys.modules); import tonus.pytest_plugin;"
        "print(sorted(set(sys.modules) - before))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['tonus', 'tonus.pytest_plugin']"


@pytest.mark.tonus(config="config/direct.yaml")
def test_what_a_failed_test_says_of_its_lab(tonus_lab_factory: LabFactory) -> None:
    lab = tonus_lab_factory()
    lab.advance(5)
    lab.fault("cell_offset", cell=2, force=30.0, at=0.1)
    lines = tonus_lab_factory._case.account(None, kept=False).splitlines()
    assert lines[0] == "a lab of seed 1, at 0.005 s of its time; its faults:"
    assert lines[1] == "      0.105 s  cell_offset cell=2 force=30.0"


def test_events_of_one_moment_are_one_line() -> None:
    """Of those of one name; ten lines of others stay in sight."""
    second, ms = 1_000_000_000, 1_000_000

    def event(name: str, at_ns: int, where: str = "") -> Event:
        return Event(at_ns, 1, Level.WARNING, name, where, f"{name} {where}")

    lost = event("drive_lost", second, "can0/1")
    twice = [event("duplicate_pdo", second + ms * i, f"can0/{i}") for i in range(9)]
    late = event("duplicate_pdo", second + 20 * ms, "can0/1")
    lines = Timeline(0).lines([lost, *twice, late], 10)
    assert [line.split("WARNING ")[1] for line in lines] == [
        "drive_lost: drive_lost can0/1",
        "duplicate_pdo: duplicate_pdo can0/0; 8 more",
        "duplicate_pdo: duplicate_pdo can0/1",
    ]
    assert Timeline(0).lines([lost, *twice, late], 1) == lines[2:]
