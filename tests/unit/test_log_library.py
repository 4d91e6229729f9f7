"""A log in Python: slices, joins, several files as one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import synthetic_run
from synthetic_run import MS, Rings, cycles, record, recording, truth

from tonus.runtime.recording.recorder import Recorder
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.log import open as open_log

TICKS = 600


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    return open_log(record(tmp_path_factory.mktemp("log"), TICKS, chunk_ms=50))


def test_a_slice_holds_the_messages_of_its_time(log: Log) -> None:
    part = log.between(0.1, 0.2)
    assert part["/tonus/timing"]["tick"].tolist() == list(range(100, 200))
    assert np.array_equal(part["/tonus/tension"], log["/tonus/tension"][100:200])
    assert part.span_ns == (100 * MS, 199 * MS + 3000), "a tick's last frame comes 3 us later"
    assert len(part["/can/can0"]) == 200


def test_a_slice_of_a_slice_is_told_in_the_same_time(log: Log) -> None:
    ticks = log.between(0.1, 0.5).between(0.2, 0.21)["/tonus/timing"]["tick"]
    assert ticks.tolist() == list(range(200, 210))


def test_a_slice_without_an_end_goes_on_to_the_last_message(log: Log) -> None:
    assert len(log.between(0.5, float("inf"))["/tonus/timing"]) == 100
    assert not len(log.between(10.0, 20.0)["/tonus/timing"])


def test_a_slice_leaves_the_log_as_it_is(log: Log) -> None:
    log.between(0.0, 0.01).load()
    assert len(log["/tonus/timing"]) == TICKS


def test_a_join_puts_the_topics_of_a_tick_side_by_side(log: Log) -> None:
    rows = log.join("/tonus/tension", "/tonus/truth", "/can/can0")
    assert rows["tick"].tolist() == list(range(TICKS))
    assert np.array_equal(rows["tension"], log["/tonus/tension"])
    assert np.array_equal(rows["truth"], log["/tonus/truth"])
    assert rows["can0"]["id"][0] == 0x181, "the second frame of the tick came after it"


def test_a_join_begins_when_every_topic_has_spoken(log: Log) -> None:
    rows = log.join("/tonus/tension", "/tonus/events")
    first = log.events()[0]
    assert rows["tick"][0] == first.tick
    assert rows["events"]["text"][0] == first.text


def test_batches_hold_everything_once(log: Log) -> None:
    parts = [batch["/tonus/wrench"] for batch in log.batches(["/tonus/wrench"])]
    assert len(parts) == 12
    assert np.array_equal(np.concatenate([p.messages for p in parts]), log["/tonus/wrench"])


@pytest.fixture(scope="module")
def segments(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """What two recorders of the same rings leave, the first of them killed."""
    folder = tmp_path_factory.mktemp("segments")
    rings, rows = Rings(folder / "rings"), cycles(TICKS)
    true = truth(rows)

    def recorder() -> Recorder:
        kept = recording(chunk_ms=50)
        return Recorder(folder / "rings", folder / "run.mcap", kept, {"seed": "1"}, {}, 0)

    first = recorder()
    for k in range(TICKS // 2):
        rings.tick(k, rows, true)
    first.drain()
    second = recorder()
    for k in range(TICKS // 2, TICKS):
        rings.tick(k, rows, true)
    second.finish()
    assert second.path.name == "run.2.mcap"
    return [second.path, first.path]


def test_segments_join_to_the_whole_run(segments: list[Path]) -> None:
    joined = open_log(segments)
    assert np.array_equal(joined["/tonus/timing"]["tick"], np.arange(TICKS))
    assert np.array_equal(joined["/tonus/tension"], cycles(TICKS)["tension"])
    assert len(joined["/can/can1"]) == 2 * TICKS
    assert joined.span_ns is not None
    assert joined.damage is not None
    assert joined.damage.startswith("run.mcap: ")
    assert joined.metadata["seed"] == "1"


def test_a_slice_across_segments_is_one(segments: list[Path]) -> None:
    ticks = open_log(segments).between(0.2, 0.4)["/tonus/timing"]["tick"]
    assert ticks.tolist() == list(range(200, 400))


def test_segments_that_do_not_belong_together_are_refused(
    segments: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    topic = synthetic_run.truth_topic()
    narrower = type(topic)(topic.name, topic.message, topic.doc, topic.fields[:1])
    monkeypatch.setattr(synthetic_run, "truth_topic", lambda: narrower)
    monkeypatch.setattr(synthetic_run, "TRUTH", narrower.dtype)
    monkeypatch.setattr(synthetic_run, "truth", lambda rows: np.zeros(len(rows), narrower.dtype))
    other = synthetic_run.record(tmp_path, 100)
    with pytest.raises(ToolError, match="/tonus/truth differs between the files"):
        open_log([*segments, other]).load()
