"""What every fault has: when it happens."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer

from tonus.config.schema.base import NonNegative, Section

LONGEST_S = 1e6
"""What adds to a time in ns without rounding; more than eleven days."""


class FaultSection(Section):
    model_config = ConfigDict(use_attribute_docstrings=True)

    at: Annotated[NonNegative, Field(le=LONGEST_S)] = 0.0
    """s after the lab sees every drive enabled; through the socket, s from now"""

    @model_serializer(mode="wrap")
    def _with_kind(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """The kind tells one fault from another, so it is written where defaults are left out."""
        written: dict[str, Any] = plain(self)
        return written if "kind" in written else {"kind": getattr(self, "kind", ""), **written}

    def __str__(self) -> str:
        """As `tonus fault` has it, without its time."""
        told = self.model_dump(mode="json", exclude={"at"}, exclude_defaults=True)
        return " ".join([told.pop("kind"), *(f"{key}={value}" for key, value in told.items())])
