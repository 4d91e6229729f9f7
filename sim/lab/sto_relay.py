"""The relay in the circuit of the drives' safe torque off inputs, and the node that drives it."""

from __future__ import annotations

from collections.abc import Callable

from tonus.config.schema.sto_relay import StoRelay
from tonus.sim.can.canopen.node import Node
from tonus.sim.can.wire.faulty import FaultyChannel
from tonus.sim.devices.output_node import OutputNode
from tonus.sim.errors import LabError
from tonus.sim.lab.hardware import Hardware

_COIL = _MIRROR = 1
"""bit 0 of the node's outputs, and of its inputs"""
_MS = 1_000_000
WIRE = "sto_relay"
"""of a drive: what takes the voltage of its STO inputs beside the fault `sto`"""


class Relay:
    """Contacts follow the coil, and the drives' power stages the contacts, each after its time;
    that of the coil's last change counts."""

    def __init__(self, hardware: Hardware, relay: StoRelay) -> None:
        self._hardware, self._relay = hardware, relay
        self._changes = 0
        self.node = OutputNode(relay.node_id, self._switch)
        self._set_contacts(closed=False)
        self._set_torque_off(off=True)

    def _switch(self, outputs: int) -> None:
        on = bool(outputs & _COIL)
        self._changes += 1
        number, relay = self._changes, self._relay
        delay_ms = relay.closing_ms if on else relay.release_ms
        self._later(delay_ms, number, lambda: self._moved(number, closed=on))

    def _later(self, delay_ms: float, number: int, then: Callable[[], None]) -> None:
        def due(_: int) -> None:
            if number == self._changes:
                then()

        timeline = self._hardware.timeline
        timeline.call_at(timeline.now_ns + round(delay_ms * _MS), due)

    def _moved(self, number: int, *, closed: bool) -> None:
        self._set_contacts(closed=closed)
        if closed:
            self._set_torque_off(off=False)
        else:
            off_ms = self._relay.torque_off_ms
            self._later(off_ms, number, lambda: self._set_torque_off(off=True))

    def _set_contacts(self, *, closed: bool) -> None:
        """The mirror contact is closed while every other one is open (IEC 60947-4-1)."""
        self.node.inputs = 0 if closed else _MIRROR

    def _set_torque_off(self, *, off: bool) -> None:
        for drive in self._hardware.drives:
            drive.set_input(WIRE, off)


def emulate_relay(hardware: Hardware, relay: StoRelay) -> None:
    """Unless its node is not among those emulated: then the wires of the STO inputs are elsewhere.
    Raises `LabError`."""
    place = (relay.channel, relay.node_id)
    if hardware.emulated is not None and place not in hardware.emulated:
        return
    if relay.channel in hardware.channels:
        raise LabError(f"sto_relay.channel: {relay.channel} is a channel of the fieldbus too")
    if hardware.bitrate not in (0, relay.bitrate):
        raise LabError(
            f"sto_relay.bitrate: the lab's channels have {hardware.bitrate}, not {relay.bitrate}"
        )
    hardware.bitrate = relay.bitrate
    lab = hardware.config
    channel = FaultyChannel(
        relay.channel,
        relay.bitrate,
        lab.bus.queue_depth,
        round(lab.bus.drive_response_us * 1e3),
        recovers=lab.bus.bus_off_recovers,
        rewired=hardware.rewired,
    )
    hardware.channels[relay.channel] = channel
    node = Relay(hardware, relay).node
    hardware.nodes[place] = Node(node, relay.node_id, channel, hardware.timeline)
