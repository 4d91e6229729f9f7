"""What is printed never matters to what is recorded."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from loop import QUICK
from synthetic_run import Rings, cycles, recording, truth

from tonus.config.loader import HERE
from tonus.tools.log import open as open_log
from tonus.tools.run.recorder_process import start

TICKS = 500
ROOT = HERE.parent


@contextmanager
def full() -> Iterator[int]:
    """A disk without room."""
    descriptor = os.open("/dev/full", os.O_WRONLY)
    yield descriptor
    os.close(descriptor)


@contextmanager
def left() -> Iterator[int]:
    """A pipe whose reader has gone, as behind ``| head``."""
    reading, writing = os.pipe()
    os.close(reading)
    yield writing
    os.close(writing)


@contextmanager
def stuck() -> Iterator[int]:
    """A pipe that nobody reads, full."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    try:
        while True:
            os.write(writing, b"\0" * 4096)
    except BlockingIOError:
        os.set_blocking(writing, True)
    yield writing
    os.close(writing)
    os.close(reading)


@contextmanager
def redirected(descriptor: int) -> Iterator[None]:
    """Standard output and error of the processes started meanwhile."""
    before = os.dup(1), os.dup(2)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    try:
        yield
    finally:
        for number, kept in zip((1, 2), before, strict=True):
            os.dup2(kept, number)
            os.close(kept)


@pytest.mark.parametrize("where", [full, left, stuck])
def test_a_recorder_records_whatever_becomes_of_what_it_prints(tmp_path: Path, where) -> None:
    rings = Rings(tmp_path / "rings", 8000)
    rows = cycles(TICKS)
    for tick in range(TICKS):
        rings.tick(tick, rows, truth(rows))
    out = tmp_path / "run.mcap"
    with where() as descriptor:
        with redirected(descriptor):
            recorder = start(
                *(tmp_path / "rings", out, recording(), {}, {}, 0),
                live=(1.0, 1_000_000),
                tell_events=True,
            )
        assert recorder.stop() is None, "not killed, and not given up"
    log = open_log(out)
    assert len(log["/tonus/timing"]) == TICKS
    assert log.damage is None
    assert [path.name for path in tmp_path.glob("*.mcap")] == ["run.mcap"]


def tonus(*arguments: str, stdout: int | None, **options) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tonus.tools.cli", *arguments]
    return subprocess.run(
        command, stdout=stdout, stderr=subprocess.PIPE, text=True, cwd=ROOT, check=False, **options
    )


@pytest.mark.wide
@pytest.mark.parametrize(
    ("where", "as_json", "code"),
    [
        pytest.param(full, False, 0, marks=pytest.mark.long),
        (left, False, 0),
        (full, True, 2),
        pytest.param(left, True, 0, marks=pytest.mark.long),
    ],
)
def test_a_run_is_recorded_to_its_end_whatever_becomes_of_what_it_prints(
    tmp_path: Path, where, as_json: bool, code: int
) -> None:
    environment = {**os.environ, "TONUS_RUNTIME_DIR": str(tmp_path / "runtime")}
    arguments = ["run", "config/direct.yaml", "--virtual", "--scenario", "hold"]
    arguments += ["--duration", "0.2", "--out", str(tmp_path / "out"), *["--json"] * as_json]
    arguments += [f"--set={key}={value}" for key, value in QUICK.items()]
    with where() as descriptor:
        done = tonus(*arguments, stdout=descriptor, env=environment)
    assert done.returncode == code, done.stderr
    # In a new checkout the first run compiles, and says so.
    lines = [line for line in done.stderr.splitlines() if not line.startswith("compiling")]
    assert lines == (
        ["tonus: standard output: no space left on device; redirect the output elsewhere"]
        if where is full
        else []
    )
    assert {"run.mcap", "summary.json", "overview.png"} <= {
        each.name for each in (tmp_path / "out").iterdir()
    }
    log = open_log(tmp_path / "out/run.mcap")
    assert log.damage is None
    assert "scenario completed" in (tmp_path / "out/summary.json").read_text()


def test_closed_output_is_not_taken_for_a_file(tmp_path: Path) -> None:
    """With descriptor 1 closed, the first file a program opens would have its number."""
    command = f'exec "{sys.executable}" -m tonus.tools.cli check config/can.yaml >&- 2>&-'
    done = subprocess.run(["/bin/sh", "-c", command], cwd=ROOT, check=False)
    assert done.returncode == 0


def test_names_beyond_a_terminals_letters_are_printed_all_the_same() -> None:
    environment = {**os.environ, "PYTHONIOENCODING": "latin-1", "COLUMNS": "80"}
    code = "from tonus.tools import output; output.install(); print('5 \\u00b5s \\u2264 \\u0394')"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=ROOT, capture_output=True, check=False
    )
    assert done.stdout == "5 µs ? ?\n".encode("latin-1")
