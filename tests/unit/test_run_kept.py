"""Records that stay in memory."""

from __future__ import annotations

import numpy as np

from tonus.tools.run.kept import Kept

RECORD = np.dtype([("time", "i8"), ("forces", "f8", (40,))])


def record(time: int) -> np.ndarray:
    made = np.zeros(1, RECORD)
    made["time"], made["forces"] = time, time + np.arange(40.0)
    return made


def test_every_record_is_there_however_many_there_are() -> None:
    kept, reused = Kept(RECORD), record(0)
    assert len(kept.rows) == 0
    assert kept.last is None
    kept.publish(reused, 0)
    early = kept.rows
    for time in range(1, 40_000):
        reused[:] = record(time)
        kept.publish(reused, time)
    times = np.arange(40_000)
    np.testing.assert_array_equal(kept.rows["time"], times)
    np.testing.assert_array_equal(kept.rows["forces"], times[:, None] + np.arange(40.0))
    np.testing.assert_array_equal(kept.stamps, times)
    assert kept.last is not None
    assert kept.last["time"] == 39_999
    assert early["time"].tolist() == [0], "what was taken before stays as it was"


def test_a_stride_leaves_the_others_out() -> None:
    kept = Kept(RECORD, stride_ns=10)
    for time in range(95):
        kept.publish(record(time), time)
    assert kept.stamps.tolist() == kept.rows["time"].tolist() == list(range(0, 95, 10))
