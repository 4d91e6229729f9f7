"""When a recorder has its priority: the first loads its code without, a later one has no time."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tonus.tools.run import recorder_keeper
from tonus.tools.run.recorder_keeper import keep

KILLED = -9


@pytest.mark.parametrize(
    ("priority", "told"), [(5, ["start", 5, "start", 5, "start"]), (0, ["start"] * 3)]
)
def test_only_a_recorder_that_is_started_again_is_hastened(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, priority: int, told: list[object]
) -> None:
    codes, seen = [KILLED, KILLED, 0], list[object]()

    def run(command: list[str], *, check: bool) -> subprocess.CompletedProcess[bytes]:
        assert not check
        seen.append("start")
        return subprocess.CompletedProcess(command, codes.pop(0))

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(recorder_keeper, "_hasten", seen.append)
    assert keep(tmp_path, ["a recorder"], priority) == 0
    assert seen == told
