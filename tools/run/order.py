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
    """What is to be run, and how."""

    config: Config
    scenario: Scenario
    out: Path
    seed: int
    virtual: bool
    say: Progress
    live: bool = True
    start_ns: int = 0
    """on the loop's clock, no tick before; so that runs of unlike bring-up can be compared"""
    pacing: Callable[[], Pacing] | None = None
    """instead of the usual one: what a test lets the ticks wait for"""
    serve: bool = False
    """wait for commands at the control socket, instead of playing the scenario by a script"""
    others: tuple[Scenario, ...] = ()
    """what an operator may choose instead of `scenario`"""
    socket: Path | None = None
    """of control, instead of the configuration's"""
    link: bool = False
    """let ``latest`` beside the folder ``out`` point to it once the run has started"""


@dataclass
class Result:
    """What a run came to, beside its log."""

    outcome: Outcome
    log: Path
    seconds: float
    """s of wall time from the first tick to the last"""
    steal_percent: float | None = None
    grants: list[Grant] = field(default_factory=list)
    unrecorded: str = ""
    """why the recording ended before the run, in words"""
    latencies: Latencies | None = None

    def realtime_factor(self, period: float) -> float:
        """Run time over wall time."""
        return self.outcome.ticks * period / self.seconds if self.seconds else 0.0
