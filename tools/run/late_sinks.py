"""Rings that come later: of a robot that is held before anything of it is recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.recording.taps import Level
from tonus.sim.lab.truth import truth_dtype
from tonus.tools.run.rings import Rings


def _nowhere(*_: object) -> None:
    """Before there are rings."""


class LateSinks:
    """What daemon and lab write goes nowhere, until there are rings for it."""

    def __init__(self, cables: int) -> None:
        self.rings: Rings | None = None
        self.record: NDArray[np.void] = np.zeros(1, truth_dtype(cables))
        """the last truth, which the lab writes anew each millisecond"""
        self.events: list[tuple[int, Level, str, str, str]] = []
        self._truth: Callable[[NDArray[np.void], int], None] = _nowhere
        # What comes several times a tick is passed on without a step between.
        self.publish: Callable[[NDArray[np.void], int], None] = _nowhere
        self.sent: Callable[[Sequence[tuple[int, bytes]], int, int], None] = _nowhere
        self.sent_together: Callable[[NDArray[np.void], int, int], None] = _nowhere
        self.received: Callable[[NDArray[np.void], int, int], None] = _nowhere

    def open(self, rings: Rings) -> None:
        self.rings, self._truth = rings, rings.truth().publish
        self.publish = rings.cycles.publish
        if rings.frames is not None:
            self.sent, self.received = rings.frames.sent, rings.frames.received
            self.sent_together = rings.frames.sent_together

    def truth(self, record: NDArray[np.void], stamp_ns: int) -> None:
        self.record = record
        self._truth(record, stamp_ns)

    def event(
        self, stamp_ns: int, tick: int, level: Level, name: str, where: str = "", text: str = ""
    ) -> None:
        if self.rings is not None:
            self.events.append((stamp_ns, level, name, where, text))
            self.rings.events.write(stamp_ns, tick, level, name, where, text)

    def keyframe(self, stamp_ns: int, tick: int, state: bytes) -> None:
        if self.rings is not None:
            self.rings.keyframes.write(stamp_ns, tick, state)

    def frame(
        self, stamp_ns: int, channel: int, identifier: int, data: bytes, *, sent: bool
    ) -> None:
        if self.rings is not None and self.rings.frames is not None:
            self.rings.frames.frame(stamp_ns, channel, identifier, data, sent=sent)
