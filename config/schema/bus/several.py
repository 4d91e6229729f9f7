"""More than one fieldbus."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field, SerializeAsAny, WrapValidator, field_validator

from tonus.config.schema.bus.base import BusNode, FieldbusSection, Place, once
from tonus.config.schema.bus.canopen import CanopenBus
from tonus.config.schema.bus.cells import Amplifier, ForceCell
from tonus.config.schema.bus.ethercat import EthercatBus
from tonus.config.schema.bus.registry import or_foreign
from tonus.config.schema.drive import DriveProfile

if TYPE_CHECKING:
    Part = FieldbusSection
else:
    Part = Annotated[
        CanopenBus | EthercatBus,
        Field(discriminator="kind"),
        WrapValidator(or_foreign("canopen", "ethercat")),
        SerializeAsAny(),
    ]


class SeveralBuses(FieldbusSection):
    """Devices on more than one fieldbus, all exchanged in the same tick."""

    device: ClassVar[str] = "device"
    listing: ClassVar[str] = "buses"
    kind: Literal["several"]
    buses: Annotated[tuple[Part, ...], Field(min_length=1)]

    @field_validator("buses")
    @classmethod
    def _every_device_once(cls, buses: tuple[FieldbusSection, ...]) -> tuple[FieldbusSection, ...]:
        axes: list[int] = []
        cells: list[int] = []
        for bus in buses:
            more_axes, more_cells = bus.devices
            if not (more_axes or more_cells):
                raise ValueError(f"{bus.kind} lists no nodes; it cannot be one of several")
            axes += more_axes
            cells += more_cells
        once(cls.device, axes, cells)
        return buses

    @property
    def parts(self) -> tuple[FieldbusSection, ...]:
        return self.buses

    def nodes(self) -> Iterator[BusNode]:
        for bus in self.buses:
            yield from bus.nodes()

    def places(self) -> Iterator[Place]:
        for index, bus in enumerate(self.buses):
            for path, kind, number in bus.places():
                yield ("buses", index, *path), kind, number

    def profile(self, axis: int) -> DriveProfile:
        """Of the drive of an axis, on the bus it is on."""
        return next(bus for bus in self.buses if axis in bus.devices[0]).profile(axis)

    @property
    def every_profile(self) -> dict[str, DriveProfile]:
        """By the place in the configuration."""
        return {key: each for bus in self.buses for key, each in bus.every_profile.items()}

    @property
    def force_cell(self) -> ForceCell | Amplifier:
        """Of the first bus with cells."""
        return next(bus.force_cell for bus in self.buses if bus.devices[1])
