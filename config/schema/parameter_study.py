"""A study of parameters: which runs it consists of, and what is measured of each."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from tonus.config.schema.base import Count, Finite, Positive, Section
from tonus.config.schema.campaign import Span
from tonus.config.schema.controller import ControllerChoice
from tonus.config.schema.realtime import WholeNumber

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_]+$", max_length=60)]


class Steps(Section):
    """Equally spaced values, both ends included; ``log``: by their logarithm; ``whole``: rounded to
    whole numbers."""

    low: Finite
    high: Finite
    steps: Annotated[int, Field(ge=2)]
    log: bool = False
    whole: bool = False

    @model_validator(mode="after")
    def _ordered(self) -> Steps:
        if self.low >= self.high or (self.log and self.low <= 0.0):
            raise ValueError(f"{self.low:g} to {self.high:g} is no range to step through")
        return self


def _sort(value: object) -> str:
    if isinstance(value, dict):
        return "steps" if "steps" in value else "range"
    if isinstance(value, Steps):
        return "steps"
    return "range" if isinstance(value, Span) else "list"


Listed = Annotated[tuple[Any, ...], Field(min_length=1)]
Parameter = Annotated[
    Annotated[Listed, Tag("list")] | Annotated[Steps, Tag("steps")] | Annotated[Span, Tag("range")],
    Discriminator(_sort),
]


class Drawn(Section):
    """How parameters with a range are drawn; all ranges together make one sample."""

    count: Count
    """samples, each combined with everything else"""
    method: Literal["latin_hypercube", "random"] = "latin_hypercube"
    seed: WholeNumber = 1


class Measure(Section):
    """A figure of a run's log."""

    topic: str
    field: str
    index: int | None = None
    """of one element"""
    norm: bool = False
    """the Euclidean length of each sample"""
    during: tuple[str, ...] = ("ACTIVE",)
    """states"""
    take: Literal["rms", "mean", "min", "max", "last"]


class ParameterStudy(Section):
    """Runs of every combination of what is listed here."""

    name: Name
    description: str = ""
    configs: Annotated[tuple[str, ...], Field(min_length=1)]
    """files; a relative one starts from the study's own folder, ``config/`` is the shipped one"""
    scenarios: Annotated[tuple[str, ...], Field(min_length=1)]
    controllers: tuple[ControllerChoice, ...] = ()
    """none: the configuration's"""
    seeds: Count | Annotated[tuple[WholeNumber, ...], Field(min_length=1)] = 1
    """of the lab's noise and plant: how many, from 1 on, or which; every combination has them"""
    duration: Positive | None = None
    """s in ACTIVE; left out: the scenario's"""
    overrides: dict[str, Any] = Field(default_factory=dict)
    """of every run, by dotted keys"""
    parameters: dict[str, Parameter] = Field(default_factory=dict)
    """by dotted key of the configuration: a list, equal steps, or a range to draw from"""
    drawn: Drawn | None = None
    measures: dict[Name, Measure] = Field(default_factory=dict)
    """beside the figures that every run has (docs/studies.md)"""
    indicators: tuple[Name, ...] = ()
    """of the paper's test programme (docs/paper.md, "Indicators"), as figures of every run"""
    shown: tuple[Name, ...] = ("tracking_rms_mm",)
    """figures that the page plots"""
    pareto: tuple[Name, Name] | None = None
    """two figures, both better when smaller"""
    longest: Count = 3600
    """s of processor time after which a run is given up"""
    keep: Literal["figures", "failures", "all"] = "figures"
    """of which runs the logs are kept"""

    @model_validator(mode="after")
    def _drawn_from_ranges(self) -> ParameterStudy:
        ranges = [key for key, value in self.parameters.items() if isinstance(value, Span)]
        if ranges and self.drawn is None:
            raise ValueError(f"{ranges[0]} has a range, so drawn: {{count: N}} is needed")
        if self.drawn is not None and not ranges:
            raise ValueError("drawn is set, and no parameter has a range (low, high)")
        twice = sorted(self.parameters.keys() & self.overrides.keys())
        if twice:
            raise ValueError(f"{twice[0]} stands under parameters and overrides; leave one out")
        return self
