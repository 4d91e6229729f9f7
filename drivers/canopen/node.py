"""One CANopen node of the robot and its way to operation."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from tonus.config.schema.bus import Master
from tonus.config.schema.drive import Device, Identity
from tonus.drivers.canopen import nmt
from tonus.drivers.canopen.channel import Channel
from tonus.drivers.canopen.identifiers import NMT, SDO_REQUEST
from tonus.drivers.canopen.nmt import Command, NmtState, NodeMonitor
from tonus.drivers.canopen.sdo import SdoClient
from tonus.drivers.cia301 import pdo
from tonus.drivers.cia301.abort_codes import NO_SUCH_OBJECT
from tonus.drivers.cia301.pdo import Direction
from tonus.drivers.cia301.setting import ObjectAccess, Setting, apply
from tonus.drivers.devices.cia402 import DISABLE_VOLTAGE, FAULT_RESET, decode
from tonus.drivers.devices.drive_errors import Errors, Reset
from tonus.drivers.errors import DriverError, SdoAbortError
from tonus.drivers.fieldbus import Progress
from tonus.drivers.process_image import AxisState

PDOS = 4
"""PDOs each way in the predefined connection set."""
_ERROR_CODE = (0x603F, 0)
_HISTORY = 0x1003
_CONTROLWORD = (0x6040, 0)
_STATUSWORD = (0x6041, 0)
_GENERIC_ERROR = 0x1000
_POWERED = (
    AxisState.OPERATION_ENABLED,
    AxisState.QUICK_STOP_ACTIVE,
    AxisState.FAULT_REACTION_ACTIVE,
)


class NodeError(DriverError):
    """A node is missing or is not the device it should be."""


class Watch(NamedTuple):
    """A heartbeat that a device waits for."""

    whose: str
    node_id: int
    timeout_ms: int


@dataclass(frozen=True)
class Role:
    """What a node is for and what it must hold."""

    title: str
    """for people: drive of axis 3"""
    device: Device
    tpdo: tuple[int, ...]
    settings: tuple[Setting, ...]
    drive: bool = False
    """CiA 402: it has a fault to be reset"""
    watches: tuple[Watch, ...] = ()
    """0x1016, in the order of its entries"""
    transmission: int = pdo.EVERY_SYNC
    """of its PDOs"""
    errors: Errors = field(default_factory=Errors)
    finish: Callable[[ObjectAccess], Awaitable[None]] | None = None
    """called when the settings are in place, to read what depends on them"""


class Node:
    """Brings one device to OPERATIONAL through its channel, by frames alone."""

    def __init__(self, channel: Channel, node_id: int, role: Role, master: Master) -> None:
        self.channel = channel
        self.node_id = node_id
        self.role = role
        self.where = f"{channel.name}/{node_id}"
        self.monitor = NodeMonitor()
        self.configured = False
        self.started = False
        """meant to be operational: what it does of itself is news"""
        self._boots = 0
        """boot-ups before it was configured last"""
        self._master = master
        self._poll_s = master.poll_us * 1e-6
        self.sdo = SdoClient(
            lambda request: channel.send(SDO_REQUEST + node_id, request),
            master.sdo_timeout_ms * 1e-3,
            master.sdo_attempts,
        )

    def command(self, code: Command) -> None:
        self.channel.send(NMT, nmt.command(code, self.node_id))

    async def configure(
        self, progress: Progress, reset: Command = Command.RESET_COMMUNICATION
    ) -> None:
        """Reset, identify, clear a fault, configure, read back; leaves the node pre-operational.

        Raises `DriverError` with the reason.
        """
        self.started = False
        repeated = self.sdo.repeated
        await self._boot(reset)
        revision = await self._identify(self.role.device.identity)
        if self.role.drive:
            await self._clear_fault(progress)
        # What it has answered since it was reset came behind all its boot-ups of before.
        self._boots = self.monitor.boots
        await apply(self.sdo, self.role.settings)
        if self.role.finish is not None:
            await self.role.finish(self.sdo)
        await self._configure_pdos()
        await apply(self.sdo, self._heartbeat_settings())
        self.configured = True
        told = "" if revision is None else f"revision 0x{revision:08X}, "
        again = self.sdo.repeated - repeated
        late = f", {again} SDO transfers repeated: no answer in time" if again else ""
        progress(f"{self.where} {self.role.title}: {told}configured{late}")

    async def start(self) -> None:
        """Raises `NodeError` unless a heartbeat says OPERATIONAL in time, of a node that has not
        restarted since it was configured."""
        self.command(Command.START)
        if not await self._until(
            lambda: self.monitor.state is NmtState.OPERATIONAL, self._master.boot_timeout_ms
        ):
            state = "silent" if self.monitor.state is None else self.monitor.state.words
            raise NodeError(f"started but {state} {self._master.boot_timeout_ms} ms later")
        if self.monitor.boots != self._boots:
            raise NodeError("restarted while it was brought up, and lost its configuration")
        self.started = True

    async def release(self) -> None:
        """Leave the node so that the end of a heartbeat is no fault to it.

        A drive that stays enabled keeps its watches: the silence that follows is what stops it.
        Raises `NodeError` for it, and `SdoError`.
        """
        self.started = False
        if self.role.drive:
            await self._disable()
        for entry, _ in enumerate(self.role.watches, start=1):
            await self.sdo.write(0x1016, entry, bytes(4))

    async def _disable(self) -> None:
        """By SDO: the process data may not have arrived. Raises `NodeError` if it stays enabled."""
        await self.sdo.write(*_CONTROLWORD, DISABLE_VOLTAGE.to_bytes(2, "little"))
        loop = asyncio.get_running_loop()
        end = loop.time() + self._master.sdo_timeout_ms * 1e-3
        while await self._axis_state() in _POWERED:
            if loop.time() >= end:
                raise NodeError("stays enabled; its watches over the heartbeats stay too")
            await asyncio.sleep(self._poll_s)

    async def _axis_state(self) -> AxisState:
        return decode(int.from_bytes(await self.sdo.read(*_STATUSWORD), "little"))

    async def error_code(self) -> int:
        """0x603F of a drive, 0 for no fault. A drive need not have that object (CiA 402): then its
        statusword tells of a fault, as the generic error. Raises `SdoError`."""
        try:
            return int.from_bytes(await self.sdo.read(*_ERROR_CODE), "little")
        except SdoAbortError as error:
            if error.code != NO_SUCH_OBJECT:
                raise
        return _GENERIC_ERROR if await self._axis_state() is AxisState.FAULT else 0

    async def _boot(self, reset: Command) -> None:
        boots = self.monitor.boots
        self.monitor.heard = False
        share = self._master.boot_timeout_ms / self._master.boot_resets
        for _ in range(self._master.boot_resets):
            self.command(reset)
            if await self._until(lambda: self.monitor.boots > boots, share):
                return
        heard = "its heartbeat is received" if self.monitor.heard else "no heartbeat received"
        raise NodeError(
            f"missing: no boot-up within {self._master.boot_timeout_ms} ms of a reset, {heard}"
        )

    async def _identify(self, wanted: Identity | None) -> int | None:
        """The revision; None where any device will do."""

        async def number(subindex: int) -> int:
            return int.from_bytes(await self.sdo.read(0x1018, subindex), "little")

        if wanted is None:
            with contextlib.suppress(SdoAbortError):  # which is an answer too
                await self.sdo.read(0x1000, 0)
            return None
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

    async def _clear_fault(self, progress: Progress) -> None:
        """Clear a fault that is there at the start; communication was reset before, as some need.

        Raises `NodeError` with the fault and what clears it if it stays.
        """
        code = await self.error_code()
        if not code:
            return
        text = f"0x{code:04X} {self.role.errors.text(code)}"
        before = await self._history(code)
        progress(f"{self.where} {self.role.title}: has a fault, {text}{before}")
        if self.role.errors.reset(code) is Reset.DEVICE_RESET:
            await self._boot(Command.RESET_NODE)
        loop = asyncio.get_running_loop()
        end = loop.time() + self._master.boot_timeout_ms * 1e-3
        while await self.error_code():
            if loop.time() >= end:
                raise NodeError(f"its fault stays: {text}{before}")
            for word in (DISABLE_VOLTAGE, FAULT_RESET, DISABLE_VOLTAGE):  # an edge of bit 7
                await self.sdo.write(*_CONTROLWORD, word.to_bytes(2, "little"))
            await asyncio.sleep(self._poll_s)

    async def _history(self, present: int) -> str:
        """Other errors of the history 0x1003, newest first, in words; "" for none."""
        try:
            count = int.from_bytes(await self.sdo.read(_HISTORY, 0), "little")
            codes = [
                int.from_bytes((await self.sdo.read(_HISTORY, place))[:2], "little")
                for place in range(1, min(count, 5) + 1)
            ]
        except SdoAbortError as error:
            if error.code == NO_SUCH_OBJECT:
                return ""
            raise
        others = [f"0x{code:04X}" for code in codes if code != present]
        return f"; before it {', '.join(others)}" if others else ""

    async def _configure_pdos(self) -> None:
        directions = [(Direction.TPDO, self.role.tpdo)]
        if self.role.device.rpdo:
            directions.append((Direction.RPDO, self.role.device.rpdo))
        for direction, entries in directions:
            for number in range(2, PDOS + 1):
                await pdo.silence(self.sdo, direction, number)
            way = self.role.transmission
            await pdo.configure(self.sdo, direction, 1, self.node_id, entries, way)

    def _heartbeat_settings(self) -> tuple[Setting, ...]:
        produce = Setting(0x1017, 0, self.role.device.heartbeat_ms, 2, "heartbeat period, ms")
        consume = (
            Setting(0x1016, entry, each.node_id << 16 | each.timeout_ms, 4,
                    f"watch over the {each.whose}'s heartbeat")
            for entry, each in enumerate(self.role.watches, start=1)
        )  # fmt: skip
        return (*consume, produce)

    async def _until(self, condition: Callable[[], bool], timeout_ms: float) -> bool:
        loop = asyncio.get_running_loop()
        end = loop.time() + timeout_ms * 1e-3
        while not condition():
            if loop.time() >= end:
                return False
            await asyncio.sleep(self._poll_s)
        return True
