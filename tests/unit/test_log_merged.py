"""One table over topics: each row is a tick, with the latest message of every topic."""

from __future__ import annotations

import csv
import errno
import os
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from pyarrow import parquet
from synthetic_run import MS, Rings, cycles, record, recording, truth

from tests import mat_file
from tonus.runtime.recording.recorder import Recorder
from tonus.tools.cli.log import log as command
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.log.export import export_merged
from tonus.tools.log.merged import merge, mergeable

TICKS, LATE, EVERY = 300, 40, 7


def seldom(folder: Path, late: int = LATE, **options: object) -> Path:
    """A run whose truth begins at tick ``late`` and comes every seventh tick, in between two."""
    rings, rows = Rings(folder / "rings"), cycles(TICKS)
    rows["pose"]["position"][:, 0] = np.arange(TICKS)
    true = truth(rows)
    true["contact_force"] = np.arange(TICKS)
    recorder = Recorder(
        folder / "rings", folder / "run.mcap", recording(**options), {"seed": "1"}, {}, 0
    )
    for k in range(TICKS):
        if k >= late and k % EVERY == 0:
            rings.truth.publish(true[k : k + 1], k * MS - MS // 2)
        rings.cycle.publish(rows[k : k + 1], k * MS)
        if k % 50 == 49:
            recorder.drain()
    recorder.finish()
    return recorder.path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    return open_log(seldom(tmp_path_factory.mktemp("log"), chunk_ms=20))


TOPICS = ["/tonus/pose", "/tonus/truth", "/tonus/state"]
FIRST = -(-LATE // EVERY) * EVERY


def test_a_slower_topic_is_held_at_its_last_value(log: Log, tmp_path: Path) -> None:
    table = parquet.read_table(export_merged(log, tmp_path, "parquet", TOPICS).path)
    ticks = np.arange(FIRST, TICKS)
    assert table["tick"].to_pylist() == ticks.tolist()
    assert table["pose.position_0"].to_pylist() == ticks.tolist()
    assert table["truth.contact_force"].to_pylist() == (ticks - ticks % EVERY).tolist()
    held = table["truth.held"].to_numpy()
    assert np.allclose(held, (ticks % EVERY) * 1e-3 + 0.5e-3, atol=1e-12)
    assert np.allclose(table["time"].to_numpy(), ticks * 1e-3 - log.start_ns * 1e-9)
    assert table.schema.field("truth.contact_force").metadata == {b"unit": b"N"}
    assert "pose.held" not in table.schema.names


def test_the_rows_are_those_of_join(log: Log, tmp_path: Path) -> None:
    """Which has the whole log in memory; a table is made from what the chunks hold."""
    joined = log.join(*TOPICS)
    table = parquet.read_table(export_merged(log, tmp_path, "parquet", TOPICS).path)
    assert table["tick"].to_pylist() == joined["tick"].tolist()
    for topic in ("pose", "truth", "state"):
        for field in joined[topic].dtype.names:
            values = joined[topic][field].reshape(len(joined), -1)
            for index in range(values.shape[1]):
                name = f"{topic}.{field}" + (f"_{index}" if joined[topic][field].ndim > 1 else "")
                assert np.array_equal(table[name].to_numpy(), values[:, index]), name


@pytest.mark.parametrize("drain_every", [3, 50, 299])
def test_topics_that_lie_in_other_chunks_than_their_ticks_are_found(
    tmp_path: Path, drain_every: int
) -> None:
    """The recorder empties one ring after the other, so chunks overlap in time."""
    log = open_log(record(tmp_path, TICKS, chunk_ms=4, drain_every=drain_every))
    topics = ["/tonus/truth", "/tonus/tension", "/can/can0"]
    joined = log.join(*topics)
    rows = list(merge(log, mergeable(log, topics)))
    told = np.concatenate([part.base[1].values for part in rows])
    assert told.tolist() == joined["tick"].tolist()
    frames = [
        next(signal.values for signal in part.topics["can/can0"] if signal.name == "id")
        for part in rows
        if part.count
    ]
    assert np.array_equal(np.concatenate(frames), joined["can0"]["id"])


def test_files_of_one_run_make_one_table(tmp_path: Path) -> None:
    whole = open_log(record(tmp_path / "whole", 3 * TICKS, chunk_ms=20))
    record(tmp_path / "parts", 3 * TICKS, chunk_ms=20, rotate_s=0.2)
    parts = open_log(tmp_path / "parts/run.mcap")
    assert (tmp_path / "parts/run.2.mcap").exists()
    tables = [
        parquet.read_table(export_merged(log, log.path.parent / "out", "parquet").path)
        for log in (whole, parts)
    ]
    assert tables[0].num_rows == 3 * TICKS
    assert tables[0].equals(tables[1])


def test_csv_and_mat_have_the_same_columns(log: Log, tmp_path: Path) -> None:
    path = export_merged(log, tmp_path, "csv", TOPICS).path
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    variables = mat_file.read(export_merged(log, tmp_path, "mat", TOPICS).path)
    assert set(variables) == {"ticks", "pose", "truth", "state", "about"}
    assert [float(row["pose.position_0 [m]"]) for row in rows] == variables["pose"][
        "position"
    ].value[:, 0].tolist()
    assert [int(row["tick"]) for row in rows] == variables["ticks"]["tick"].value[:, 0].tolist()
    names = ["".join(row).rstrip() for row in variables["state"]["state_name"].value.tolist()]
    assert [row["state.state_name"] for row in rows] == names
    assert "HOLD" in names


def test_the_command_says_what_it_left_out(log: Log, tmp_path: Path) -> None:
    arguments = ["export", str(log.path), "--format", "csv", "--merge", "--out", str(tmp_path)]
    told = CliRunner().invoke(command, arguments)
    assert told.exit_code == 0, told.output
    assert f"{TICKS - FIRST} rows  {tmp_path / 'merged.csv'}" in told.output
    assert f"{FIRST} ticks before the first message of a topic left out" in told.output
    with (tmp_path / "merged.csv").open() as file:
        titles = next(csv.reader(file))
    assert titles[:2] == ["time [s]", "tick"]
    assert {"timing.wakeup_us [us]", "tension.measured_7 [N]", "energy.tank [J]"} <= set(titles)
    again = CliRunner().invoke(command, arguments)
    assert "exists already" in str(again.exception)


def test_a_slice_is_merged_from_its_first_tick(log: Log, tmp_path: Path) -> None:
    merged = export_merged(log.between(0.1, 0.15), tmp_path, "csv", ["/tonus/pose"])
    assert (merged.rows, merged.left_out) == (50, 0)


def test_a_damaged_log_is_merged_up_to_the_damage(tmp_path: Path) -> None:
    path = record(tmp_path, TICKS, chunk_ms=20)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    log = open_log(path)
    merged = export_merged(log, tmp_path / "out", "csv", TOPICS)
    assert 0 < merged.rows < TICKS
    assert merged.rows == len(open_log(path).join(*TOPICS))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--format", "csv", "--topics", "/tonus/events"], "no value between its messages"),
        (["--format", "csv", "--topics", "/tonus/keyframe"], "there is no topic /tonus/keyframe"),
        (["--format", "csv", "--topics", "/tonus/poses"], "there is no topic /tonus/poses"),
        (["--format", "blf"], "choose another --format"),
    ],
)
def test_what_cannot_be_merged_is_refused(
    log: Log, tmp_path: Path, options: list[str], words: str
) -> None:
    out = tmp_path / "new"
    told = CliRunner().invoke(
        command, ["export", str(log.path), "--merge", "--out", str(out), *options]
    )
    assert isinstance(told.exception, ToolError)
    assert words in str(told.exception)
    assert not out.exists()


def test_a_topic_without_a_message_is_named_as_the_reason(tmp_path: Path) -> None:
    """Nothing could be held; a table of no rows would be taken for a run of no ticks."""
    log = open_log(seldom(tmp_path, late=TICKS))
    with pytest.raises(ToolError, match="no tick has a value of every topic"):
        export_merged(log, tmp_path / "out", "csv", ["/tonus/pose", "/tonus/truth"])
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", ["csv", "parquet", "mat"])
def test_a_merge_that_fails_leaves_nothing(
    log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    batches = log.batches_in_time

    def broken(topics):
        found = iter(batches(topics))
        for _ in range(8):
            yield next(found)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(log, "batches_in_time", broken)
        with pytest.raises(ToolError, match="No space left"):
            export_merged(log, tmp_path / "new", kind)
    assert not (tmp_path / "new").exists()
    assert export_merged(log, tmp_path / "new", kind).rows
