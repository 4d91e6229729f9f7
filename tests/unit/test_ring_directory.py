"""Where the rings of a run lie, and what a killed run has left there."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

import pytest

from tonus.config.places import RUNTIME_DIR
from tonus.tools.errors import ToolError
from tonus.tools.run.recorder_process import JOB
from tonus.tools.run.ring_directory import ring_directory


@pytest.fixture
def left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """By a killed run that had the number of this process, as a daemon in a container has it each
    time it is started."""
    monkeypatch.setenv(RUNTIME_DIR, str(tmp_path))
    folder = tmp_path / f"run-{os.getpid()}"
    folder.mkdir()
    (folder / "lab.json").write_text("{}")
    return folder


def test_a_folder_under_the_own_number_is_cleared(left: Path) -> None:
    with ring_directory(lambda _: None) as rings:
        assert rings == left
        assert not list(rings.iterdir())
    assert not left.exists()


def test_what_cannot_be_recorded_of_it_is_moved_aside(left: Path) -> None:
    (left / JOB).write_text("{}")
    (left / "cycle.ring").write_bytes(b"torn")
    said: list[str] = []
    with ring_directory(said.append) as rings:
        assert not list(rings.iterdir())
    (aside,) = left.parent.iterdir()
    assert (aside / "cycle.ring").read_bytes() == b"torn"
    assert said[0].startswith("left by an earlier run and kept: ")


def test_a_recorder_that_is_still_at_work_there_is_left_alone(left: Path) -> None:
    (left / JOB).write_text("{}")
    with (left / "recorder.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with (
            pytest.raises(ToolError, match="still at work; wait a moment"),
            ring_directory(lambda _: None),
        ):
            pass
    assert (left / JOB).exists()
