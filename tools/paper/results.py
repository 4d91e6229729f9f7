"""All trials of a campaign as rows of indicators, and the curves behind some of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Traces = dict[str, Array]
Loader = Callable[[str], Traces | None]
"""The curves of a trial by its key; None where none were kept."""


SAFETY = frozenset(
    {
        "contact_peak",
        "slack_ticks",
        "amber_percent",
        "violation_ticks",
        "violation_longest",
        "tension_max",
        "tension_min",
        "k_eq_min",
        "k_eq_max",
        "tension_rmse",
        "tension_percent",
        "k_eq_outside_ticks",
    }
)
"""Indicators that count even if a fault ended the trial."""


def _no_traces(key: str) -> Traces | None:  # noqa: ARG001
    return None


@dataclass(frozen=True)
class Row:
    """One trial: what it was, what it came to, how it ended."""

    key: str
    stage: int
    """1, 2 or 3; 0 for a drawn plant"""
    case: str
    kind: str
    controller: str
    plant: str
    """model, lab, or plant-017 for one that was drawn"""
    seed: int
    bus: str
    """direct or can"""
    indicators: dict[str, float] = field(default_factory=dict)
    """`metrics.measure`; empty for a trial that broke down"""
    state: str = ""
    """the robot's last state"""
    reason: str = ""
    """why, in words"""
    fault: str = ""
    """its name; empty for a trial that ran to its end"""

    @property
    def drawn(self) -> bool:
        return self.plant.startswith("plant-")

    @property
    def completed(self) -> bool:
        """Whether it ran to its end and could be measured."""
        return not self.fault and bool(self.indicators)

    def get(self, indicator: str) -> float | None:
        """None where it does not exist. Of a trial that a fault cut short only what tells of safety
        counts: the rest would be the accuracy of the time before it went wrong."""
        if self.fault and indicator not in SAFETY:
            return None
        return self.indicators.get(indicator)

    def as_json(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Row:
        """The row of ``as_json``; keys it does not know are left out."""
        return cls(**{name: data[name] for name in cls.__dataclass_fields__ if name in data})


@dataclass
class Results:
    """Rows of a campaign, whole or partial."""

    rows: list[Row]
    traces: Loader = _no_traces
    untuned: str = ""
    """why the controllers are not tuned alike for this robot, in words; empty where they are"""

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def select(
        self,
        *,
        stage: int | None = None,
        case: str | None = None,
        kind: str | Iterable[str] | None = None,
        controller: str | None = None,
        plant: str | None = "lab",
        bus: str | None = "direct",
        seed: int | None = None,
    ) -> Results:
        """The rows that agree with all that is given; None: any. A drawn plant is ``plants``."""
        kinds = None if kind is None else {kind} if isinstance(kind, str) else set(kind)
        chosen = [
            row
            for row in self.rows
            if (stage is None or row.stage == stage)
            and (case is None or row.case == case)
            and (kinds is None or row.kind in kinds)
            and (controller is None or row.controller == controller)
            and (plant is None or row.plant == plant or (plant == "plants" and row.drawn))
            and (bus is None or row.bus == bus)
            and (seed is None or row.seed == seed)
        ]
        return Results(chosen, self.traces, self.untuned)

    def names(self, of: str) -> list[str]:
        """The values of a column (``case``, ``controller``), in the order they first appear."""
        return list(dict.fromkeys(getattr(row, of) for row in self.rows))

    def values(self, indicator: str) -> Array:
        """(n,) of the rows that have it, `Row.get`."""
        found = [row.get(indicator) for row in self.rows]
        return np.array([value for value in found if value is not None], dtype=np.float64)
