"""Shared field types: SI units, immutable, nothing unknown accepted."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field


def no_boolean(value: Any) -> Any:
    """YAML reads yes and on as true, and pydantic would read true as 1."""
    if isinstance(value, bool):
        raise ValueError(
            f"must be a number, not {str(value).lower()}; YAML takes yes, no, on and off for these"
        )
    return value


def _not_zero(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(vector):
        raise ValueError("has no length; a direction needs one")
    return vector


Number = Annotated[float, BeforeValidator(no_boolean)]
Positive = Annotated[Number, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[Number, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[Number, Field(allow_inf_nan=False)]
Fraction = Annotated[Number, Field(ge=0, le=1)]
Share = Annotated[Number, Field(gt=0, lt=1)]
Count = Annotated[int, BeforeValidator(no_boolean), Field(ge=1)]
Vector3 = tuple[Finite, Finite, Finite]
Direction = Annotated[Vector3, AfterValidator(_not_zero)]
NodeId = Annotated[int, BeforeValidator(no_boolean), Field(ge=1, le=127)]


class Section(BaseModel):
    """A part of the configuration: frozen, and a misspelt key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")
