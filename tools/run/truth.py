"""The lab's truth as a topic: the table of `tonus.sim.lab.truth` put into a ring of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.recording.ring import RingWriter
from tonus.runtime.topics import Field, Topic, to_json
from tonus.sim.lab.truth import TRUTH, TRUTH_FIELDS

TOPIC = Topic(
    "/tonus/truth",
    "tonus_msgs/msg/Truth",
    "true state of the lab's plant; does not exist on a robot",
    tuple(Field(*row) for row in TRUTH_FIELDS),
)


class TruthRing:
    """Where a lab writes its truth, a record each millisecond."""

    def __init__(self, path: Path, capacity: int) -> None:
        meta = {"kind": "record", "topics": to_json([TOPIC])}
        self._ring = RingWriter.create(path, TRUTH.itemsize, capacity, meta)

    def publish(self, record: NDArray[np.void], stamp_ns: int) -> None:
        self._ring.publish(record, stamp_ns)
