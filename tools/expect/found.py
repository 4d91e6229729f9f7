"""An event that was expected and happened."""

from __future__ import annotations

from dataclasses import dataclass

from tonus.tools.log.log import Event


@dataclass(frozen=True)
class Found:
    """The first event that met an expectation."""

    event: Event
    time: float
    """s since the log's first message"""
    after: float
    """s since the moment from which it was expected: the reaction time to a fault"""
