"""One trial done: what the controller saw and what was really so, tick by tick."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.tools.log.log import Event
from tonus.tools.paper.case import Run

Floats = NDArray[np.float64]


@dataclass
class Trial:
    """The ACTIVE part of a run. All arrays have the same length n, joined on the tick."""

    run: Run
    config: Config
    time: Floats
    """(n,) s since ACTIVE"""
    cycle: dict[str, NDArray[Any]]
    """"pose.position" -> (n, 3): every field of the cycle record, by topic.field"""
    truth: dict[str, NDArray[Any]]
    """every field of the truth record, at the instant of the same tick"""
    state: str
    """the run ended in"""
    reason: str
    fault: str
    """its name, empty for none"""
    events: list[Event] = field(default_factory=list)
    contact_peak: float = 0.0
    """N, the phantom's largest true force over the whole run, a stop by the envelope included"""
    ticks: int = 0
    """of the whole run, from OFF"""
