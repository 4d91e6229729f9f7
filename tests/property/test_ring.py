"""The ring file under any interleaving of writer, reader and reopening."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
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
