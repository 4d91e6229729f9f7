"""The relay in the circuit of the drives' safe torque off inputs, which the supervisor holds closed
where drives have no heartbeat to wait for; docs/supervisor.md."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator

from tonus.config.schema.base import Count, NodeId, NonNegative
from tonus.config.schema.bus.canopen import Channel, Master
from tonus.config.schema.drive import Device

OUTPUT, INPUT = 0x62000108, 0x60000108
"""CiA 401: 8 digital outputs and 8 digital inputs, their first group. Bit 0 of the outputs is the
coil; bit 0 of the inputs the mirror contact, closed while every contact of the circuit is open."""


class StoRelay(Device):
    """A CANopen node with a digital output and a digital input (CiA 401), alone on a channel with
    supervisor and daemon, whose output has the relay."""

    rpdo: tuple[int, ...] = (OUTPUT,)
    tpdo: tuple[int, ...] = (INPUT,)
    interface: str
    """python-can interface: tonus (the lab), socketcan, or a vendor's"""
    channel: str
    """of its own: no drive and no cell is on it"""
    bitrate: Count
    master: Master
    node_id: NodeId
    timeout_ms: Annotated[Count, Field(le=100)]
    """0x1016:1, how long the node waits for the supervisor's heartbeat before the output is off"""
    closing_ms: Annotated[NonNegative, Field(le=100)]
    """from the output on until the contacts are closed"""
    release_ms: Annotated[NonNegative, Field(le=100)]
    """from the output off until the contacts are open"""
    torque_off_ms: Annotated[NonNegative, Field(le=100)]
    """from there until a drive has no torque, at the latest: the reaction time of its STO inputs"""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The one that it is on, as a bus would list it."""
        return (Channel(name=self.channel),)

    @model_validator(mode="before")
    @classmethod
    def _fixed_mapping(cls, given: Any) -> Any:
        if isinstance(given, dict):
            for name, value in (("rpdo", OUTPUT), ("tpdo", INPUT)):
                if list(given.get(name, (value,))) != [value]:
                    raise ValueError(f"{name} is fixed for a relay; remove it")
        return given

    @model_validator(mode="after")
    def _numbers_differ(self) -> StoRelay:
        if self.node_id == self.master.node_id:
            raise ValueError(f"node_id {self.node_id} is the master's too; give it another")
        return self
