"""The bus without frames."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from tonus.config.schema.base import NonNegative
from tonus.config.schema.bus.base import DriveBus, Number
from tonus.config.schema.bus.cells import ForceCell


class DirectBus(DriveBus):
    """The same quantities without frames: for campaigns, tuning and comparison."""

    virtual_only: ClassVar[bool] = True
    kind: Literal["direct"]
    axes: dict[Number, str] = Field(default_factory=dict)
    """axis to one of the ``profiles``"""
    force_cell: ForceCell
    sample_offset_us: NonNegative
    """time from the start of the tick to the sampling of every device"""

    def chosen(self) -> dict[int, str]:
        return dict(self.axes)
