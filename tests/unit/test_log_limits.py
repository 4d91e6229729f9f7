"""What a log claims is believed up to a limit, and what is damaged is said and costs the code."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from mcap.writer import CompressionType, Writer
from synthetic_run import Rings, cycles, record, recording, truth

from tonus.config.loader import HERE
from tonus.runtime.recording.recorder import Recorder
from tonus.runtime.recording.taps import Level
from tonus.tools.cli.log import log as command
from tonus.tools.cli.log.info import describe
from tonus.tools.errors import ToolError
from tonus.tools.log import log as log_module
from tonus.tools.log import open as open_log

BOMB_CHUNKS, BOMB_BYTES = 25, 80_000_000
MEMORY = 2 << 30


@pytest.fixture(scope="module")
def bomb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two gigabytes of zeros in some hundred thousand bytes."""
    path = tmp_path_factory.mktemp("bomb") / "run.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=1000, compression=CompressionType.ZSTD)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/a", "cdr", schema)
        for number in range(BOMB_CHUNKS):
            writer.add_message(channel, number, bytes(BOMB_BYTES), number)
        writer.finish()
    assert path.stat().st_size < 1_000_000
    return path


@pytest.mark.parametrize("verb", ["info", "recover", "export"])
def test_a_log_made_to_fill_memory_is_refused_in_bounded_memory(
    bomb: Path, tmp_path: Path, verb: str
) -> None:
    options = {
        "info": [],
        "recover": ["--out", str(tmp_path / "out.mcap")],
        "export": ["--format", "csv", "--out", str(tmp_path / "tables")],
    }[verb]
    done = subprocess.run(
        [sys.executable, "-m", "tonus.tools.cli", "log", verb, str(bomb), *options],
        cwd=HERE.parent,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY)),
    )
    assert done.returncode in (0, 1), done.stderr
    assert "Traceback" not in done.stderr
    if verb == "info":
        assert done.returncode == 1
        assert "claims to unpack to more than any" in " ".join(done.stdout.split())


def test_a_log_larger_than_memory_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = record(tmp_path, 300)
    monkeypatch.setattr(log_module, "memory_for_logs", lambda: 100_000)
    with pytest.raises(ToolError, match="more than half of this machine's free memory"):
        open_log(path).load()
    assert sum(len(each["/tonus/state"].times) for each in open_log(path).batches(["/tonus/state"]))


@pytest.fixture(scope="module")
def damaged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = record(tmp_path_factory.mktemp("damaged"), 1200, chunk_ms=50)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 9 // 10])
    return path


@pytest.mark.parametrize(
    "arguments",
    [
        ["info"],
        ["info", "--json"],
        ["timing", "--budget", "BUDGET"],
        ["timing", "--json", "--budget", "BUDGET"],
        ["export", "--format", "csv", "--topics", "/tonus/state", "--out", "OUT"],
    ],
)
def test_a_damaged_log_is_used_and_costs_the_exit_code(
    damaged: Path, tmp_path: Path, arguments: list[str]
) -> None:
    budget, out = tmp_path / "generous.yaml", tmp_path / "t"
    limit = "{signal: wakeup_us, at: 99, at_most: 1.0e+9}"
    budget.write_text(f"name: generous\nstates: [HOLD, ACTIVE]\nlimits: [{limit}]\n")
    given = {"OUT": str(out), "BUDGET": str(budget)}
    verb, *options = [given.get(each, each) for each in arguments]
    whole = CliRunner().invoke(command, [verb, str(record(tmp_path / "whole", 1200)), *options])
    assert whole.exit_code == 0, whole.output
    shutil.rmtree(out, ignore_errors=True)
    result = CliRunner().invoke(command, [verb, str(damaged), *options])
    assert result.exit_code == 1, result.output
    assert "cut short" in " ".join(result.output.split())
    if "--json" in options:
        json.loads(result.stdout)


def test_a_pipe_is_no_log(tmp_path: Path) -> None:
    """It would be waited for, for ever."""
    os.mkfifo(tmp_path / "run.mcap")
    with pytest.raises(ToolError, match="is a pipe"):
        open_log(tmp_path / "run.mcap")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--from", "5", "--to", "1"], "ends before it begins"),
        (["--from", "nan"], "is not a time"),
        (["--to", "inf"], "is not a time"),
        (["--from", "50"], "holds no message there"),
        (["--to", "-1"], "holds no message there"),
    ],
)
def test_an_export_of_nothing_is_refused(tmp_path: Path, options: list[str], words: str) -> None:
    path = record(tmp_path, 100)
    out = tmp_path / "tables"
    result = CliRunner().invoke(
        command, ["export", str(path), "--format", "csv", "--out", str(out), *options]
    )
    assert isinstance(result.exception, ToolError)
    assert words in str(result.exception)
    assert not out.exists()


def test_states_and_events_are_told_by_one_clock(tmp_path: Path) -> None:
    """A log whose first message is no cycle: the events' clock and the states' are the same."""
    rings, rows = Rings(tmp_path / "rings"), cycles(1000)
    rings.events.write(0, 0, Level.INFO, "early", "", "before the first cycle")
    true = truth(rows)
    for tick in range(500, 1000):
        rings.tick(tick, rows, true)
    recorder = Recorder(tmp_path / "rings", tmp_path / "run.mcap", recording(), {}, {}, 0)
    recorder.finish()
    found = describe(open_log(tmp_path / "run.mcap"))
    entered = {row["state"]: row["from_s"] for row in found["states"]}
    told = [each for each in found["events"] if each["name"] == "STATE"]
    assert told
    for event in told:
        state = event["text"].removeprefix("entered ").partition(",")[0]
        assert event["time_s"] == pytest.approx(entered[state])
