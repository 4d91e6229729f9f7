"""What every fault has: when it happens."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field

from tonus.config.schema.base import NonNegative, Section

LONGEST_S = 1e6
"""What adds to a time in ns without rounding; more than eleven days."""


class FaultSection(Section):
    model_config = ConfigDict(use_attribute_docstrings=True)

    at: Annotated[NonNegative, Field(le=LONGEST_S)] = 0.0
    """s after the lab saw every drive enabled; at the door, s from now"""
