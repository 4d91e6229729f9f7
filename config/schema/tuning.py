"""What `tonus tune` searches, on what it judges, and how much it may spend."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from tonus.config.schema.base import Count, NonNegative, Positive, Section
from tonus.config.schema.controller import ControllerName
from tonus.config.schema.scenario import Scenario


class Range(Section):
    """Searched evenly on a logarithmic scale."""

    low: Positive
    high: Positive

    @model_validator(mode="after")
    def _ordered(self) -> Range:
        if not self.low < self.high:
            raise ValueError("low < high must hold")
        return self


class Term(Section):
    weight: NonNegative
    scale: Positive
    """what counts as one, in the term's unit"""


class Cost(Section):
    """J = sum over the scenarios of weight * value / scale."""

    position: Term
    """m, RMS of the true position's error, where nothing is touched"""
    force: Term
    """N, RMS of the true contact force's error, where there is a body"""
    effort: Term
    """N m, RMS of the torque commands' change from tick to tick"""


class TensionDesign(Section):
    """`tonus tune tension`: the gains of the tension loop, by its linear model alone."""

    seed: Annotated[int, Field(ge=0)]
    evaluations: Count
    reserve: Annotated[float, Field(ge=1)]
    """every margin is to be at least so many times its floor"""
    seconds: Positive
    """of the error that is added up"""
    proportional: Range
    integral: Range
    """1/s"""
    damping_rate: Range
    """1/s: rate_damping over the inertia of the robot's default drum"""
    lead: Range


class Tuning(Section):
    seed: Annotated[int, Field(ge=0)]
    evaluations: Count
    """runs of all scenarios for each controller"""
    population: Annotated[int, Field(ge=5)]
    """of the search: differential evolution"""
    failure: Positive
    """cost of a scenario that ends in a fault"""
    cost: Cost
    overrides: dict[str, float]
    """dotted keys of the configuration, for a shorter way to ACTIVE"""
    scenarios: Annotated[tuple[Scenario, ...], Field(min_length=1)]
    tension_loop: TensionDesign
    controllers: dict[ControllerName, Annotated[dict[str, Range], Field(min_length=1)]]
    """what may be varied: dotted keys below ``control``"""
