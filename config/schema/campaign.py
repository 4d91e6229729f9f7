"""A study of faults: what its episodes are drawn from."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from tonus.config.faults import KINDS
from tonus.config.schema.base import Count, Finite, Fraction, NonNegative, Positive, Section
from tonus.config.schema.controller import ControllerName

BusName = Literal["direct", "can", "ethercat"]
Struck = Literal["REFERENCING", "PRETENSION", "HOLD", "ACTIVE", "SAFE_STOP", "DESCENT"]
"""In which state the first fault is to strike; DESCENT: while the platform is lowered."""
Place = Literal["axis", "cable_cell", "cell", "channel", "node", "drive", "amplifier"]
"""What a fault concerns; `channel` of an EtherCAT segment is its interface."""


class Span(Section):
    """A number from a range, evenly or by its logarithm; ``whole``: an integer."""

    low: Finite
    high: Finite
    log: bool = False
    whole: bool = False
    size: Count | None = None
    """of a vector with each coordinate from the range; without it a number"""

    @model_validator(mode="after")
    def _ordered(self) -> Span:
        if self.low > self.high or (self.log and self.low <= 0.0):
            raise ValueError(f"{self.low:g} to {self.high:g} is no range to draw from")
        return self


class Choice(Section):
    any_of: Annotated[tuple[Any, ...], Field(min_length=1)]


class Kind(Section):
    """How a kind of fault is drawn."""

    buses: tuple[BusName, ...] = ("direct", "can", "ethercat")
    at: Place | None = None
    """fills in axis, cell, channel or node"""
    values: dict[str, Span | Choice] = Field(default_factory=dict)
    """its other fields; what is not named keeps its default"""
    named: bool = False
    """an event has to name its place"""
    phantom: bool = False
    """it needs a scenario with a phantom"""


class Plants(Section):
    """The robots behind the bus."""

    drawn: Fraction
    """share of the episodes on a robot drawn at random; the others have the configuration's"""
    overrides: dict[str, Any]
    """dotted keys of the configuration from which a robot is drawn, with their values"""


class Commands(Section):
    """What an operator does meanwhile."""

    chance: Fraction
    """that there are any"""
    any_of: Annotated[tuple[Literal["start", "hold", "stop", "estop"], ...], Field(min_length=1)]
    most: Count


class Times(Section):
    """s"""

    hold: Positive
    """in HOLD before ACTIVE"""
    active: Positive
    """in ACTIVE in which the first fault may strike"""
    apart: Positive
    """between the first fault and the last, at most"""
    after: tuple[NonNegative, NonNegative]
    """between the last fault and a stop by the operator"""
    tail: NonNegative
    """after the run's end that is looked at, with the drives off"""
    longest: Positive
    """after arming; a run that has not ended by then never will"""
    hang: Count
    """of processor time without an episode's end"""


class Study(Section):
    """Everything an episode is drawn from."""

    name: str
    description: str
    configs: dict[BusName, Annotated[tuple[str, ...], Field(min_length=1)]]
    """configurations by their bus: one a robot"""
    controllers: tuple[ControllerName, ...]
    excluded_controllers: dict[ControllerName, str]
    """with the reason"""
    scenarios: Annotated[tuple[str, ...], Field(min_length=1)]
    overrides: dict[str, Any] = Field(default_factory=dict)
    """dotted keys of every configuration"""
    bus_overrides: dict[BusName, dict[str, Any]] = Field(default_factory=dict)
    """and of those of one bus"""
    plants: Plants
    states: dict[Struck, Positive]
    """with their weights"""
    faults: dict[Literal["one", "two", "three"], Positive]
    """how many in an episode, with weights"""
    left_out: Fraction
    """chance of each kind to be left out of an episode"""
    steered: Fraction
    """share of the pairs that are chosen because they have been drawn least"""
    group: Count
    """episodes that start from one bring-up"""
    replayed: Count
    """one episode in so many is also replayed"""
    commands: Commands
    times: Times
    kinds: dict[str, Kind]
    excluded_kinds: dict[str, str]
    """with the reason"""

    @model_validator(mode="after")
    def _whole(self) -> Study:
        for name, kind in self.kinds.items():
            known = KINDS.get(name)
            if known is None:
                raise ValueError(f"kinds: there is no fault {name!r}")
            for key in kind.values:
                if not known.has(key):
                    raise ValueError(f"kinds.{name}: a {name} has no {key!r}")
        listed = {*self.kinds, *self.excluded_kinds}
        missing = [name for name in KINDS if name not in listed]
        if missing:
            raise ValueError(
                f"kinds: {', '.join(missing)} is not listed; draw it or exclude it with a reason"
            )
        return self

    @property
    def named(self) -> frozenset[str]:
        return frozenset(name for name, kind in self.kinds.items() if kind.named)
