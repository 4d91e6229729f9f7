"""The least peak speed and tension that physics allows after a torn cable, as computed offline."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from tonus.config.schema.base import NonNegative, Positive, Section, Vector3


class Stop(Section):
    """The optimum of one case."""

    speed: Positive
    """m/s, the platform's origin at its fastest, from the break on"""
    tension: Positive
    """N, the highest of all cables, of a stop at most 2 % faster"""


class Tear(Section):
    """One torn cable at one pose, level and in HOLD."""

    cable: Annotated[int, Field(ge=0)]
    """counted from 0"""
    position: Vector3
    """m"""
    rest: Stop
    towards: Stop | None = None
    """moving at the speed limit towards the torn cable's frame anchor; not at every pose"""
    away: Stop | None = None


class LeastStops(Section):
    computed: str
    """date"""
    model: str
    delay: NonNegative
    """s from the break to the first torque that answers it"""
    speed_limit: Positive
    """m/s of the moving platform"""
    tears: Annotated[tuple[Tear, ...], Field(min_length=1)]
