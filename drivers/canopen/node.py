"""One CANopen node of the robot and its way to operation."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from config.schema.bus import Device, Identity, Master
from drivers.canopen import nmt, pdo
from drivers.canopen.channel import Channel
from drivers.canopen.identifiers import NMT, SDO_REQUEST
from drivers.canopen.nmt import Command, NmtState, NodeMonitor
from drivers.canopen.pdo import Direction
from drivers.canopen.sdo import SdoClient
from drivers.errors import DriverError
from drivers.fieldbus import Progress
from drivers.setting import Setting, apply

POLL_S = 0.001
"""How often the buses are looked at while no tick does it."""
RESETS = 2
"""Times a node is reset before it counts as missing: a drive that detects the bit rate by itself
needs traffic before it hears anything."""
PDOS = 4
"""PDOs each way in the predefined connection set."""


class NodeError(DriverError):
    """A node is missing or is not the device it should be."""


@dataclass(frozen=True)
class Role:
    """What a node is for and what it must hold."""

    title: str
    """for people: drive of axis 3"""
    device: Device
    settings: tuple[Setting, ...]
    consumer_ms: int = 0
    """0x1016: how long the device waits for the master's heartbeat, 0 for ever"""


class Node:
    """Brings one device to OPERATIONAL through its channel, by frames alone."""

    def __init__(self, channel: Channel, node_id: int, role: Role, master: Master) -> None:
        self.channel = channel
        self.node_id = node_id
        self.role = role
        self.where = f"{channel.name}/{node_id}"
        self.monitor = NodeMonitor()
        self.configured = False
        self._master = master
        self.sdo = SdoClient(
            lambda request: channel.send(SDO_REQUEST + node_id, request),
            master.sdo_timeout_ms * 1e-3,
        )

    def command(self, code: Command) -> None:
        self.channel.send(NMT, nmt.command(code, self.node_id))

    async def configure(self, progress: Progress) -> None:
        """Reset, identify, configure, read back; leaves the node pre-operational.

        Raises `DriverError` with the reason.
        """
        await self._boot()
        revision = await self._identify(self.role.device.identity)
        await apply(self.sdo, self.role.settings)
        await self._configure_pdos()
        await apply(self.sdo, self._heartbeat_settings())
        self.configured = True
        progress(f"{self.where} {self.role.title}: revision 0x{revision:08X}, configured")

    async def start(self) -> None:
        """Raises `NodeError` unless a heartbeat says OPERATIONAL in time."""
        self.command(Command.START)
        if not await self._until(
            lambda: self.monitor.state is NmtState.OPERATIONAL, self._master.boot_timeout_ms
        ):
            state = "silent" if self.monitor.state is None else self.monitor.state.words
            raise NodeError(f"told to start but {state} {self._master.boot_timeout_ms} ms later")

    async def release(self) -> None:
        """Leave the node so that the end of our heartbeat is no fault to it."""
        if self.role.consumer_ms:
            await self.sdo.write(0x1016, 1, bytes(4))

    async def _boot(self) -> None:
        boots = self.monitor.boots
        share = self._master.boot_timeout_ms / RESETS
        for _ in range(RESETS):
            self.command(Command.RESET_COMMUNICATION)
            if await self._until(lambda: self.monitor.boots > boots, share):
                return
        heard = "its heartbeat is there" if self.monitor.heard else "nothing was heard of it"
        raise NodeError(
            f"missing: no boot-up within {self._master.boot_timeout_ms} ms of a reset, {heard}"
        )

    async def _identify(self, wanted: Identity) -> int:
        async def number(subindex: int) -> int:
            return int.from_bytes(await self.sdo.read(0x1018, subindex), "little")

        for subindex, name, value in ((1, "vendor", wanted.vendor), (2, "product", wanted.product)):
            found = await number(subindex)
            if found != value:
                raise NodeError(f"is another device: {name} 0x{found:08X}, not 0x{value:08X}")
        revision = await number(3)
        if revision < wanted.minimum_revision:
            raise NodeError(
                f"firmware too old: revision 0x{revision:08X}, "
                f"at least 0x{wanted.minimum_revision:08X} is needed"
            )
        return revision

    async def _configure_pdos(self) -> None:
        device = self.role.device
        directions = [(Direction.TPDO, device.tpdo)]
        if device.rpdo:
            directions.append((Direction.RPDO, device.rpdo))
        for direction, entries in directions:
            for number in range(2, PDOS + 1):
                await pdo.silence(self.sdo, direction, number)
            await pdo.configure(self.sdo, direction, 1, self.node_id, entries)

    def _heartbeat_settings(self) -> tuple[Setting, ...]:
        produce = Setting(0x1017, 0, self.role.device.heartbeat_ms, 2, "heartbeat period, ms")
        if not self.role.consumer_ms:
            return (produce,)
        consume = self._master.node_id << 16 | self.role.consumer_ms
        return (Setting(0x1016, 1, consume, 4, "watch over the master's heartbeat"), produce)

    async def _until(self, condition: Callable[[], bool], timeout_ms: float) -> bool:
        loop = asyncio.get_running_loop()
        end = loop.time() + timeout_ms * 1e-3
        while not condition():
            if loop.time() >= end:
                return False
            await asyncio.sleep(POLL_S)
        return True
