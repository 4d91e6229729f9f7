"""A recording in several files: rotation, a full disk, a recorder that begins again."""

from __future__ import annotations

import errno
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from synthetic_run import MS, Rings, cycles, record, recording, truth

from tonus.runtime.recording import recorder as recorder_module
from tonus.runtime.recording.mcap_file import McapFile
from tonus.runtime.recording.recorder import Recorder
from tonus.tools.log import open as open_log
from tonus.tools.log.several import segments

TICKS = 900


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob("*.mcap"))


def check_whole(path: Path) -> None:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages()) > 0
        assert {item.name for item in reader.iter_attachments()} == {"config.yaml"}


def test_a_long_run_goes_on_in_another_file_and_reads_as_one(tmp_path: Path) -> None:
    record(tmp_path / "one", TICKS, chunk_ms=50)
    record(tmp_path / "several", TICKS, chunk_ms=50, rotate_s=0.3)
    assert names(tmp_path / "several") == ["run.2.mcap", "run.3.mcap", "run.mcap"]
    for path in (tmp_path / "several").glob("*.mcap"):
        check_whole(path)
    whole, joined = (open_log(tmp_path / run / "run.mcap") for run in ("one", "several"))
    for topic in whole.topics:
        assert np.array_equal(joined[topic], whole[topic]), topic
    assert joined.damage is None
    assert len(joined["/tonus/timing"]) == TICKS


def test_a_segment_by_its_own_name_is_only_itself(tmp_path: Path) -> None:
    record(tmp_path, TICKS, chunk_ms=50, rotate_s=0.3)
    ticks = open_log(tmp_path / "run.2.mcap")["/tonus/timing"]["tick"]
    assert ticks.tolist() == list(range(300, 600))


def test_a_file_of_another_run_is_not_joined(tmp_path: Path) -> None:
    record(tmp_path, 100, seed=1)
    record(tmp_path / "other", 100, seed=2)
    (tmp_path / "other" / "run.mcap").rename(tmp_path / "run.2.mcap")
    log = open_log(tmp_path / "run.mcap")
    assert len(log["/tonus/timing"]) == 100
    assert log.damage == "run.2.mcap is of another run or damaged at its head, and left out"


def test_a_segment_that_cannot_be_read_hides_no_other_and_is_named(tmp_path: Path) -> None:
    record(tmp_path, TICKS, chunk_ms=50, rotate_s=0.3)
    (tmp_path / "run.2.mcap").write_bytes(b"")
    log = open_log(tmp_path / "run.mcap")
    ticks = log["/tonus/timing"]["tick"].tolist()
    assert ticks == [*range(300), *range(600, TICKS)]
    assert log.damage is not None
    assert "run.2.mcap: is empty" in log.damage
    (tmp_path / "run.2.mcap").unlink()
    log = open_log(tmp_path / "run.mcap")
    assert log["/tonus/timing"]["tick"].tolist() == ticks
    assert log.damage == "run.2.mcap is missing"


def test_a_file_that_has_grown_large_is_followed_by_another(tmp_path: Path) -> None:
    record(tmp_path, TICKS, chunk_ms=50, rotate_mb=0.1)
    sizes = [path.stat().st_size for path in tmp_path.glob("*.mcap")]
    assert len(sizes) > 2
    assert max(sizes) < 0.1e6 + 1.2e5, "a chunk more than asked, and the summary"


def test_old_files_are_deleted_only_where_that_is_configured(tmp_path: Path) -> None:
    record(tmp_path, TICKS, chunk_ms=50, rotate_s=0.2, keep_files=2)
    kept = names(tmp_path)
    assert len(kept) == 2
    events = [event for name in kept for event in open_log(tmp_path / name).events()]
    deleted = {event.where for event in events if event.name == "log_deleted"}
    assert deleted
    assert not deleted & set(kept)


class Disk:
    """A disk whose room a test decides."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.full = False
        write = McapFile._write

        def tried(file: McapFile, data: bytes) -> int:
            if self.full:
                write_half = memoryview(data)[: len(data) // 2]
                file._file.write(write_half)
                raise OSError(errno.ENOSPC, "No space left on device")
            return write(file, data)

        monkeypatch.setattr(McapFile, "_write", tried)
        monkeypatch.setattr(Recorder, "_free_bytes", lambda _: 0 if self.full else 10**12)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(monkeypatch)


def run(
    tmp_path: Path, disk: Disk, full: range, capacity: int = 8000, **options: object
) -> Recorder:
    rings = Rings(tmp_path / "rings", capacity)
    rows = cycles(TICKS)
    true = truth(rows)
    recorder = Recorder(
        tmp_path / "rings",
        tmp_path / "run.mcap",
        recording(chunk_ms=50, **options),
        {"seed": "1"},
        {"config.yaml": b"name: synthetic\n"},
        0,
    )
    for k in range(TICKS):
        disk.full = k in full
        rings.tick(k, rows, true)
        if k % 10 == 9:
            recorder.drain()
    recorder.finish()
    return recorder


def test_a_full_disk_stops_the_recording_and_loses_nothing_the_ring_still_holds(
    tmp_path: Path, disk: Disk
) -> None:
    recorder = run(tmp_path, disk, range(300, 600))
    assert names(tmp_path) == ["run.2.mcap", "run.mcap"]
    check_whole(recorder.path)
    log = open_log(tmp_path / "run.mcap")
    assert log["/tonus/timing"]["tick"].tolist() == list(range(TICKS))
    said = {event.name: event for event in log.events()}
    assert "no space left on device" in said["recording_stopped"].text
    assert said["recording_resumed"].text == "in run.2.mcap; 0 cycles are missing"
    assert 300 * MS <= said["recording_stopped"].time_ns < 400 * MS


def test_what_the_ring_could_not_hold_is_counted(tmp_path: Path, disk: Disk) -> None:
    run(tmp_path, disk, range(300, 700), capacity=200)
    log = open_log(tmp_path / "run.mcap")
    missing = TICKS - len(log["/tonus/timing"])
    said = {event.name: event for event in log.events()}
    assert missing > 100
    assert said["recording_resumed"].text == f"in run.2.mcap; {missing} cycles are missing"
    assert int(log.recorded["cycle.ring"]) == missing


def test_a_disk_that_stays_full_leaves_a_whole_file_and_says_so(tmp_path: Path, disk: Disk) -> None:
    recorder = run(tmp_path, disk, range(500, TICKS + 1))
    assert recorder.stopped.endswith("no space left on device")
    assert names(tmp_path) == ["run.mcap"]
    log = open_log(tmp_path / "run.mcap")
    ticks = log["/tonus/timing"]["tick"]
    assert ticks.tolist() == list(range(len(ticks)))
    assert 350 <= len(ticks) <= 500
    assert log.damage == f"the file ends at byte {log.path.stat().st_size} without its summary"


def test_recording_stops_before_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = recorder_module.shutil.disk_usage(tmp_path)
    monkeypatch.setattr(
        recorder_module.shutil, "disk_usage", lambda _: usage._replace(free=50_000_000)
    )
    path = record(tmp_path, 300, keep_free_mb=100.0)
    log = open_log(path)
    assert log.damage is None, "there was room for its summary"
    assert len(log["/tonus/timing"]) == 0


def test_a_recorder_that_begins_again_says_so_in_another_file(tmp_path: Path) -> None:
    rings = Rings(tmp_path / "rings")
    rows = cycles(TICKS)
    true = truth(rows)

    def begin() -> Recorder:
        kept = recording(chunk_ms=50)
        return Recorder(tmp_path / "rings", tmp_path / "run.mcap", kept, {"seed": "1"}, {}, 0)

    recorder = begin()
    for k in range(TICKS):
        rings.tick(k, rows, true)
        if k % 10 == 9:
            recorder.drain()
        if k == 450:
            recorder = begin()  # the first is as good as killed
    recorder.finish()
    log = open_log(tmp_path / "run.mcap")
    assert log["/tonus/timing"]["tick"].tolist() == list(range(TICKS))
    (said,) = (event for event in log.events() if event.name == "recorder_restarted")
    assert said.time_ns // MS == 450


def test_one_killed_before_its_first_chunk_leaves_a_file_that_tells_of_no_restart(
    tmp_path: Path,
) -> None:
    """So files count how often a recorder was killed, and restarts told may be fewer."""
    rings, rows = Rings(tmp_path / "rings"), cycles(TICKS)
    true = truth(rows)

    def begin() -> Recorder:
        return Recorder(
            tmp_path / "rings", tmp_path / "run.mcap", recording(chunk_ms=50), {"seed": "1"}, {}, 0
        )

    recorder = begin()
    for k in range(TICKS):
        rings.tick(k, rows, true)
        if k % 10 == 9:
            recorder.drain()
        if k == 450:
            begin()  # killed before it drains
            recorder = begin()
    recorder.finish()
    log = open_log(tmp_path / "run.mcap")
    assert log["/tonus/timing"]["tick"].tolist() == list(range(TICKS))
    restarts = [event.text for event in log.events() if event.name == "recorder_restarted"]
    assert restarts == ["what is not in an earlier file is in run.3.mcap"]
    assert segments(tmp_path / "run.mcap") == [
        tmp_path / name for name in ("run.mcap", "run.2.mcap", "run.3.mcap")
    ]
