"""The optical tracker."""

from __future__ import annotations

import ipaddress
import re
import reprlib
from typing import Annotated

from pydantic import AfterValidator, Field

from tonus.config.schema.base import NonNegative, Positive, Section

_LABEL = re.compile(r"(?!-)[A-Za-z0-9_-]{1,63}(?<!-)")
_LONGEST = 253
"""characters of a host name"""


def _address(value: str) -> str:
    """An IPv4 address, or what may be a host name, whose last part is not a number."""
    try:
        ipaddress.IPv4Address(value)
    except ValueError:
        parts = value.removesuffix(".").split(".")
        named = all(map(_LABEL.fullmatch, parts)) and not parts[-1].isdecimal()
        if not named or len(value) > _LONGEST:
            raise ValueError(
                f"{reprlib.repr(value)} is neither an IPv4 address nor a host name; "
                "write one, as 127.0.0.1, or 0.0.0.0 for all addresses of the host"
            ) from None
    return value


class Tracker(Section):
    """The optical tracker: one UDP datagram a pose (docs/tracker.md)."""

    address: Annotated[str, AfterValidator(_address)]
    """where poses are received: an IPv4 address of the host, or its name"""
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
