"""A frame tap behind the firewall: a bus does not fail because its frames cannot be recorded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tonus.drivers.fieldbus import FrameTap
from tonus.runtime.safety.firewall import Part


class GuardedTap:
    """A `FrameTap` in front of another."""

    def __init__(self, tap: FrameTap, part: Part) -> None:
        self._tap, self._part = tap, part

    def frame(
        self, stamp_ns: int, channel: int, identifier: int, data: bytes, *, sent: bool
    ) -> None:
        self._part.call(lambda: self._tap.frame(stamp_ns, channel, identifier, data, sent=sent))

    def sent(self, frames: Sequence[tuple[int, bytes]], channel: int, now_ns: int) -> None:
        self._part.call(self._tap.sent, frames, channel, now_ns)

    def sent_together(self, frames: NDArray[np.void], channel: int, now_ns: int) -> None:
        self._part.call(self._tap.sent_together, frames, channel, now_ns)

    def received(self, frames: NDArray[np.void], channel: int, now_ns: int) -> None:
        self._part.call(self._tap.received, frames, channel, now_ns)
