"""Timing budgets: what the figures of a run may come to before it counts as failed."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from tonus.config.schema.base import Finite, Number, Section

Signal = Literal[
    "wakeup_us",
    "collect_us",
    "compute_us",
    "publish_us",
    "cycle_us",
    "processor_us",
    "gap_ticks",
    "drive_age_ticks",
    "cell_age_ticks",
    "missed_own",
    "missed_host",
    "lost_records",
]
COUNTS = ("missed_own", "missed_host", "lost_records")
"""signals that are counted; the others are measured in each tick"""


class Limit(Section):
    """One line of the verdict. A counted signal has no percentile: it is judged as a total, or per
    million ticks."""

    signal: Signal
    at: Literal["max", "total", "per_million"] | Annotated[Number, Field(gt=0, lt=100)] = "max"
    """percentile (99.9), max, total or per_million"""
    at_most: Finite

    @model_validator(mode="after")
    def _fits(self) -> Limit:
        counted = self.signal in COUNTS
        if counted != (self.at in ("total", "per_million")):
            have = "total or per_million" if counted else "a percentile or max"
            raise ValueError(f"{self.signal} is judged at {have}, not at {self.at}")
        return self


class Budget(Section):
    name: str
    states: Annotated[
        tuple[Literal["STANDBY", "REFERENCING", "PRETENSION", "HOLD", "ACTIVE", "SAFE_STOP"], ...],
        Field(min_length=1),
    ]
    """the ticks that are judged"""
    limits: Annotated[tuple[Limit, ...], Field(min_length=1)]
