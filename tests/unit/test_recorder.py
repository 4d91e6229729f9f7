"""From rings to a file: complete, deterministic, and readable after whatever happens to it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from tonus.config.schema.control import Recording
from tonus.runtime.recording.recorder import Recorder
from tonus.runtime.recording.ring import RingError, RingReader, RingWriter
from tonus.runtime.recording.taps import KEYFRAME_BYTES, EventRing, FrameRing, KeyframeRing, Level
from tonus.runtime.signals import CycleRecord, cycle_dtype, topics
from tonus.runtime.topics import to_json
from tonus.tools.errors import ToolError
from tonus.tools.log import open as open_log

CYCLE, TOPICS = cycle_dtype(8), topics(8)

TICKS = 800
RECORDING = Recording(ring_s=8.0, chunk_ms=100, compression="zstd", raw_frames=True)


class Run:
    """A small run written to rings; `drain` is called every ``every`` ticks."""

    def __init__(self, folder: Path, *, every: int = 50, finish: bool = True) -> None:
        rings = folder / "rings"
        rings.mkdir(parents=True)
        meta = {"kind": "record", "topics": to_json(TOPICS)}
        cycles = RingWriter.create(rings / "cycle.ring", CYCLE.itemsize, TICKS, meta)
        events = EventRing.open(rings / "events.ring")
        frames = FrameRing.open(rings / "frames.ring", ["can0", "can1"], 8 * TICKS)
        self.path = folder / "run.mcap"
        self.recorder = Recorder(rings, self.path, RECORDING, {"seed": "1"}, {}, 0)
        record = CycleRecord(8)
        self.records = np.zeros(TICKS, CYCLE)
        for tick in range(TICKS):
            record.timing.tick[...] = tick
            record.tension.reference[:] = np.arange(8) + 0.5 * tick
            stamp = tick * 1_000_000
            cycles.publish(record.data, stamp)
            self.records[tick] = record.data[0]
            for channel in (0, 1):
                frames.frame(stamp, channel, 0x181, bytes([tick % 256, channel]), sent=False)
            if tick % 300 == 0:
                events.write(stamp, tick, Level.WARNING, "something", "can0/1", f"in tick {tick}")
            if tick % every == 0:
                self.recorder.drain()
        if finish:
            self.recorder.finish()


def test_what_was_published_is_what_is_read(tmp_path: Path) -> None:
    run = Run(tmp_path)
    log = open_log(run.path)
    for topic in TOPICS:
        short = topic.name.rsplit("/", 1)[1]
        for name in run.records[short].dtype.names:
            assert np.array_equal(log[topic.name][name], run.records[short][name])
        assert np.array_equal(log.times(topic.name), np.arange(TICKS) * 1_000_000)
    assert len(log["/can/can1"]) == TICKS
    assert [event.tick for event in log.events()] == [0, 300, 600]
    assert log.events()[1].where == "can0/1"
    assert log.damage is None


def test_every_checksum_holds(tmp_path: Path) -> None:
    run = Run(tmp_path)
    with run.path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        count = sum(1 for _ in reader.iter_messages())
    assert count == TICKS * (len(TOPICS) + 2) + 3


def test_the_bytes_do_not_depend_on_when_the_rings_are_drained(tmp_path: Path) -> None:
    often, seldom = Run(tmp_path / "a", every=7), Run(tmp_path / "b", every=230)
    assert often.path.read_bytes() == seldom.path.read_bytes()


def test_a_file_without_an_end_is_read_up_to_its_damage(tmp_path: Path) -> None:
    """As a killed recorder leaves it; the ring still holds the rest."""
    run = Run(tmp_path, finish=False)
    log = open_log(run.path)
    assert log.damage
    ticks = log["/tonus/timing"]["tick"]
    assert np.array_equal(ticks, np.arange(len(ticks)))
    left = RingReader.open(tmp_path / "rings" / "cycle.ring")
    assert left.cursor == len(ticks)
    assert left.published == TICKS


@pytest.mark.parametrize("share", [0.0, 0.001, 0.2, 0.5, 0.9, 0.999])
def test_a_file_cut_anywhere_gives_its_whole_chunks(tmp_path: Path, share: float) -> None:
    whole = Run(tmp_path).path.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: int(len(whole) * share)])
    if share < 0.001:
        with pytest.raises(ToolError):
            open_log(cut)
        return
    log = open_log(cut)
    ticks = log["/tonus/timing"]["tick"] if "/tonus/timing" in log else np.empty(0, int)
    assert np.array_equal(ticks, np.arange(len(ticks)))
    assert log.damage or len(ticks) == TICKS, "nothing is lost without a word"


def test_another_program_s_file_is_refused_in_a_line(tmp_path: Path) -> None:
    path = tmp_path / "no.mcap"
    path.write_bytes(b"not a log at all" * 100)
    with pytest.raises(ToolError) as refused:
        open_log(path)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_ring_is_never_written_over(tmp_path: Path) -> None:
    RingWriter.create(tmp_path / "x.ring", 8, 4, {})
    with pytest.raises(FileExistsError):
        RingWriter.create(tmp_path / "x.ring", 8, 4, {})


def test_what_is_no_ring_says_so(tmp_path: Path) -> None:
    path = tmp_path / "x.ring"
    path.write_bytes(bytes(4096))
    with pytest.raises(RingError, match="not a ring file"):
        RingReader.open(path)


def test_a_state_too_large_for_a_keyframe_is_refused_aloud(tmp_path: Path) -> None:
    ring = KeyframeRing.open(tmp_path / "keyframes.ring")
    assert ring.write(0, 1, b"x" * KEYFRAME_BYTES)
    assert not ring.write(0, 2, b"x" * (KEYFRAME_BYTES + 1))
