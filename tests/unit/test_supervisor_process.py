"""The supervisor's process: what it says of its end, and where."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import pytest

from tonus.config import load
from tonus.tools.run import supervisor_process


class _Stand:
    """A supervisor that fails in its third look, or cannot open a channel."""

    settings = load("config/can.yaml")[0].supervisor
    fails_at = 3

    def __init__(self, *given: Any) -> None:
        if not self.fails_at:
            raise can.CanError("no such channel")
        self.looks = 0

    def step(self, now_ns: int) -> None:
        self.looks += 1
        if self.looks == self.fails_at:
            raise OSError("the ring is gone")

    def close(self) -> None:
        """No channel is open."""


@pytest.mark.parametrize(
    ("fails_at", "said", "code"),
    [
        (3, "ready\n", "the supervisor has ended: the ring is gone"),
        (0, "no such channel\n", 2),
    ],
)
def test_what_has_ended_it_is_said_where_it_is_read(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    fails_at: int,
    said: str,
    code: int | str,
) -> None:
    """Until it is ready, to whoever started it; later nobody reads that pipe. A process writes the
    words of its exit to standard error."""
    monkeypatch.setattr(_Stand, "fails_at", fails_at)
    monkeypatch.setattr(supervisor_process, "Supervisor", _Stand)
    ring = SimpleNamespace(look=lambda path: None)
    monkeypatch.setattr(supervisor_process, "RingReader", ring)
    for place, name in (
        (supervisor_process, "of_ring"),
        (supervisor_process, "prepare"),
        (supervisor_process, "freeze_collector"),
        (supervisor_process.output, "install"),
        (supervisor_process.signal, "signal"),
    ):
        monkeypatch.setattr(place, name, lambda *given, **named: None)
    job = tmp_path / "supervisor.json"
    config = load("config/can.yaml")[0].model_dump(mode="json")
    job.write_text(json.dumps({"config": config, "ring": "cycle.ring"}))
    monkeypatch.setattr(sys, "argv", ["supervisor_process", str(job)])
    read, write = os.pipe()
    with os.fdopen(read) as theirs, os.fdopen(write, "w"):
        monkeypatch.setattr(sys, "stdin", theirs)
        with pytest.raises(SystemExit) as ended:
            supervisor_process.main()
    assert ended.value.code == code
    assert capsys.readouterr() == (said, "")
