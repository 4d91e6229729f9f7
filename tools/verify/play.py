"""Scenarios played in virtual time, each in a folder of its own, on several processors."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.drivers.errors import DriverError
from tonus.runtime.errors import ControllerError
from tonus.runtime.timing import clock
from tonus.sim.errors import LabError
from tonus.tools.draft import write_whole
from tonus.tools.errors import ToolError
from tonus.tools.expect import Run
from tonus.tools.log import open as open_log
from tonus.tools.run.composer import Order, run
from tonus.tools.verify.judge import Verdict, judge


@dataclass(frozen=True)
class Case:
    """One scenario to be played."""

    name: str
    """as it was given"""
    config: Config
    scenario: Scenario
    seed: int
    out: Path


@dataclass(frozen=True)
class Judged:
    """The outcome of a case."""

    name: str
    seconds: float
    """s of wall time"""
    verdicts: list[Verdict]
    refused: str = ""
    """why it cannot be played; empty: it was"""

    @property
    def failed(self) -> bool:
        """An expectation was not met."""
        return any(each.problem for each in self.verdicts)


def play(case: Case) -> Judged:
    """Play and judge one; log and summary stay in its folder."""
    began = clock.wall_seconds()
    order = Order(case.config, case.scenario, case.out, case.seed, True, lambda _: None, live=False)
    try:
        result = run(order)
    except (ControllerError, DriverError, LabError, ToolError) as error:
        return Judged(case.name, clock.wall_seconds() - began, [], f"{case.name}: {error}")
    asked = Run(open_log(result.log), reason=result.outcome.reason)
    write_whole(case.out / "summary.json", json.dumps(asked.summary, indent=2) + "\n")
    verdicts = judge(asked, case.scenario.expect)
    return Judged(case.name, clock.wall_seconds() - began, verdicts)


def play_all(cases: Sequence[Case], jobs: int) -> Iterator[Judged]:
    """In the order of ``cases``."""
    if jobs == 1 or len(cases) == 1:
        yield from map(play, cases)
        return
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(cases)), mp_context=fresh) as pool:
        yield from pool.map(play, cases)
