"""A run whose recording failed says so, and its exit code is 1."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import pytest
from click.testing import CliRunner
from loop import QUICK
from synthetic_run import Rings, cycles, recording, truth

from tonus.runtime.recording.mcap_file import McapFile
from tonus.runtime.recording.recorder import Recorder
from tonus.tools.cli.run import run
from tonus.tools.log import open as open_log

TICKS = 900
TRUE = truth(cycles(TICKS))


def play(out: Path, *arguments: str):
    fixed = ["config/direct.yaml", "--virtual", "--scenario", "hold", "--duration", "0.1"]
    fixed += [f"--set={key}={value}" for key, value in QUICK.items()]
    return CliRunner().invoke(run, [*fixed, "--out", str(out), *arguments])


@pytest.fixture(autouse=True)
def _apart(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path / "runtime"))


class Disk:
    """Full for whatever is named."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.full = True
        monkeypatch.setattr(Recorder, "_free_bytes", lambda _: 0 if self.full else 10**12)
        write = McapFile._write

        def tried(file: McapFile, data: bytes) -> int:
            if self.full:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return write(file, data)

        monkeypatch.setattr(McapFile, "_write", tried)


def test_a_disk_that_is_full_from_the_start_is_the_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Recorder, "_free_bytes", lambda _: 0)
    result = play(tmp_path / "out")
    assert result.exit_code == 1, result.output
    assert "NOT RECORDED" in result.output
    assert "no space left on device" in result.output
    assert result.output.splitlines()[-1] == "STANDBY: scenario completed"


def test_not_even_a_first_byte_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Disk(monkeypatch)
    result = play(tmp_path / "out", "--json")
    assert result.exit_code == 1, result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)
    assert "no space left on device" in json.loads(result.output)["unrecorded"]


def test_a_summary_that_cannot_be_written_costs_the_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("tonus.tools.report.overview.overview", refuse)
    result = play(tmp_path / "out")
    assert result.exit_code == 1, result.output
    assert open_log(tmp_path / "out/run.mcap").damage is None


def test_a_recorder_that_finds_a_full_disk_begins_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Under the name that was asked for, and with all that the rings still hold."""
    disk = Disk(monkeypatch)
    rings, rows = Rings(tmp_path / "rings"), cycles(TICKS)
    out = tmp_path / "log" / "run.mcap"
    out.parent.mkdir()
    recorder = Recorder(tmp_path / "rings", out, recording(chunk_ms=50), {}, {}, 0)
    assert "no space left on device" in recorder.stopped
    for tick in range(TICKS):
        rings.tick(tick, rows, TRUE)
        if tick % 100 == 99:
            recorder.drain()
        if tick == 500:
            assert not list(out.parent.iterdir())
            disk.full = False
    recorder.finish()
    assert not recorder.stopped
    log = open_log(out)
    assert len(log["/tonus/timing"]) == TICKS
    assert "recording_resumed" in {event.name for event in log.events()}


def test_a_next_file_that_cannot_be_begun_stops_the_recording_and_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rings, rows = Rings(tmp_path / "rings"), cycles(TICKS)
    recorder = Recorder(
        tmp_path / "rings", tmp_path / "run.mcap", recording(chunk_ms=50, rotate_s=0.3), {}, {}, 0
    )
    begin = Recorder._next_segment

    def refuse(self: Recorder, path: Path) -> object:
        if path.name == "run.2.mcap":
            raise OSError(errno.EACCES, os.strerror(errno.EACCES))
        return begin(self, path)

    monkeypatch.setattr(Recorder, "_next_segment", refuse)
    for tick in range(TICKS):
        rings.tick(tick, rows, TRUE)
    recorder.drain()
    assert "permission denied" in recorder.stopped
    assert open_log(tmp_path / "run.mcap").damage is None


@pytest.mark.wide
def test_a_state_too_large_to_be_kept_is_an_event(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A controller with much memory: once is enough to say so."""
    monkeypatch.setattr("tonus.runtime.recording.taps.KEYFRAME_BYTES", 64)
    assert play(tmp_path / "out").exit_code == 0
    events = open_log(tmp_path / "out/run.mcap").events()
    (event,) = (each for each in events if each.name == "keyframe_left_out")
    assert "a replay has to begin" in event.text
