"""The lab's truth as a topic: the table of `tonus.sim.lab.truth` put into a ring of its own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.recording.ring import RingWriter
from tonus.runtime.topics import Field, Per, Topic, to_json
from tonus.sim.lab.truth import PER_CABLE, TRUTH_TABLE, truth_dtype

TOPIC = Topic(
    "/tonus/truth",
    "tonus_msgs/msg/Truth",
    "true state of the lab's plant; does not exist on a robot",
    tuple(
        Field(name, kind, Per.CABLE if size == PER_CABLE else size, unit, meaning)
        for name, kind, size, unit, meaning in TRUTH_TABLE
    ),
)
"""Of any robot, as `tonus.runtime.signals.TABLE`."""


class TruthRing:
    """Where a lab writes its truth, a record each millisecond."""

    def __init__(self, path: Path, capacity: int, cables: int, *, touched: bool) -> None:
        meta = {"kind": "record", "topics": to_json([TOPIC.sized(cables)])}
        size = truth_dtype(cables).itemsize
        ring = RingWriter.create(path, size, capacity, meta, touched=touched)
        self.publish: Callable[[NDArray[np.void], int], None] = ring.publish
        """a record and its time, ns"""
