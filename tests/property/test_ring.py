"""The ring file under any interleaving of writer, reader and reopening."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tonus.runtime.recording.ring import RingReader, RingWriter

SIZE, CAPACITY = 24, 7
steps = st.lists(
    st.one_of(
        st.tuples(st.just("publish"), st.integers(1, 10)),
        st.tuples(st.just("drain"), st.integers(1, 10)),
        st.just(("commit", 0)),
        st.just(("reopen", 0)),
    ),
    max_size=40,
)


def payload(number: int) -> np.ndarray:
    return np.full(SIZE, number % 251, dtype=np.uint8)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(steps)
def test_every_record_is_read_once_in_order_or_counted_as_lost(
    history: list[tuple[str, int]],
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "any.ring"
        writer = RingWriter.create(path, SIZE, CAPACITY, {"kind": "record"})
        reader = RingReader.open(path)
        written, expected, committed = 0, 0, 0
        for step, count in history:
            if step == "publish":
                for _ in range(count):
                    writer.publish(payload(written), 1000 + written)
                    written += 1
            elif step == "drain":
                lost = reader.lost
                stamps, rows = reader.drain(count)
                overwritten = reader.lost - lost
                assert overwritten == max(0, written - CAPACITY - expected)
                expected += overwritten
                for stamp, row in zip(stamps.tolist(), rows, strict=True):
                    assert stamp == 1000 + expected
                    assert np.array_equal(row, payload(expected))
                    expected += 1
                assert len(stamps) <= count
            elif step == "commit":
                reader.commit()
                committed = expected
            else:
                reader.close()
                reader = RingReader.open(path)
                expected = committed
        assert reader.published == written


def test_a_second_reader_sees_what_comes_and_moves_no_cursor(tmp_path: Path) -> None:
    path = tmp_path / "any.ring"
    writer = RingWriter.create(path, SIZE, CAPACITY, {"kind": "record"})
    writer.publish(payload(0), 1000)
    recorder, before = RingReader.open(path), path.read_bytes()
    viewer = RingReader.look(path)
    assert not len(viewer.drain(CAPACITY)[0]), "it begins with what comes next"
    viewer.position = 0
    assert viewer.drain(CAPACITY)[0].tolist() == [1000]
    with pytest.raises((TypeError, ValueError)):
        viewer.commit()
    assert path.read_bytes() == before
    writer.publish(payload(1), 1001)
    stamps, rows = viewer.drain(CAPACITY)
    assert stamps.tolist() == [1001]
    assert np.array_equal(rows[0], payload(1))
    assert recorder.drain(CAPACITY)[0].tolist() == [1000, 1001]
