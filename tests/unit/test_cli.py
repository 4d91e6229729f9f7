"""The command line: an error a user can mend is one line and exit code 2."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from loop import QUICK

import tonus.tools
from tonus.config.loader import HERE
from tonus.tools.cli import campaign, log
from tonus.tools.cli.main import COMMANDS, main

TOOLS = Path(tonus.tools.__file__).parent


def call(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["tonus", *arguments])
    with pytest.raises(SystemExit) as ending:
        main()
    code = ending.value.code
    return code if isinstance(code, int) else 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "nope.yaml"], "there is no such file"),
        (["run", "config/one_channel.yaml"], "2750 us"),
        (["run", "config/can.yaml", "--scenario", "nope"], "choose one of"),
        (["run", "config/can.yaml", "--controller", "nope"], "'bio', 'bio_integral'"),
        (["run", "config/can.yaml", "--set", "nonsense"], "write KEY=VALUE"),
        (["run", "config/can.yaml", "--set", "control.nope.x=1"], "cannot be set"),
        (["campaign", "fault"], "did you mean faults"),
        (["campaign", "faults", "--episodes", "1", "--out", "/dev/null/x"], "--out"),
        (["run", "config/direct.yaml"], "--virtual"),
        (["run", "config/can.yaml", "--virtual", "--out", "/dev/null/x"], "--out"),
        (["log", "info", "nope.mcap"], "no such file"),
        (["log", "info", "/dev/null"], "is empty"),
        (["check", "/"], "is a directory"),
        (["lab", "config/can.yaml", "--nodes", "can0,can1/9"], "can1/9"),
        (["lab", "config/can.yaml", "--nodes", ""], "choose of can0, can0/1, can0/7"),
        (["lab", "config/direct.yaml", "--nodes", "can0"], "is direct"),
        (["fault", "get"], "start one with: tonus lab CONFIG"),
        (["export", "dbc", "config/direct.yaml"], "is direct"),
        (["export", "dbc", "config/can.yaml", "--channel", "can9"], "choose one of can0"),
        (["export", "dbc", "config/can.yaml", "--out", "/dev/null/x"], "--out"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    arguments: list[str],
    words: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)  # a run that is refused late has made its folder by then
    assert call(monkeypatch, *arguments) == 2
    told = capsys.readouterr().err.strip().splitlines()
    lines = [line for line in told if not line.startswith("compiling (")]  # in a new checkout
    assert len(lines) == 1
    assert words in lines[0]


def test_a_folder_that_cannot_be_had_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", "/dev/null/rings")
    arguments = ["run", "config/can.yaml", "--virtual", "--out", str(tmp_path)]
    assert call(monkeypatch, *arguments) == 2
    assert "TONUS_RUNTIME_DIR" in capsys.readouterr().err


def test_nowhere_to_keep_compiled_code_is_one_line_too() -> None:
    code = (
        "import sys, numba.core.caching as caching\n"
        "caching.CacheImpl._locator_classes = []\n"
        "sys.argv[1:] = ['run', 'config/can.yaml', '--virtual']\n"
        "from tonus.tools.cli.main import main\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "set NUMBA_CACHE_DIR" in done.stderr


def test_check_says_each_mistake_of_a_configuration(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """In a line of its own; ``pre`` counts as misspelt, and not as missing besides."""
    shutil.copytree(HERE, tmp_path / "config")
    control = tmp_path / "config" / "control.yaml"
    text = control.read_text()
    for old, new in (("  pre: 45.0", "  prex: 45"), ("stop_s: 0.3", "stop_s: -1")):
        text = text.replace(old, new, 1)
    control.write_text(text)
    assert call(monkeypatch, "check", str(tmp_path / "config" / "can.yaml")) == 2
    told = capsys.readouterr().err.splitlines()
    assert [line.split(": ")[2] for line in told] == [
        "control.sequence.stop_s",
        "control.tension.prex",
    ]


def test_a_failed_check_is_exit_code_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(monkeypatch, "check", "config/one_channel.yaml") == 1
    assert "FAILED" in capsys.readouterr().out


def test_the_summary_alone_is_printed_as_json(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path / "runtime"))
    arguments = ["config/direct.yaml", "--scenario", "hold", "--duration", "0.2", "--virtual"]
    arguments += [f"--set={key}={value}" for key, value in QUICK.items()]
    assert call(monkeypatch, "run", *arguments, "--json", "--out", str(tmp_path)) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary == json.loads((tmp_path / "summary.json").read_text())
    assert summary["state"] == "STANDBY"
    assert summary["realtime_factor"] > 0.0


@pytest.mark.parametrize(
    "typed",
    ["--help", "log --help", "ctl --help", "ctl estop", "view --help", "log info /dev/null"],
)
def test_a_light_command_waits_for_no_heavy_library(typed: str, tmp_path: Path) -> None:
    """An emergency stop took two seconds of imports before it was sent."""
    code = f"""
import sys
sys.argv = ["tonus", *{typed.split()}]
from tonus.tools.cli.entry import main
try:
    main()
finally:
    heavy = {{"numba", "scipy", "matplotlib", "pyarrow", "clarabel", "daqp"}} & set(sys.modules)
    assert not heavy, heavy
"""
    environment = {**os.environ, "TONUS_RUNTIME_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert "AssertionError" not in done.stderr


@pytest.mark.parametrize(
    ("folder", "lines"), [("", COMMANDS), ("log", log.LINES), ("campaign", campaign.LINES)]
)
def test_every_command_has_its_line_in_the_list(folder: str, lines: dict[str, str]) -> None:
    there = {path.stem for path in (TOOLS / "cli" / folder).glob("*.py")}
    assert set(lines) <= there | {"log", "campaign"}
    assert all(line[0].isupper() and line.endswith(".") for line in lines.values())
