"""What a held robot is asked, and what it shows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.faults import Fault
from tonus.config.schema.scenario import Scenario
from tonus.runtime.recording.taps import Level
from tonus.runtime.states import Operator, State
from tonus.tools.run.order import Result


class Said(NamedTuple):
    """An event."""

    time: float
    """s since the run was forked"""
    level: Level
    name: str
    where: str
    text: str


@dataclass(frozen=True)
class Seen:
    """What a held robot shows between two ticks."""

    state: State
    fault: str
    """name; NONE without one"""
    time: float
    """s since the run was forked"""
    record: NDArray[np.void]
    """(1,) the cycle record of the last tick"""
    truth: NDArray[np.void]
    """(1,) of the plant, as `/tonus/truth` has it"""
    events: tuple[Said, ...]
    """since the last look"""


@dataclass(frozen=True)
class Request:
    kind: Literal["play", "operate", "advance", "inject", "command", "finish", "end", "close"]
    out: Path | None = None
    """folder of the run, for one that begins"""
    scenario: Scenario | None = None
    ticks: int = 0
    fault: Fault | None = None
    operator: Operator = Operator.NONE
    rings: str | None = None
    """folder for rings, as the asking process has it by now"""
    number: int = 0
    """counts the requests to a robot; its answer carries it"""


@dataclass(frozen=True)
class Answer:
    number: int
    """of the request; with ``over`` and ``error`` also that of the request its run began with"""
    value: Result | Seen | None = None
    error: str = ""
    """why the request was refused, or why the run is over without a result"""
    over: bool = False
    """the run has ended"""
