"""How the devices hang on their buses, and what each device must be: one file for each kind."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import Field, SerializeAsAny, WrapValidator

from tonus.config.schema.bus.base import (
    BusNode,
    DriveBus,
    FieldbusSection,
    check_devices,
)
from tonus.config.schema.bus.canopen import CanopenBus, CellNode, Channel, DriveNode, Master
from tonus.config.schema.bus.cells import Amplifier, ForceCell
from tonus.config.schema.bus.direct import DirectBus
from tonus.config.schema.bus.ethercat import (
    DistributedClocks,
    EthercatBus,
    EthercatMaster,
    Slave,
)
from tonus.config.schema.bus.registry import SHIPPED, foreign, of_kind, or_foreign
from tonus.config.schema.bus.several import SeveralBuses

__all__ = [
    "SHIPPED",
    "Amplifier",
    "Bus",
    "BusNode",
    "CanopenBus",
    "CellNode",
    "Channel",
    "DirectBus",
    "DistributedClocks",
    "DriveBus",
    "DriveNode",
    "EthercatBus",
    "EthercatMaster",
    "FieldbusSection",
    "ForceCell",
    "Master",
    "SeveralBuses",
    "Slave",
    "check_devices",
    "foreign",
    "of_kind",
]

if TYPE_CHECKING:
    Bus = FieldbusSection
else:
    Bus = Annotated[
        CanopenBus | DirectBus | EthercatBus | SeveralBuses,
        Field(discriminator="kind"),
        WrapValidator(or_foreign(*SHIPPED)),
        SerializeAsAny(),
    ]
"""The ``fieldbus:`` of a configuration, of a shipped kind or another's."""
