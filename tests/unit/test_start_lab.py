"""The lab's process, as it is started: in time, or a line that says why not."""

from __future__ import annotations

import os
import shutil
import signal
from pathlib import Path

import pytest

from tonus.config import load
from tonus.tools.errors import ToolError
from tonus.tools.run import child_process, lab_process
from tonus.tools.run.child_process import ChildProcess
from tonus.tools.run.lab_process import start_lab


def start(
    monkeypatch: pytest.MonkeyPatch, folder: Path, command: tuple[str, ...], seconds: float
) -> ChildProcess:
    """With a program in the lab's place; its last argument is the job's file."""
    monkeypatch.setattr(lab_process, "_COMMAND", command)
    config, scenario = load("config/can.yaml", overrides={"lab.start_timeout_s": seconds})
    return start_lab(config, scenario, 1, folder, 1)


@pytest.mark.parametrize("command", [("tail", "-f"), ("sh", "-c", "while :; do :; done")])
def test_a_lab_that_says_no_whole_line_is_ended_in_time(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: tuple[str, ...]
) -> None:
    assert shutil.which(command[0])
    processes = []
    popen = child_process.subprocess.Popen

    def opened(*args: object, **kwargs: object) -> object:
        processes.append(popen(*args, **kwargs))  # type: ignore[call-overload]
        return processes[-1]

    monkeypatch.setattr(child_process.subprocess, "Popen", opened)
    with pytest.raises(ToolError, match=r"did not answer within 0.2 s.*lab.start_timeout_s"):
        start(monkeypatch, tmp_path, command, 0.2)
    (process,) = processes
    assert process.returncode is not None


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("sh", "-c", "echo no such bus; exit 2"), "no such bus"),
        (("true",), "it ended without a word"),
        (("sh", "-c", "echo no; exec tail -f /dev/null"), "no"),
    ],
)
def test_a_lab_that_cannot_start_is_quoted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: tuple[str, ...], words: str
) -> None:
    with pytest.raises(ToolError, match=f"did not start: {words}$"):
        start(monkeypatch, tmp_path, command, 60.0)


def test_one_that_is_ready_is_handed_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    lab = start(monkeypatch, tmp_path, ("sh", "-c", "echo ready; read word"), 60.0)
    assert lab.process.poll() is None
    lab.stop()
    assert lab.process.returncode is not None


def test_one_that_hangs_is_killed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    lab = start(monkeypatch, tmp_path, ("sh", "-c", "echo ready; read word"), 60.0)
    os.kill(lab.process.pid, signal.SIGSTOP)
    lab.stop(0.2)
    assert lab.process.returncode == -signal.SIGKILL
    lab.stop()
