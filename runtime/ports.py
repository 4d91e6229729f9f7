"""What the daemon is handed in beside its bus: the tracker, and the ring for its records."""

from __future__ import annotations

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
