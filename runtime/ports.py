"""What the daemon is handed in beside its bus: the tracker, and the ring for its records."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tonus.drivers.fieldbus import BusEvent


class TrackerDoor(Protocol):
    """Brings the tracker's poses into the image."""

    def collect(self, now_ns: int) -> None: ...

    def take_events(self) -> list[BusEvent]: ...


class Ring(Protocol):
    """Where the cycle record goes."""

    def publish(self, payload: NDArray[np.void], stamp_ns: int) -> None: ...


@dataclass(frozen=True)
class Recorded:
    """What of a run is recorded, where whoever keeps the records needs less than all: writing
    them is a sixth of a tick. No log can be replayed without all."""

    stride: int = 1
    """one tick in so many, by the due time; where nothing is regulated the fields of regulation are
    of the last record in which it was"""
    cable_pose: bool = True
    """`pose.cable_position`, `pose.bias` and `pose.residual` of each record; else they are of some
    ticks, and `pose.condition` is not the same to the last bit"""


ALL = Recorded()
