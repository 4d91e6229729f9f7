"""A log in the formats of others gives back the same numbers."""

from __future__ import annotations

import csv
import errno
import os
import sys
from pathlib import Path

import can
import numpy as np
import pytest
from click.testing import CliRunner
from pyarrow import parquet
from synthetic_run import MS, record

from tonus.runtime.signals import TABLE
from tonus.runtime.states import Fault, State
from tonus.tools.cli.log import log as command
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.log.export import export
from tonus.tools.log.names import ENUMERATIONS, named
from tonus.tools.log.tables import to_arrow, to_pandas

TICKS = 300
TOPICS = ["/can/can0", "/can/can1"]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    return open_log(record(tmp_path_factory.mktemp("log"), TICKS, chunk_ms=50))


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_csv_gives_every_number_back_exactly(log: Log, tmp_path: Path) -> None:
    written = export(log, tmp_path, "csv")
    path = written["/tonus/tension"]
    assert path == tmp_path / "tonus_tension.csv"
    rows, tension = rows_of(path), log["/tonus/tension"]
    assert len(rows) == TICKS
    for index in range(8):
        told = [float(row[f"reference_{index} [N]"]) for row in rows]
        assert told == tension["reference"][:, index].tolist()
    assert [float(row["time [s]"]) for row in rows] == [k * MS * 1e-9 for k in range(TICKS)]


def test_csv_names_forces_and_moments_by_their_own_units(log: Log, tmp_path: Path) -> None:
    export(log, tmp_path, "csv", ["/tonus/wrench"])
    titles = list(rows_of(tmp_path / "tonus_wrench.csv")[0])
    assert "external_2 [N]" in titles
    assert "external_3 [N m]" in titles


def test_csv_holds_what_people_wrote(log: Log, tmp_path: Path) -> None:
    export(log, tmp_path, "csv", ["/tonus/events"])
    told = [row["text"] for row in rows_of(tmp_path / "tonus_events.csv")]
    assert told == [event.text for event in log.events()]


@pytest.mark.parametrize("kind", ["asc", "blf"])
def test_frames_come_back_with_their_times(log: Log, tmp_path: Path, kind: str) -> None:
    export(log, tmp_path, kind)
    with can.LogReader(tmp_path / f"run.{kind}") as reader:
        read = list(reader)
    kept = []
    for number, topic in enumerate(TOPICS):
        kept += [
            (int(time), number, int(row["id"]), row["data"].tobytes()[: int(row["dlc"])])
            for time, row in zip(log.times(topic), log[topic], strict=True)
        ]
    kept.sort(key=lambda each: each[0])
    told = [(round(m.timestamp * 1e9), m.channel, m.arbitration_id, bytes(m.data)) for m in read]
    assert told == kept


def test_frames_of_a_run_in_real_time_keep_their_date(tmp_path: Path) -> None:
    """Both formats say when they begin to a millisecond only."""
    begin = 1_800_000_000_123_456_789
    log = open_log(record(tmp_path, 20))
    for place in log._framing.chunks:
        object.__setattr__(place, "start_ns", place.start_ns + begin)
    for topic in TOPICS:
        times = log.times(topic)
        times += begin
    batch = {topic: log._columns[topic] for topic in TOPICS}
    log.batches = lambda _topics: iter([batch])  # type: ignore[method-assign]
    export(log, tmp_path, "blf", TOPICS)
    first = next(iter(can.BLFReader(tmp_path / "run.blf")))
    assert first.timestamp == pytest.approx(begin * 1e-9, abs=1e-6)


def test_a_slice_keeps_the_log_s_time(log: Log, tmp_path: Path) -> None:
    export(log.between(0.1, 0.12), tmp_path, "csv", ["/tonus/timing"])
    rows = rows_of(tmp_path / "tonus_timing.csv")
    assert len(rows) == 20
    assert float(rows[0]["time [s]"]) == pytest.approx(0.1)


def test_parquet_gives_the_numbers_back(log: Log, tmp_path: Path) -> None:
    told = CliRunner().invoke(
        command, ["export", str(log.path), "--format", "parquet", "--out", str(tmp_path)]
    )
    assert told.exit_code == 0, told.output
    table = parquet.read_table(tmp_path / "tonus_tension.parquet")
    assert table.equals(to_arrow(log, "/tonus/tension"))
    assert np.array_equal(table["reference_3"].to_numpy(), log["/tonus/tension"]["reference"][:, 3])
    assert table.schema.field("reference_3").metadata == {b"unit": b"N"}
    events = parquet.read_table(tmp_path / "tonus_events.parquet")
    assert events["text"].to_pylist() == [event.text for event in log.events()]


def test_names_stand_beside_the_numbers(log: Log, tmp_path: Path) -> None:
    export(log, tmp_path, "csv", ["/tonus/state", "/tonus/drives", "/tonus/envelope"])
    rows = rows_of(tmp_path / "tonus_state.csv")
    assert [row["state_name"] for row in rows] == [State(int(row["state"])).name for row in rows]
    assert {(row["fault"], row["fault_name"]) for row in rows} == {
        ("0", "none"),
        (str(int(Fault.CONTACT_LIMIT)), "contact_limit"),
    }
    titles = list(rows[0])
    assert titles.index("stop_mode_name") == titles.index("stop_mode") + 1
    drives = rows_of(tmp_path / "tonus_drives.csv")[0]
    assert [drives[f"state_name_{axis}"] for axis in range(8)] == ["lost"] * 8
    assert [drives[f"command_name_{axis}"] for axis in range(8)] == ["disable"] * 8
    assert {row["grade_name"] for row in rows_of(tmp_path / "tonus_envelope.csv")} == {"green"}


def test_names_are_text_in_parquet_and_categories_in_pandas(log: Log, tmp_path: Path) -> None:
    export(log, tmp_path, "parquet", ["/tonus/state", "/tonus/events"])
    table = parquet.read_table(tmp_path / "tonus_state.parquet")
    expected = [State(int(number)).name for number in log["/tonus/state"]["state"]]
    assert table["state_name"].to_pylist() == expected
    levels = parquet.read_table(tmp_path / "tonus_events.parquet")["level_name"]
    assert set(levels.to_pylist()) == {"info"}
    frame = to_pandas(log, "/tonus/state")
    assert frame["state_name"].tolist() == expected
    assert str(frame["state_name"].dtype) == "category"


def test_a_number_without_a_name_is_named_by_its_digits() -> None:
    """A log of another version may hold one."""
    places, names = named(State, np.array([[5, 77], [77, 0]], np.uint8))
    assert [[names[place] for place in row] for row in places] == [["ACTIVE", "77"], ["77", "OFF"]]


def test_every_enumeration_of_the_table_of_signals_has_names() -> None:
    """The signals' meanings name their enumerations, and what else counts has a reason here."""
    classes = {each.__name__: each for each in ENUMERATIONS.values()}
    for topic in TABLE:
        for field in topic.fields:
            first = field.doc.replace(",", " ").split()[0]
            if first in classes:
                assert ENUMERATIONS[topic.name, field.name] is classes[first], field
    named_fields = {(topic.name, field.name) for topic in TABLE for field in topic.fields}
    assert {each for each in ENUMERATIONS if each[0] != "/tonus/events"} <= named_fields
    small = {
        (topic.name, field.name)
        for topic in TABLE
        for field in topic.fields
        if field.type == "uint8" and (topic.name, field.name) not in ENUMERATIONS
    }
    assert small == {
        ("/tonus/state", "failed"),  # 0 or 1
        ("/tonus/state", "select"),  # numbers of the run's own scenarios
        ("/tonus/state", "unguarded"),  # bits
        ("/tonus/state", "scenario"),
        ("/tonus/force_cells", "status"),  # CiA 404's bits
        ("/tonus/tracker", "fresh"),
        ("/tonus/tracker", "accepted"),
        ("/tonus/tension", "iterations"),
        ("/tonus/tuning", "parameter"),  # numbers of operation.tunable
    }


def test_parquet_has_groups_of_rows_worth_reading(tmp_path: Path) -> None:
    """A chunk of the log is no group: each would cost every reader memory for each column."""
    log = open_log(record(tmp_path, TICKS, chunk_ms=20))
    assert log.chunk_count > 10
    export(log, tmp_path / "out", "parquet", ["/tonus/pose"])
    assert parquet.ParquetFile(tmp_path / "out/tonus_pose.parquet").num_row_groups == 1


def test_a_topic_is_a_data_frame(log: Log) -> None:
    frame, rows = to_pandas(log, "/tonus/tension"), log["/tonus/tension"]
    assert len(frame) == TICKS
    assert np.array_equal(frame["measured_7"], rows["measured"][:, 7])
    assert np.allclose(frame["time"], np.arange(TICKS) * MS * 1e-9)


def test_what_is_not_installed_is_named(
    log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ToolError, match="pip install pyarrow"):
        export(log, tmp_path, "parquet")


def test_what_exists_is_not_overwritten(log: Log, tmp_path: Path) -> None:
    export(log, tmp_path, "blf")
    before = (tmp_path / "run.blf").read_bytes()
    with pytest.raises(ToolError, match="exists already"):
        export(log, tmp_path, "blf")
    assert (tmp_path / "run.blf").read_bytes() == before


def test_a_topic_that_is_not_there_is_named(log: Log) -> None:
    told = CliRunner().invoke(
        command, ["export", str(log.path), "--format", "csv", "--topics", "/tonus/tensions"]
    )
    assert isinstance(told.exception, ToolError)
    assert "there is no topic /tonus/tensions" in str(told.exception)


@pytest.mark.parametrize("kind", ["csv", "parquet", "mat", "asc", "blf"])
def test_an_export_that_fails_leaves_nothing(
    log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """It may be tried again, and no table is taken for a whole one."""
    batches = log.batches

    def broken(topics):
        yield next(iter(batches(topics)))
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(log, "batches", broken)
        with pytest.raises(ToolError, match="No space left"):
            export(log, tmp_path / "new", kind)
        assert not (tmp_path / "new").exists()
    assert any(export(log, tmp_path / "new", kind).values())


def test_a_topic_may_leave_out_what_all_have(log: Log, tmp_path: Path) -> None:
    assert list(export(log, tmp_path, "csv", ["tension"])) == ["/tonus/tension"]
    with pytest.raises(ToolError, match=r"there is no topic tensoin; did you mean tension\?"):
        export(log, tmp_path / "other", "csv", ["tensoin"])
