"""The optical tracker."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from tonus.config.schema.base import NonNegative, Positive, Section


class Tracker(Section):
    """The optical tracker: one UDP datagram a pose (docs/tracker.md)."""

    address: str
    port: Annotated[int, Field(ge=1, le=65535)]
    rate_hz: Positive
    latency_ms: NonNegative
    """nominal age of a pose when it arrives; the timestamp decides, this only sizes buffers"""
    position_sigma: Positive
    """m"""
    rotation_sigma: Positive
    """rad"""
    maximum_age_ms: Positive
    """without a pose for this long the estimator runs on the cables alone, as a named state"""
