"""What the daemon is handed in beside its bus: the tracker, and the ring for its records."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tonus.drivers.fieldbus import BusEvent
from tonus.runtime.states import State


class TrackerDoor(Protocol):
    """Brings the tracker's poses into the image."""

    def collect(self, now_ns: int) -> None: ...

    def take_events(self) -> list[BusEvent]: ...


class Ring(Protocol):
    """Where the cycle record goes."""

    def publish(self, payload: NDArray[np.void], stamp_ns: int) -> None: ...


LEFT_OUT = frozenset(
    {
        *("pose.cable_position", "pose.bias", "pose.residual"),
        # From a start that is less near: not the same to the last bit.
        "pose.condition",
        "state.inputs",
        *("timing.due_ns", "timing.missed_own", "timing.missed_host", "timing.page_faults"),
        *("timing.switches", "timing.wakeup_us", "timing.bus_us", "timing.collect_us"),
        *("timing.compute_us", "timing.publish_us", "timing.processor_us", "timing.slack_us"),
        "timing.after_us",
    }
)
"""By topic and name: what only a replay, or one who looks at the host or at the lengths, has use
for."""


@dataclass(frozen=True)
class Recorded:
    """What of a run is recorded, where whoever keeps the records needs less than all: writing
    them is a sixth of a tick. No log can be replayed without all."""

    stride: int = 1
    """one tick in so many, by the due time; where nothing is regulated the fields of regulation are
    of the last record in which it was"""
    states: frozenset[State] = frozenset(State)
    """only the ticks that are in one of these after it was computed"""
    lean: bool = False
    """without what is in `LEFT_OUT`, of which a record then has old values or none"""


ALL = Recorded()
