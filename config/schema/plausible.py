"""Bounds within which a robot's values are believed to be in the units they are asked for."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator

from tonus.config.schema.base import Positive, Section


class Bound(Section):
    """One value, or the largest of several."""

    key: Annotated[str, Field(min_length=1)]
    low: Positive
    high: Positive
    unit: str
    mistaken: str
    """the unit that is usually given instead"""
    factor: Positive
    """how many of those make one of ``unit``"""

    @model_validator(mode="after")
    def _ordered(self) -> Bound:
        if not self.low < self.high:
            raise ValueError("low < high must hold")
        return self

    def largest(self, values: Any) -> float:
        """The largest magnitude in a value or in nested tuples of them."""
        if isinstance(values, int | float):
            return abs(float(values))
        return max((self.largest(each) for each in values), default=0.0)


class Plausible(Section):
    bounds: Annotated[tuple[Bound, ...], Field(min_length=1)]
