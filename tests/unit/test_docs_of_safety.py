"""Hazards, controls, requirements, failures and tests agree both ways; the pages are those that
docs/safety and the lock file print."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from tonus.config.errors import ConfigError
from tonus.config.schema.supervisor import REQUIREMENT_TEXTS
from tonus.tools.errors import ToolError
from tonus.tools.safety.__main__ import PAGES, main
from tonus.tools.safety.budget import seconds, shown
from tonus.tools.safety.checks import findings
from tonus.tools.safety.node_ids import collect_tests
from tonus.tools.safety.source import ROOT, load_evidence
from tonus.tools.safety.third_party import licence, locked, page, uses

LEAST_ROWS = 80


def test_everything_agrees_both_ways() -> None:
    found = findings(load_evidence(), collect_tests(ROOT / "tests"))
    assert not found, "\n".join(found)


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_the_one_that_its_source_prints(name: str) -> None:
    written = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    printed = PAGES[name](load_evidence())
    assert written == printed, f"python -m tonus.tools.safety {name} > docs/{name}.md"


def test_every_part_has_its_failures() -> None:
    evidence = load_evidence()
    assert len(list(evidence.rows)) >= LEAST_ROWS
    parts = " ".join(evidence.failures).lower()
    for part in ("drive", "encoder", "cell", "tracker", "cable", "drum", "can", "ethercat"):
        assert part in parts
    for part in ("power", "host", "clock", "process", "disk", "person", "configuration"):
        assert part in parts


# --- what the checks find ------------------------------------------------------------------------

WHOLE = """
safety_path: {files: [test_stop.py]}
hazards:
  HAZ-1: {hazard: motion, harm: hit, situations: {SIT-1: too fast}, controls: [RC-1], residual: low}
controls:
  RC-1: {control: a stop, kind: protective, requirements: [REQ-1]}
requirements:
  REQ-1: {text: it stops, tests: {test_stop.py: [test_it_stops]}}
failures:
  Drives:
    - {id: FM-1, failure: silent, effect: none, noticed: "`DRIVE_LOST`", reaction: stop,
       state: SAFE_STOP, within: 2 ticks, leads_to: [SIT-1], requirements: [REQ-1], residual: low,
       tests: {test_stop.py: [test_it_stops]}}
"""
TESTS = {"test_stop.py": ["test_it_stops"]}


def found(folder: Path, text: str, tests: dict[str, list[str]] = TESTS) -> list[str]:
    """But for the events that the small source above has no row for."""
    (folder / "all.yaml").write_text(text, encoding="utf-8")
    return [
        line for line in findings(load_evidence(folder), tests) if "has no row; name" not in line
    ]


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("{test_stop.py: [test_it_stops]}}\nfailures", "{}}\nfailures", "REQ-1 has no test"),
        ("[test_it_stops]}}\nf", "[test_it_stop]}}\nf", "did you mean test_it_stops?"),
        ("{test_stop.py: [test_it_stops]}}\nf", "{test_stp.py: [a]}}\nf", "no file test_stp.py"),
        ("controls: [RC-1]", "controls: []", "HAZ-1 has no control"),
        ("controls: [RC-1]", "controls: [RC-2]", "HAZ-1: there is no RC-2"),
        ("requirements: [REQ-1]}\nreq", "requirements: []}\nreq", "RC-1 has no requirement"),
        ("requirements: [REQ-1]}\nreq", "requirements: []}\nreq", "REQ-1 belongs to no control"),
        ("leads_to: [SIT-1]", "leads_to: [SIT-2]", "FM-1: there is no SIT-2"),
        ("leads_to: [SIT-1]", "leads_to: [SIT-2]", "SIT-1 has no failure that leads to it"),
        ("`DRIVE_LOST`", "`DRIVE_LOT`", "FM-1: there is no DRIVE_LOT; did you mean DRIVE_LOST?"),
        ("within: 2 ticks", "within: control.stp_s", "FM-1: within: control.stp_s: there is no"),
        ("files: [test_stop.py]", "files: [test_stops.py]", "there is no file test_stops.py"),
    ],
)
def test_each_check_finds_what_it_is_for(old: str, new: str, line: str, tmp_path: Path) -> None:
    assert not found(tmp_path, WHOLE)
    assert WHOLE.count(old) == 1
    lines = found(tmp_path, WHOLE.replace(old, new))
    assert any(line in each for each in lines), lines
    assert all("\n" not in each for each in lines)


def test_a_test_of_the_safety_path_without_requirement_is_found(tmp_path: Path) -> None:
    (line,) = found(tmp_path, WHOLE, {"test_stop.py": ["test_it_stops", "test_new"]})
    assert line.startswith("test_stop.py::test_new belongs to no requirement")


def test_an_event_without_a_row_is_found(tmp_path: Path) -> None:
    (tmp_path / "all.yaml").write_text(WHOLE, encoding="utf-8")
    lines = findings(load_evidence(tmp_path), TESTS)
    assert any(line.startswith("CABLE_TORN has no row") for line in lines)
    assert not any(line.startswith("DRIVE_LOST has no row") for line in lines)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("leads_to: [SIT-1]", "leads_to: []", "leads_to"),
        ("within: 2 ticks", "when: after 2 ms", "a figure in when"),
        ("within: 2 ticks, ", "", "either within or when"),
        ("state: SAFE_STOP", "state: STOPPED", "there is no state"),
        (
            "residual: low,\n       tests",
            "residual: low, open: none,\n       tests",
            "either tests",
        ),
        ("id: FM-1", "id: FMEA-1", "id"),
    ],
)
def test_a_row_that_is_not_whole_is_refused_in_one_line(
    old: str, new: str, problem: str, tmp_path: Path
) -> None:
    assert WHOLE.count(old) == 1
    with pytest.raises(ConfigError, match=problem) as refusal:
        found(tmp_path, WHOLE.replace(old, new))
    assert "all.yaml:" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_further_file_adds_its_part_and_an_id_belongs_to_one_file(tmp_path: Path) -> None:
    more = {"requirements": {"SUP-1": {"text": "it is silent", "tests": {"test_stop.py": ["a"]}}}}
    (tmp_path / "more.yaml").write_text(yaml.safe_dump(more), encoding="utf-8")
    lines = found(tmp_path, WHOLE, {"test_stop.py": ["test_it_stops", "a"]})
    assert lines == ["SUP-1 belongs to no control; name it in a control's requirements"]
    (tmp_path / "again.yaml").write_text(yaml.safe_dump(more), encoding="utf-8")
    with pytest.raises(ToolError, match="SUP-1 is in another file already"):
        load_evidence(tmp_path)


def test_tests_are_found_in_syntax_trees_alone(tmp_path: Path) -> None:
    (tmp_path / "test_any.py").write_text(
        "import no_such_module\n"
        "def test_one(): ...\n"
        "async def test_two(): ...\n"
        "def helper(): ...\n"
        "class TestThree:\n"
        "    def test_it(self): ...\n"
        "TestFour = Machine.TestCase\n"
    )
    names = ["test_one", "test_two", "TestThree::test_it", "TestFour"]
    assert collect_tests(tmp_path) == {"test_any.py": names}


def test_a_time_is_the_sum_of_its_keys() -> None:
    assert seconds("control.freshness.stale_stop_ticks + 1 tick") == pytest.approx(0.026)
    assert seconds("timeouts.master") == pytest.approx(0.1)
    assert seconds("bounds.found_within.cable_cut") == pytest.approx(0.005)
    assert shown("2 ticks") == "2 ms"
    assert shown("tracker.maximum_age_ms") == "100 ms (`tracker.maximum_age_ms`)"
    for wrong in ("control.tension.max", "control.nothing_s", "0.1 s"):
        with pytest.raises(ToolError):
            seconds(wrong)


@pytest.mark.parametrize("arguments", [[], ["nothing"], ["fmea", "hazards"]])
def test_a_wrong_use_is_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert capsys.readouterr().err.startswith("usage: ")


# --- pages for users, and third-party software ----------------------------------------------------


def test_the_pages_for_users_state_the_limits() -> None:
    use = " ".join((ROOT / "docs" / "intended_use.md").read_text(encoding="utf-8").split())
    for stated in (
        "Tonus claims conformity with no standard",
        "wired emergency stop that disconnects the drives' power",
        "no sensor of Tonus detects a person",
        "lock of the supply for work at drums",
        "## Foreseeable misuse",
    ):
        assert stated in use
    for name in (*PAGES, "intended_use"):
        text = " ".join((ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8").split())
        assert "claims conformity with no" in text, name


def test_third_party_software_is_that_of_the_lock_file() -> None:
    lock = locked((ROOT / "requirements.lock").read_text(encoding="utf-8"))
    assert len(lock) > 100
    rows = page().split("## Packages")[1]
    listed = {
        cells[1].strip(): cells[2].strip()
        for line in rows.splitlines()
        if line.startswith("| ") and (cells := line.split("|"))[1].strip() != "package"
    }
    assert listed == lock


def test_a_use_is_the_first_that_leads_to_a_package() -> None:
    used = uses(ROOT / "pyproject.toml", ["numpy", "llvmlite", "pysoem", "pytest", "ruff", "wheel"])
    assert used == {
        "numpy": "runtime",
        "llvmlite": "runtime",
        "pysoem": "ethercat",
        "pytest": "test",
        "ruff": "dev",
        "wheel": "dev",
    }


def test_a_licence_is_as_the_package_states_it() -> None:
    assert licence("numpy").startswith("BSD-3-Clause")
    with pytest.raises(ToolError, match="run make setup"):
        licence("no-such-package")


def test_the_supervisors_requirements_are_in_the_codes_words() -> None:
    written = {name: each.text for name, each in load_evidence().requirements.items()}
    for requirement, text in REQUIREMENT_TEXTS.items():
        assert written[f"SUP-{requirement:d}"] == text
