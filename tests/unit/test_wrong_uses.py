"""Wrong uses of the pytest plugin: each is told in one line, without a frame of Tonus."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import pytest

from tests.foreign import pytest_in
from tonus.config.loader import HERE
from tonus.runtime.signals import SCHEMA_VERSION

pytestmark = pytest.mark.wide

GOLDEN = Path(__file__).parents[1] / "replay" / "golden" / f"v{SCHEMA_VERSION}.mcap"


class Wrong(NamedTuple):
    name: str
    code: str
    """the body of a test with the fixture that it names"""
    said: str
    mark: str = ""


WRONG = (
    # runs
    Wrong("scenario", "tonus_run('hodl')", "scenario hodl: .* did you mean hold?"),
    Wrong("scenario_file", "tonus_run('own.yaml')", "there is no file 'own.yaml'; choose one of"),
    Wrong("scenario_type", "tonus_run(5)", "scenario: 5 is no name, path or Scenario"),
    Wrong("config", "tonus_run('hold', config='cna.yaml')", "did you mean config/can.yaml?"),
    Wrong("config_type", "tonus_run('hold', config=5)", "config: 5 is no name, path or Config"),
    Wrong("config_text", "tonus_run('hold', config='bad.yaml')", "bad.yaml:1: robt: is not a key"),
    Wrong(
        "override", "tonus_run('hold', overrides={'control.stifness.base': 1})", "mean stiffness?"
    ),
    Wrong("override_value", "tonus_run('hold', overrides={'robot.gravity': -1})", "larger value"),
    Wrong("override_type", "tonus_run('hold', overrides='robot')", "overrides: 'robot' is no dict"),
    Wrong(
        "override_loaded",
        "tonus_run('hold', config=tonus.load('can.yaml')[0], overrides={'robot.gravity': 9.8})",
        "overrides need the name of a configuration",
    ),
    Wrong("duration", "tonus_run('hold', duration=-1)", "duration: -1 is not possible"),
    Wrong("duration_nan", "tonus_run('hold', duration=float('nan'))", "duration: nan is not"),
    Wrong("duration_type", "tonus_run('hold', duration='1 s')", "duration: '1 s' is no number"),
    Wrong("seed", "tonus_run('hold', seed=-1)", "seed: -1 is not possible; .* from 0 on"),
    Wrong("seed_type", "tonus_run('hold', seed='x')", "seed: 'x' is no whole number"),
    Wrong("controller", "tonus_run('hold', controller='bioo')", "control.controller: .*'bio'"),
    Wrong("controller_class", "tonus_run('hold', controller='own:Mine')", "own:Mine"),
    Wrong("controller_type", "tonus_run('hold', controller=5)", "controller: 5 is no name or"),
    Wrong(
        "fault_kind", "tonus_run('hold', faults=[{'kind': 'cable_cutt', 'axis': 1}])",
        "fault cable_cutt: there is no such kind; did you mean cable_cut?",
    ),
    Wrong("fault_field", "tonus_run('hold', faults=[{'kind': 'cable_cut'}])", "axis: .*required"),
    Wrong("fault_axis", "tonus_run('hold', faults=[{'kind': 'cable_cut', 'axis': 9}])", "axis 9"),
    Wrong("fault_no_kind", "tonus_run('hold', faults=[{'axis': 1}])", "has no kind"),
    Wrong("fault_alone", "tonus_run('hold', faults={'kind': 'cable_cut'})", "faults: .* no list"),
    Wrong("fault_type", "tonus_run('hold', faults=['cable_cut'])", "'cable_cut' is no fault"),
    # labs
    Wrong("lab_fault", "tonus_lab.fault('unplog', channel='can0')", "did you mean unplug?"),
    Wrong("lab_fault_type", "tonus_lab.fault(5)", "5 is no fault"),
    Wrong("lab_node", "tonus_lab.fault('unplug', channel='can0', node=99)", "no node 99"),
    Wrong("lab_fault_at", "tonus_lab.fault('cable_cut', axis=1, at=-1)", "at: .*greater than"),
    Wrong("lab_bus", "tonus_lab.bus('can9')", "can9"),
    Wrong("lab_canopen", "tonus_lab.canopen('can9')", "can9"),
    Wrong("lab_back", "tonus_lab.advance(-1)", "advance: -1 is not possible"),
    Wrong("lab_advance_type", "tonus_lab.advance('1 s')", "advance: '1 s' is no number"),
    Wrong("factory_config", "tonus_lab_factory(config='none.yaml')", "there is no such file"),
    # held robots
    Wrong("held_state", "tonus_held(at='READY')", "at: 'READY' is not possible; HOLD or ACTIVE"),
    Wrong("held_scenario", "tonus_held('hodl')", "did you mean hold?"),
    Wrong("held_play", "tonus_held.play('hold', duration=0)", "duration: 0 is not possible"),
    # logs, daemons, figures
    Wrong("replay", "tonus_replay('nothing.mcap')", "nothing.mcap"),
    Wrong("replay_text", "tonus_replay('bad.yaml')", "bad.yaml"),
    Wrong("daemon_config", "tonus_daemon(config='none.yaml')", "there is no such file"),
    Wrong("daemon_scenario", "tonus_daemon('hodl')", "did you mean hold?"),
    Wrong("measure", "tonus_measure('a', 'b', 'm')", "a: 'b' is no number"),
    # questions
    Wrong("event", "tonus_replay(GOLDEN).expect('cable_tron')", "did you mean cable_torn?"),
    Wrong("event_type", "tonus_replay(GOLDEN).expect(5)", "event: 5 is no text"),
    Wrong("where", "tonus_replay(GOLDEN).expect('state', where=3)", "where: 3 is no text"),
    Wrong("within", "tonus_replay(GOLDEN).expect('state', within=-1)", "within: -1 is not"),
    Wrong("never", "tonus_replay(GOLDEN).never('cable_tron')", "did you mean cable_torn?"),
    Wrong("allow", "tonus_replay(GOLDEN).allow('cable_tron')", "did you mean cable_torn?"),
    Wrong("topic", "tonus_replay(GOLDEN).signal('tensions', 'measured')", "mean /tonus/tension?"),
    Wrong("field", "tonus_replay(GOLDEN).signal('tension', 'measurd')", "did you mean measured?"),
    Wrong(
        "state", "tonus_replay(GOLDEN).signal('tension', 'measured').during('ACTVE')",
        "there is no state 'ACTVE'; did you mean ACTIVE?",
    ),
    Wrong(
        "element", "tonus_replay(GOLDEN).signal('tension', 'measured')[8]",
        "tension.measured has no element 8; choose one from 0 to 7",
    ),
    Wrong(
        "interval", "tonus_replay(GOLDEN).signal('tension', 'measured').stays(2, 1)", "low <= high"
    ),
    Wrong("reading", "tonus_replay(GOLDEN).signal('tension', 'measured').rms(at_most='x')", "'x'"),
    # marks
    Wrong("mark_config", "tonus_lab", "nofile", "tonus(config='nofile.yaml')"),
    Wrong("mark_config_type", "tonus_lab", "config: 5 is no name", "tonus(config=5)"),
    Wrong("mark_key", "tonus_lab", "takes config= and overrides=", "tonus(configuration='a')"),
    Wrong("mark_positional", "tonus_lab", "takes config= and overrides=", "tonus('can.yaml')"),
    Wrong("mark_overrides", "tonus_lab", "overrides: 5 is no dict", "tonus(overrides=5)"),
    Wrong("mark_override", "tonus_lab", "mean control?", "tonus(overrides={'contrl.x': 1})"),
    Wrong("mark_needs", "tonus_lab", "not 'luck'", "tonus_needs('luck')"),
    Wrong("mark_needs_type", "tonus_lab", "not 5", "tonus_needs(5)"),
    Wrong("mark_needs_nothing", "tonus_lab", "tonus_needs knows .*; name one", "tonus_needs()"),
    Wrong(
        "mark_expect", "tonus_held().advance(1)", "no event is named cable_tron",
        "tonus_expect('cable_tron')",
    ),
    Wrong("mark_expect_type", "tonus_held().advance(1)", "event: 5 is no text", "tonus_expect(5)"),
)  # fmt: skip
SEEDS = ("'x'", "0", "-1", "", "2, 3", "True", "n=2", "1.5")
"""arguments that the mark tonus_seeds does not take"""
OURS = re.compile(
    rf"^(?:{re.escape(str(HERE.parent))}|\S*/tonus|\S*(?:tools|config)/)\S*\.py:\d", re.MULTILINE
)


def _test(wrong: Wrong) -> str:
    found = re.search(r"tonus_\w+", wrong.code)
    assert found is not None
    mark = f"@pytest.mark.{wrong.mark}\n" if wrong.mark else ""
    return f"{mark}def test_{wrong.name}({found[0]}):\n    {wrong.code}\n\n"


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, ET.Element]:
    folder = tmp_path_factory.mktemp("wrong")
    head = f"import pytest\nimport tonus\n\nGOLDEN = {str(GOLDEN)!r}\n\n"
    (folder / "pytest.ini").write_text("[pytest]\n")
    (folder / "test_wrong.py").write_text(head + "".join(map(_test, WRONG)))
    (folder / "bad.yaml").write_text("robt: {}\n")
    text, code = pytest_in(folder, "-q", "--junitxml=junit.xml", "test_wrong.py")
    assert code == 1, text
    assert "INTERNALERROR" not in text
    root = ET.parse(folder / "junit.xml").getroot()  # written by pytest
    return {each.attrib["name"]: each for each in root.iter("testcase")}


@pytest.mark.parametrize("wrong", WRONG, ids=lambda each: each.name)
def test_a_wrong_use_is_one_line(cases: dict[str, ET.Element], wrong: Wrong) -> None:
    case = cases[f"test_{wrong.name}"]
    told = [each for tag in ("failure", "error") for each in case.findall(tag)]
    assert told, "it was accepted"
    text = told[0].text or ""
    lines = [line for line in text.splitlines() if re.search(wrong.said.replace("?", r"\?"), line)]
    assert lines, text
    assert not OURS.findall(text), text
    assert "The above exception" not in text
    assert len(re.findall(r"^E  ", text, re.MULTILINE)) <= 1, text


def test_wrong_seeds_are_one_line_each(tmp_path: Path) -> None:
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    for number, seeds in enumerate(SEEDS):
        body = "def test_seeds(tonus_seed):\n    pass\n"
        mark = f"import pytest\n\n@pytest.mark.tonus_seeds({seeds})\n"
        (tmp_path / f"test_{number}.py").write_text(mark + body)
    text, code = pytest_in(tmp_path, "-q", "--co")
    assert code == 2, text
    told = re.findall(
        r"^test_(\d)\.py::test_seeds: tonus_seeds takes one whole", text, re.MULTILINE
    )
    assert told == [str(number) for number in range(len(SEEDS))], text
    assert ".py:" not in re.sub(r"test_\d\.py:", "", text), text


@pytest.mark.parametrize(
    ("ini", "option", "said"),
    [
        ("tonus_keep = some", "", "tonus_keep: 'some' is not possible; choose failed, all or none"),
        ("tonus_seed = -1", "", "tonus_seed: '-1' is not possible; choose a whole number from 0"),
        ("", "--tonus-keep=", "tonus_keep: '' is not possible"),
        ("", "--tonus-seed=1.5", "tonus_seed: '1.5' is not possible"),
        ("tonus_out = pytest.ini", "", "tonus_out: .*pytest.ini is no folder; choose another"),
        ("", "--tonus-out=/dev/null/x", "tonus_out: /dev/null is no folder; choose another"),
        ("tonus_config = nothing.yaml", "", "nothing.yaml: there is no such file"),
        ("", "--tonus-config=cna.yaml", "did you mean config/can.yaml?"),
    ],
)
def test_a_wrong_setting_is_one_line(tmp_path: Path, ini: str, option: str, said: str) -> None:
    (tmp_path / "pytest.ini").write_text(f"[pytest]\n{ini}\n")
    body = "def test_lab(tonus_lab):\n    assert not tonus_lab\n"
    (tmp_path / "test_own.py").write_text(body)
    text, code = pytest_in(tmp_path, "-q", *([option] if option else []))
    assert code in (1, 4), text
    assert re.search(said.replace("?", r"\?"), text), text
    assert not OURS.findall(text), text
    assert "INTERNALERROR" not in text
