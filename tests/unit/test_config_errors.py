"""Every mistake in a configuration is one line: file, line, key, rule and remedy."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from tonus.config import ConfigError, load
from tonus.config.loader import HERE, load_scenario

CONFIG = "can.yaml"
ROBOT = "robots/paper.yaml"
CONTROL = "control.yaml"
BUS = "buses/can4.yaml"
REALTIME = "realtime.yaml"
DRIVE = "drives/epos4.yaml"
LOWER = """\
    - [ 0.75,  0.75, -0.55]
    - [-0.75,  0.75, -0.55]
    - [-0.75, -0.75, -0.55]
    - [ 0.75, -0.75, -0.55]
"""
"""The paper's lower frame anchors."""


@dataclass(frozen=True)
class Edit:
    """Replace one text of a file, which must be there."""

    file: str
    old: str
    new: str

    def __call__(self, folder: Path) -> None:
        path = folder / self.file
        text = path.read_text(encoding="utf-8")
        assert self.old in text
        path.write_text(text.replace(self.old, self.new, 1), encoding="utf-8")


@dataclass(frozen=True)
class Write:
    """A whole file."""

    file: str
    content: bytes

    def __call__(self, folder: Path) -> None:
        (folder / self.file).write_bytes(self.content)


@dataclass(frozen=True)
class Broken:
    """One mistake and what its line must say; ``at`` is the text on the line to be named, or a
    line number."""

    name: str
    edit: Callable[[Path], None]
    file: str
    at: str | int
    key: str
    problem: str
    remedy: str


def remove(folder: Path) -> None:
    (folder / ROBOT).unlink()


def make_directory(folder: Path) -> None:
    (folder / CONFIG).unlink()
    (folder / CONFIG).mkdir()


def axes(text: str) -> Edit:
    """The robot with ``axes`` in one line."""
    return Edit(ROBOT, "gravity: 9.80665", f"gravity: 9.80665\naxes: {{{text}}}")


CASES = [
    Broken(
        "policy", Edit(REALTIME, "spin_us: 30", "spin_us: 30\npolicy: demand"), REALTIME,
        "policy:", "realtime.policy", "'require', 'prefer' or 'off'", "choose one of these",
    ),
    Broken(
        "spins longer than awake", Edit(REALTIME, "spin_us: 30", "spin_us: 300"), REALTIME, 3,
        "realtime", "spin_us must not be longer than early_wake_us", "change one of the values",
    ),
    Broken(
        "unknown key", Edit(ROBOT, "  mass: 2.35", "  mas: 2.35"), ROBOT, "mas:",
        "robot.platform.mas", "is not a key here", "did you mean mass?",
    ),
    Broken(
        "unknown key of an include",
        Edit(CONFIG, "tracker: !include tracker.yaml", "traker: !include tracker.yaml"), CONFIG,
        "traker:", "traker", "is not a key here", "did you mean tracker?",
    ),
    Broken(
        "an include given twice",
        Edit(CONFIG, "scenario:", "tracker: !include tracker.yaml\nscenario:"), CONFIG,
        12, "tracker", "given twice, first on line 5", "keep one of the two",
    ),
    Broken(
        "misspelt optional key", Edit(ROBOT, "  mass: 2.35", "  mass: 2.35\n  inertai: 1"), ROBOT,
        "inertai", "robot.platform.inertai", "is not a key here", "did you mean inertia?",
    ),
    Broken(
        "key of another bus", Edit(BUS, "load_limit: 0.85", "load_limit: 0.85\nload_limits: 1"),
        BUS, "load_limits", "fieldbus.load_limits", "is not a key here",
        "did you mean load_limit?",
    ),
    Broken(
        "missing key", Edit(ROBOT, "gravity: 9.80665\n", ""), ROBOT, 2, "robot.gravity",
        "is missing", "add it",
    ),
    Broken(
        "missing section", Edit(CONFIG, "tracker: !include tracker.yaml\n", ""), CONFIG, 2,
        "tracker", "is missing", "add it",
    ),
    Broken(
        "wrong type", Edit(ROBOT, "mass: 2.35", "mass: heavy"), ROBOT, "mass",
        "robot.platform.mass", "should be a number", "'heavy'",
    ),
    Broken(
        "a boolean for a number", Edit(ROBOT, "mass: 2.35", "mass: yes"), ROBOT, "mass",
        "robot.platform.mass", "must be a number, not true", "YAML takes yes, no, on",
    ),
    Broken(
        "a section for a number", Edit(ROBOT, "mass: 2.35", "mass: {value: 1}"), ROBOT, "mass",
        "robot.platform.mass", "should be a number", "give a value of that type",
    ),
    Broken(
        "an empty section", Edit(CONFIG, "robot: !include robots/paper.yaml", "robot:"), CONFIG,
        "robot", "robot", "should be a mapping, not null", "write its keys below it",
    ),
    Broken(
        "negative mass", Edit(ROBOT, "mass: 2.35", "mass: -2.35"), ROBOT, "mass",
        "robot.platform.mass", "should be greater than 0, not -2.35", "choose a larger value",
    ),
    Broken(
        "not a number", Edit(ROBOT, "efficiency: 0.80", "efficiency: .nan"), ROBOT, "efficiency",
        "robot.gearbox.efficiency", "not nan", "give a finite number",
    ),
    Broken(
        "infinite", Edit(ROBOT, "radius: 0.020", "radius: .inf"), ROBOT, "radius",
        "robot.drum.radius", "should be a finite number, not inf", "give a finite number",
    ),
    Broken(
        "infinite space", Edit(ROBOT, "x: [-0.25, 0.25]", "x: [-.inf, 0.25]"), ROBOT, "x: [-.inf",
        "robot.workspace.x.0", "should be a finite number", "give a finite number",
    ),
    Broken(
        "two numbers for a point", Edit(ROBOT, "home: [0.0, 0.0, 0.0]", "home: [0.0, 0.0]"), ROBOT,
        "home", "robot.home.2", "is missing", "add it",
    ),
    Broken(
        "an anchor too few", Edit(ROBOT, "    - [ 0.75, -0.75, -0.55]\n", ""), ROBOT, "geometry:",
        "robot.geometry", "frame has 7 anchors, platform 8", "give both one for each cable",
    ),
    Broken(
        "four cables", Edit(ROBOT, LOWER, ""), ROBOT, "frame",
        "robot.geometry.frame", "has 4 items, and takes at least 6", "give the missing items",
    ),
    Broken(
        "duplicate key", Edit(ROBOT, "  mass: 2.35", "  mass: 2.35\n  mass: 2.4"), ROBOT,
        "mass: 2.4", "robot.platform.mass", "given twice, first on line 5", "keep one of the two",
    ),
    Broken(
        "bad syntax", Edit(ROBOT, "rest: [0.0, 0.0, -0.10]", "rest: [0.0, 0.0, -0.10"), ROBOT, 53,
        "", "not valid YAML: expected ',' or ']'", "correct the syntax there",
    ),
    Broken(
        "tab", Edit(ROBOT, "  mass: 2.35", "\tmass: 2.35"), ROBOT, "mass", "", "not valid YAML",
        "correct the syntax there",
    ),
    Broken(
        "alias", Edit(ROBOT, "home: [0.0, 0.0, 0.0]", "home: &a [*a]"), ROBOT, "home", "",
        "aliases (*) are not used here", "correct the syntax there",
    ),
    Broken(
        "control character", Edit(ROBOT, "name: paper", "name: pa\x07per"), ROBOT, "name", "",
        "holds the character '\\x07'", "remove it",
    ),
    Broken(
        "nesting", Edit(ROBOT, "home: [0.0, 0.0, 0.0]", "home: " + "[" * 3000), ROBOT, 0, "",
        "is nested too deeply", "flatten it",
    ),
    Broken(
        "impossible escape", Edit(ROBOT, "name: paper", r'name: "\UFFFFFFFF"'), ROBOT, 0, "",
        "not valid YAML", "correct the syntax",
    ),
    Broken(
        "second document", Edit(ROBOT, "platform:", "---\nplatform:"), ROBOT, "---", "",
        "not valid YAML: but found another document", "correct the syntax there",
    ),
    Broken(
        "unknown tag", Edit(ROBOT, "mass: 2.35", "mass: !kg 2.35"), ROBOT, "mass",
        "robot.platform.mass", "of kind !kg", "!include",
    ),
    Broken(
        "a tag on a mapping",
        Edit(CONFIG, "!include tracker.yaml", "!!python/object:os.system {}"), CONFIG, "tracker:",
        "tracker", "of kind python/object:os.system", "remove the tag",
    ),
    Broken(
        "a tag on a list", Edit(ROBOT, "home: [", "home: !point ["), ROBOT, "home:", "robot.home",
        "of kind !point", "remove the tag",
    ),
    Broken(
        "impossible date", Edit(ROBOT, "name: paper", "name: 2026-13-45"), ROBOT, "name",
        "robot.name", "of kind timestamp", "text in quotes",
    ),
    Broken(
        "impossible number", Edit(ROBOT, "mass: 2.35", "mass: 0x_"), ROBOT, "mass",
        "robot.platform.mass", "'0x_' cannot be read as int", "correct the value",
    ),
    Broken(
        "a number as key", Edit(ROBOT, "gravity: 9.80665", "gravity: 9.80665\n7: 8"), ROBOT, "7: 8",
        "robot.7", "is not a key here", "remove it",
    ),
    Broken(
        "a fraction as key", Edit(ROBOT, "gravity: 9.80665", "gravity: 9.80665\n.5: 8"), ROBOT,
        ".5: 8", "robot", "'.5' is no key", "a key is a plain word or a number",
    ),
    Broken(
        "a word for a processor", Edit(REALTIME, "daemon_cpu: quietest", "daemon_cpu: fast"),
        REALTIME, "daemon_cpu:", "realtime.daemon_cpu",
        "input should be a whole number >= 0 or quietest, not 'fast'", "give a value of that type",
    ),
    Broken(
        "an axis that is not there", axes("8: {drum: {radius: 0.03}}"), ROBOT, "8: {",
        "robot.axes.8", "there is no axis 8", "axes are numbered 0 to 7",
    ),
    Broken(
        "an axis by a name", axes("upper: {drum: {radius: 0.03}}"), ROBOT, "upper: {",
        "robot.axes.upper", "there is no axis upper", "axes are numbered from 0",
    ),
    Broken(
        "an axis in a second spelling", axes("4: {}, 04: {}"), ROBOT, "04: {}",
        "robot.axes.04", "there is no axis 04", "axes are numbered from 0",
    ),
    Broken(
        "an axis twice", axes("4: {}, 4: {}"), ROBOT, "4: {}, 4: {}",
        "robot.axes.4", "given twice", "keep one of the two",
    ),
    Broken(
        "a list of axes", Edit(ROBOT, "gravity: 9.80665", "gravity: 9.80665\naxes: [4]"), ROBOT,
        "axes: [4]", "robot.axes", "should be a mapping", "give a value of that type",
    ),
    Broken(
        "an empty axis", axes("4: "), ROBOT, "4: }", "robot.axes.4",
        "should be a mapping", "write its keys below it",
    ),
    Broken(
        "an axis' misspelt section", axes("4: {drums: {radius: 0.03}}"), ROBOT, "drums",
        "robot.axes.4.drums", "is not a key here", "did you mean drum?",
    ),
    Broken(
        "an axis' misspelt value", axes("4: {drum: {radios: 0.03}}"), ROBOT, "radios",
        "robot.axes.4.drum.radios", "is not a key here", "did you mean radius?",
    ),
    Broken(
        "an axis' negative radius", axes("4: {drum: {radius: -0.03}}"), ROBOT, "-0.03",
        "robot.axes.4.drum.radius", "should be greater than 0, not -0.03", "choose a larger value",
    ),
    Broken(
        "an axis' value left out", axes("4: {drum: {radius: }}"), ROBOT, "radius: }",
        "robot.axes.4.drum.radius", "has no value", "remove the key to keep the default",
    ),
    Broken(
        "an axis' efficiency above one", axes("4: {gearbox: {efficiency: 1.2}}"), ROBOT, "1.2",
        "robot.axes.4.gearbox.efficiency", "less than or equal to 1, not 1.2", "choose a smaller",
    ),
    Broken(
        "an axis without a way to turn", axes("4: {sign: 0}"), ROBOT, "sign: 0",
        "robot.axes.4.sign", "should be 1 or -1, not 0", "choose one of these",
    ),
    Broken(
        "an axis that turns yes", axes("4: {sign: yes}"), ROBOT, "sign: yes",
        "robot.axes.4.sign", "must be a number, not true", "YAML takes yes, no, on",
    ),
    Broken(
        "an axis with half a pulse", axes("4: {motor: {encoder_pulses: 0.5}}"), ROBOT, "0.5",
        "robot.axes.4.motor.encoder_pulses", "should be a whole number", "give a value",
    ),
    Broken(
        "a list as key", Edit(ROBOT, "gravity: 9.80665", "gravity: 9.80665\n[a, b]: 8"), ROBOT,
        "[a, b]", "robot", "a list or mapping is no key", "a key is a plain word",
    ),
    Broken(
        "list on top", Write(CONFIG, b"- name: can\n- robot: 1\n"), CONFIG, 1, "",
        "should be a mapping", "give a value of that type",
    ),
    Broken(
        "scalar on top", Write(CONFIG, b"can\n"), CONFIG, 1, "", "should be a mapping",
        "give a value of that type",
    ),
    Broken(
        "missing include", remove, CONFIG, "robot:", "robot", "!include robots/paper.yaml",
        "looked for it at",
    ),
    Broken(
        "include of a directory", Edit(CONFIG, "!include robots/paper.yaml", "!include robots"),
        CONFIG, "robot:", "robot", "!include robots: is a directory", "name a file in it",
    ),
    Broken(
        "include of a device", Edit(CONFIG, "!include robots/paper.yaml", "!include /dev/null"),
        CONFIG, "robot:", "robot", "!include /dev/null: is a device or a pipe", "/dev/null",
    ),
    Broken(
        "include of a list", Edit(CONFIG, "!include robots/paper.yaml", "!include [a]"), CONFIG,
        "robot:", "robot", "!include takes one file name", "write !include other.yaml",
    ),
    Broken(
        "circular include", Edit(CONTROL, "controller: bio", "controller: !include can.yaml"),
        CONTROL, "controller", "control.controller", "that file includes this one",
        "break the circle",
    ),
    Broken(
        "includes itself", Edit(CONFIG, "!include robots/paper.yaml", "!include can.yaml"), CONFIG,
        "robot:", "robot", "that file includes this one", "break the circle",
    ),
    Broken(
        "unknown controller", Edit(CONTROL, "controller: bio", "controller: boi"), CONTROL,
        "controller", "control.controller", "should be 'bio'", "choose one of these",
    ),
    Broken(
        "a value set that is not there",
        Edit(CONFIG, "scenario:", "set: {control.no: 1}\nscenario:"),
        CONFIG, "set:", "control.no", "is not a key here", "",
    ),
    Broken(
        "a value set below nothing", Edit(CONFIG, "scenario:", "set: {contrl.pid: 1}\nscenario:"),
        CONFIG, "set:", "contrl", "is not there, so contrl.pid cannot be set",
        "did you mean control?",
    ),
    Broken(
        "a value set out of range",
        Edit(CONFIG, "scenario:", "set: {robot.gravity: -1}\nscenario:"), CONFIG, "set:",
        "robot.gravity", "greater than 0, not -1", "choose a larger value",
    ),
    Broken(
        "changes as a list", Edit(CONFIG, "scenario:", "set: [1]\nscenario:"), CONFIG, "set:",
        "set", "is no mapping", "write key: value below it",
    ),
    Broken(
        "two nodes for one axis", Edit(BUS, "{axis: 1,", "{axis: 0,"), BUS, "channels",
        "fieldbus.channels", "axis 0 has more than one node", "give it one",
    ),
    Broken(
        "missing axis", Edit(BUS, ", {axis: 7, node_id: 8}", ""), BUS, "channels",
        "fieldbus.channels", "no node for axis 7", "add one",
    ),
    Broken(
        "a drive of an axis that is not there", Edit(BUS, "{axis: 7,", "{axis: 8,"), BUS, "axis: 8",
        "fieldbus.channels.3.drives.1.axis", "there is no axis 8", "axes are numbered 0 to 7",
    ),
    Broken(
        "a cell that is not there", Edit(BUS, "{cell: 8,", "{cell: 9,"), BUS, "cell: 9",
        "fieldbus.channels.3.force_cells.2", "there is no cell 9", "cells are numbered 0 to 8",
    ),
    Broken(
        "an offset too few", Edit(CONTROL, "tare: null", "tare: [0, 0, 0, 0, 0, 0, 0, 0]"), CONTROL,
        "tare: [", "control.sequence.tare", "states 8 offsets, the robot has 9 cells",
        "give one for each",
    ),
    Broken(
        "missing contact cell", Edit(BUS, ", {cell: 8, node_id: 25}", ""), BUS, "channels",
        "fieldbus.channels", "no node for cell 8", "add one",
    ),
    Broken(
        "node id out of range", Edit(BUS, "node_id: 24", "node_id: 128"), BUS, "cell: 7",
        "fieldbus.channels.3.force_cells.1.node_id", "less than or equal to 127, not 128",
        "choose a smaller value",
    ),
    Broken(
        "tensions out of order", Edit(CONTROL, "min: 20.25", "min: 50.0"), CONTROL, "tension:",
        "control.tension", "slack < min < pre < max must hold, not 5.0 < 50.0 < 45.0 < 200.0",
        "change one of the values",
    ),
    Broken(
        "stiffness out of order", Edit(CONTROL, "maximum: 4879.2", "maximum: 100.0"), CONTROL,
        "stiffness:", "control.stiffness", "minimum < base <= maximum must hold",
        "change one of the values",
    ),
    Broken(
        "workspace inside out", Edit(ROBOT, "x: [-0.25, 0.25]", "x: [0.25, -0.25]"), ROBOT,
        "workspace", "robot.workspace", "x must run from low to high", "change one of the values",
    ),
    Broken(
        "unknown fieldbus", Edit(BUS, "kind: canopen", "kind: profibus"), BUS, "kind:",
        "fieldbus.kind", "there is no 'profibus'", "choose one of 'canopen', 'direct'",
    ),
    Broken(
        "fieldbus without a kind", Edit(BUS, "kind: canopen\n", ""), BUS, 3, "fieldbus",
        "has no 'kind'", "add it",
    ),
    Broken(
        "mapping too long", Edit(DRIVE, "0x60770010]", "0x60770010, 0x60640020]"), DRIVE, 2,
        "fieldbus.drive", "tpdo maps 96 bits, a CAN frame carries 64", "map fewer objects",
    ),
    Broken("empty file", Write(ROBOT, b""), ROBOT, 1, "", "is empty", "see docs/configuration.md"),
    Broken("only a comment", Write(CONFIG, b"# x\n"), CONFIG, 1, "", "is empty", "can.yaml"),
    Broken(
        "not UTF-8", Write(ROBOT, b"name: paper\n# \xe9l\xe9ment\n"), ROBOT, 2, "",
        "is not UTF-8 text", "save it as UTF-8",
    ),
    Broken(
        "a directory", make_directory, CONFIG, 0, "", "is a directory",
        "did you mean config/can.yaml?",
    ),
    Broken(
        "unknown scenario", Edit(CONFIG, "scenario: load_test", "scenario: load_tset"), CONFIG,
        "scenario:", "scenario", "there is no scenario 'load_tset'", "did you mean load_test?",
    ),
]  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    ignored = shutil.ignore_patterns("__pycache__", "*.py", "schema")
    return Path(shutil.copytree(HERE, tmp_path / "mine", ignore=ignored))


def expected_line(case: Broken, folder: Path) -> int:
    if isinstance(case.at, int):
        return case.at
    lines = (folder / case.file).read_text(encoding="utf-8").split("\n")
    return next(n for n, line in enumerate(lines, 1) if case.at in line.split("#")[0])


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_mistake_is_named_with_file_line_key_rule_and_remedy(case: Broken, folder: Path) -> None:
    case.edit(folder)
    with pytest.raises(ConfigError) as caught:
        load(folder / CONFIG)
    error, text = caught.value, str(caught.value)
    assert "\n" not in text
    assert len(text) < 300 + 2 * len(str(folder))
    assert error.file == str(folder / case.file)
    assert error.key == case.key
    assert case.problem in text
    assert case.remedy in text
    if case.file != CONFIG or not (folder / CONFIG).is_dir():
        assert error.line == expected_line(case, folder)


def test_what_is_copied_is_good_until_it_is_broken(folder: Path) -> None:
    config, scenario = load(folder / CONFIG)
    assert config == load("config/can.yaml")[0]
    assert scenario.name == config.scenario


def test_a_configuration_sets_values_of_what_it_includes_and_a_caller_has_the_last_word(
    folder: Path,
) -> None:
    Edit(CONFIG, "scenario:", "set: {robot.gravity: 9.5, scenario: hold}\nscenario:")(folder)
    config, scenario = load(folder / CONFIG)
    assert (config.robot.gravity, scenario.name) == (9.5, "hold")
    config, _ = load(folder / CONFIG, overrides={"robot.gravity": 9.7})
    assert config.robot.gravity == 9.7


def test_a_configuration_that_is_not_there_is_answered_with_one_that_is() -> None:
    with pytest.raises(ConfigError, match=r"did you mean config/can\.yaml\?"):
        load("config/cann.yaml")
    with pytest.raises(ConfigError, match=r"no such file; choose one of config/"):
        load("config/nothing.yaml")  # whose suffix and folder are not what makes it like another
    with pytest.raises(ConfigError, match=r"there is no file 'own/hodl.yaml'; did you mean hold\?"):
        load_scenario("own/hodl.yaml")


@pytest.mark.parametrize("name", ["x" * 300 + ".yaml", "a\0b.yaml", ""], ids=["long", "null", "no"])
def test_impossible_file_names_are_refused_like_others(name: str) -> None:
    with pytest.raises(ConfigError):
        load(name)
    with pytest.raises(ConfigError):
        load_scenario(name)


SCENARIOS = [
    ("name: s\ndescription: d\nduration: 0\nreference: {kind: hold}\n", 3, "duration", "greater"),
    (
        "name: s\ndescription: d\nduration: 1\nreference: {kind: sin}\n",
        4, "reference.kind", "choose one of 'hold', 'sine', 'multisine', 'path'",
    ),
    (
        "name: s\ndescription: d\nduration: 1\nreference: {kind: path, waypoints: []}\n",
        4, "reference.waypoints", "give the missing items",
    ),
    (
        "name: s\ndescription: d\nduration: 1\nreference: {kind: waypoints, waypoints: []}\n",
        4, "reference.waypoints", "has 0 items, and takes at least 1; give the missing items",
    ),
    ("", 1, "", "is empty; write its keys, see docs/configuration.md"),
    (
        "name: s\ndescription: d\nduration: 1\nreference:\n  kind: sine\n"
        "  direction: [0, 0, 0]\n  amplitude: 0.1\n  frequency: 1\n  fade: 0\n",
        6, "reference.direction", "has no length",
    ),
    (
        "name: s\ndescription: d\nduration: 1\nreference: {kind: hold}\nlab:\n  load:\n"
        "    direction: [1, 0, 0]\n    point: [0, 0, 0]\n"
        "    profile: [{at: 2, force: 0}, {at: 1, force: 5}]\n",
        6, "lab.load", "must run forward in time",
    ),
    (
        "name: s\ndescription: d\nduration: 1\nreference: {kind: hold}\n"
        "lab: {faults: [{at: 1, kind: explode, channel: can0, node: 1}]}\n",
        5, "lab.faults.0.kind", "'unplug'",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("text", "line", "key", "said"), SCENARIOS, ids=lambda v: str(v)[:12])
def test_a_mistake_in_a_scenario_is_named(
    tmp_path: Path, text: str, line: int, key: str, said: str
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load("config/can.yaml", scenario=str(path))
    assert (caught.value.file, caught.value.line, caught.value.key) == (str(path), line, key)
    assert said in str(caught.value)


def test_an_override_without_a_place_is_an_error_of_the_configuration() -> None:
    config, _ = load("config/can.yaml", overrides={"control.controller": "pid"})
    assert config.control.controller == "pid"
    for key in ("control.none.x", "name.x.y", "fieldbus.channels.9.name", "control.controler"):
        with pytest.raises(ConfigError):
            load("config/can.yaml", overrides={key: 1})
    with pytest.raises(ConfigError, match=r"control.stifness: is not there, .* mean stiffness\?"):
        load("config/can.yaml", overrides={"control.stifness.base": 1})


def test_an_error_keeps_working_as_an_exception() -> None:
    """Context managers set attributes of passing exceptions; sets and dicts hash them."""
    error = ConfigError("f.yaml", 3, "a.b", "is\nodd", "mend it")
    error.add_note("seen")
    assert isinstance(hash(error), int)
    assert str(error) == "f.yaml:3: a.b: is odd; mend it"


@pytest.mark.parametrize(
    ("name", "said"),
    [("unknown controller", "control.controller"), ("missing include", "!include"),
     ("bad syntax", "not valid YAML"), ("a directory", "is a directory")],
)  # fmt: skip
def test_on_the_command_line_it_is_one_line_and_exit_code_2(
    folder: Path,
    name: str,
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from tonus.tools.cli.main import main

    next(case for case in CASES if case.name == name).edit(folder)
    monkeypatch.setattr(sys, "argv", ["tonus", "check", str(folder / CONFIG)])
    with pytest.raises(SystemExit) as ending:
        main()
    out, err = capsys.readouterr()
    assert ending.value.code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert said in err


def test_a_value_that_was_given_beside_the_files_is_told_as_such() -> None:
    """The file's line has another one."""
    with pytest.raises(ConfigError) as told:
        load("config/can.yaml", overrides={"robot.platform.mass": -1})
    assert (told.value.file, told.value.line) == ("overrides", 0)
    assert "robot.platform.mass: input should be greater than 0, not -1" in str(told.value)


def test_a_filter_beyond_half_of_the_rate_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"500 Hz are not below half .*; choose less than 500"):
        load("config/can.yaml", overrides={"control.filters.force_cutoff_hz": 500.0})
    load("config/can.yaml", overrides={"control.filters.force_cutoff_hz": 499.0})


def test_a_folder_is_answered_with_what_is_in_it(folder: Path) -> None:
    with pytest.raises(ConfigError) as told:
        load(folder)
    assert told.value.problem == "is a directory"
    assert str(folder / "can.yaml") in told.value.remedy
    assert "control.yaml" not in told.value.remedy
