"""What `docs/code.md` says of adding a signal and a stage is all there is to do: in a copy of the
sources only the files that it names are changed, and a run logs the new signal and replays.

A robot, a drive, a controller and a fieldbus of a user need no file here: `test_any_cables.py`,
`test_mixed_drives.py`, `test_controller_of_ones_own.py` and `test_own_fieldbus.py` bring each.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from loop import QUICK

from tonus.tools.log import open as open_log

pytestmark = pytest.mark.wide

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("config", "drivers", "runtime", "sim", "tools", "tonus")


class Edit(NamedTuple):
    """``text`` goes behind the line ``after``, which is in the file once."""

    file: str
    after: str
    text: str


SIGNAL = (
    Edit(
        "runtime/signals.py",
        '        _f8("contact", 0, "N", "contact port"),\n',
        '        _f8("lift", 0, "N", "external force upward, of the estimate"),\n',
    ),
    Edit(
        "runtime/recording/record_writers.py",
        "        wrench.external[k] = estimate[4][k]\n",
        "    wrench.lift = estimate[4][2]\n",
    ),
)
STAGE_FILE = "runtime/control/heave.py"
STAGE = '''"""A stage that a test adds: the largest force upward so far."""


class Heave:
    def __init__(self) -> None:
        self.most = 0.0

    def __call__(self, force: float) -> None:
        self.most = max(self.most, force)
'''
CALLED = (
    Edit(
        "runtime/cycle.py",
        "from tonus.runtime.control.guide import Guide\n",
        "from tonus.runtime.control.heave import Heave\n",
    ),
    Edit(
        "runtime/cycle.py",
        "        self._torque = np.zeros(robot.cables)\n",
        "        self._heave = Heave()\n",
    ),
    Edit(
        "runtime/cycle.py",
        "        estimate = estimator.advance(lengths, self._pulling, elastic, believed)\n",
        "        self._heave(float(estimate.external[2]))\n",
    ),
    Edit(
        "runtime/cycle.py",
        "            self._writer.results(self._law)\n",
        "        self.record.wrench.heave[...] = self._heave.most\n",
    ),
    Edit(
        "runtime/signals.py",
        '        _f8("contact", 0, "N", "contact port"),\n',
        '        _f8("heave", 0, "N", "largest external force upward so far"),\n',
    ),
)


def row(what: str) -> set[str]:
    """Files and folders that the row of `docs/code.md` names to open."""
    page = (ROOT / "docs" / "code.md").read_text(encoding="utf-8")
    (opened,) = re.findall(rf"^\| {what} \| (.*?) \|", page, flags=re.MULTILINE)
    short = {Path(each).name: each for each in re.findall(r"`([\w/.]+\.py)`", opened)}
    named = set(re.findall(r"`((?:runtime|drivers|config|sim|tools)/[\w/.]*)`", opened))
    folder = {"record_writers.py": "runtime/recording/record_writers.py"}
    return named | {folder[name] for name in short if name in folder}


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The sources, with what has been compiled of them."""
    for folder in FOLDERS:
        shutil.copytree(ROOT / folder, tmp_path / folder, symlinks=True)
    return tmp_path


def changed(copy: Path, edits: tuple[Edit, ...]) -> set[str]:
    for edit in edits:
        path = copy / edit.file
        text = path.read_text(encoding="utf-8")
        assert text.count(edit.after) == 1, f"{edit.file}: {edit.after!r}"
        path.write_text(text.replace(edit.after, edit.after + edit.text), encoding="utf-8")
    return {edit.file for edit in edits}


def played(copy: Path, *words: str) -> str:
    command = "from tonus.tools.cli.entry import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", command, *words],
        cwd=copy,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def run(copy: Path) -> dict[str, np.ndarray]:
    quick = [f"--set={key}={value}" for key, value in QUICK.items()]
    played(copy, "run", "config/direct.yaml", "--virtual", "--scenario", "hold",
           "--duration", "0.1", "--out", "out", *quick)  # fmt: skip
    assert "bit-equal" in played(copy, "log", "replay", "out/run.mcap")
    wrench = open_log(copy / "out" / "run.mcap")["/tonus/wrench"]
    return {name: wrench[name] for name in wrench.dtype.names}


def test_a_signal_is_its_line_and_its_writer_and_a_stage_its_file_and_its_call(copy: Path) -> None:
    """In one copy, so that one run shows both."""
    assert changed(copy, SIGNAL) <= row("a signal")
    (copy / STAGE_FILE).write_text(STAGE, encoding="utf-8")
    assert changed(copy, CALLED) - row("a signal") == {"runtime/cycle.py"}
    assert {"runtime/control/", "runtime/cycle.py"} == row("a stage of the tick")
    wrench = run(copy)
    np.testing.assert_array_equal(wrench["lift"], wrench["external"][:, 2])
    assert np.any(wrench["lift"])
    heave = wrench["heave"]
    assert np.all(np.diff(heave) >= 0.0)
    assert heave.max() > 0.0
