"""One table over topics: each row is a tick, with the latest message of every topic."""

from __future__ import annotations

import csv
import errno
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.writer import CompressionType, Writer
from pyarrow import parquet
from synthetic_run import MS, Rings, cycles, record, recording, truth

from tests import mat_file
from tonus.runtime.recording.recorder import Recorder
from tonus.tools.cli.log import log as command
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.log.export import export_merged
from tonus.tools.log.merged import BASE, merge, mergeable

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


def written(path: Path, topics: dict[str, list[int]]) -> Path:
    """A log that holds one topic after the other, each in chunks of its own: messages at these
    times in ms, whose value is their time."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=200, compression=CompressionType.NONE)
        writer.start()
        for topic, times in topics.items():
            schema = writer.register_schema(
                "tonus_msgs/msg/X", "ros2msg", b"uint64 tick\nfloat64 value\n"
            )
            channel = writer.register_channel(topic, "cdr", schema)
            for sequence, time in enumerate(times):
                body = struct.pack("<4sQd", b"\0\1\0\0", time, float(time))
                writer.add_message(channel, time * MS, body, time * MS, sequence)
        writer.finish()
    return path


TICKED, SLOW = {BASE: [*range(100)]}, {"/x": [*range(3, 100, 7)]}


@pytest.mark.parametrize(
    "files",
    [[TICKED | SLOW], [SLOW | TICKED], [TICKED, SLOW], [SLOW, TICKED]],
    ids=["ticks_first", "ticks_last", "two_files", "two_files_turned"],
)
def test_a_topic_that_lies_far_from_its_ticks_is_found(
    tmp_path: Path, files: list[dict[str, list[int]]]
) -> None:
    """A recorder empties one ring after the other, so chunks overlap in time; here all do."""
    paths = [written(tmp_path / f"{n}.mcap", topics) for n, topics in enumerate(files)]
    log = open_log(paths)
    parts = [part for part in merge(log, mergeable(log, ["/x"])) if part.count]
    ticks = np.concatenate([part.base[1].values for part in parts])
    values = np.concatenate([part.topics["x"][1].values for part in parts])
    assert ticks.tolist() == [*range(3, 100)]
    assert values.tolist() == [tick - (tick - 3) % 7 for tick in ticks]
    joined = log.join("/x")
    assert joined["x"]["value"].tolist() == values.tolist()


def test_a_table_comes_while_the_log_is_read(tmp_path: Path) -> None:
    """And not at its end: rows whose messages have all been seen are let go."""
    log = open_log(record(tmp_path, TICKS, chunk_ms=20))
    counts = [part.count for part in merge(log, mergeable(log, TOPICS))]
    assert len(counts) > 5
    assert max(counts) < TICKS // 3


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
