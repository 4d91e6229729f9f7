"""What is to be run, and what it came to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.drivers.fieldbus import Progress
from tonus.runtime.daemon import Outcome
from tonus.runtime.timing.latencies import Latencies
from tonus.runtime.timing.realtime import Grant
from tonus.runtime.timing.scheduler import Pacing


@dataclass(frozen=True)
class Order:
    """The input of `run`: what to run and how. ``say`` gets each line of progress; ``seed``
    determines the lab's noise; ``live``: a status line on the terminal."""

    config: Config
    scenario: Scenario
    out: Path
    seed: int
    virtual: bool
    say: Progress
    live: bool = True
    start_ns: int = 0
    """on the loop's clock: no tick before this time, to align runs with different bring-up"""
    pacing: Callable[[], Pacing] | None = None
    """replaces the pacing of the ticks, for tests"""
    serve: bool = False
    """wait for commands at the control socket, instead of playing the scenario by a script"""
    others: tuple[Scenario, ...] = ()
    """scenarios that an operator may select instead of `scenario`"""
    socket: Path | None = None
    """path of the control socket, instead of the configuration's"""
    link: bool = False
    """make the link ``latest`` beside the folder ``out`` point to it once the run has started"""


@dataclass
class Result:
    """The outcome of a run and the path of its log."""

    outcome: Outcome
    log: Path
    seconds: float
    """s of wall time from the first tick to the last"""
    steal_percent: float | None = None
    grants: list[Grant] = field(default_factory=list)
    unrecorded: str = ""
    """reason why the recording ended before the run; empty: it did not"""
    latencies: Latencies | None = None

    def realtime_factor(self, period: float) -> float:
        """Robot time over wall time; ``period`` of a tick in s."""
        return self.outcome.ticks * period / self.seconds if self.seconds else 0.0
