"""The CANopen fieldbus: every channel, every node, and the exchange paced by SYNC."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Coroutine
from typing import Any

import can

from tonus.config.schema.bus import CanopenBus
from tonus.config.schema.drive import DriveProfile
from tonus.config.schema.root import Config
from tonus.config.timeouts import master_timeout_ms
from tonus.drivers.canopen.channel import Channel
from tonus.drivers.canopen.channels import Batch, Channels
from tonus.drivers.canopen.identifiers import HEARTBEAT, RPDO1, SDO_RESPONSE, TPDO1
from tonus.drivers.canopen.nmt import Command, NmtState
from tonus.drivers.canopen.node import Node, NodeError, Role, Watch
from tonus.drivers.canopen.process_data import (
    Encode,
    Refusal,
    cell_fields,
    drive_encoder,
    drive_fields,
)
from tonus.drivers.canopen.reception import Field, Reception
from tonus.drivers.canopen.recovery import Recovery
from tonus.drivers.canopen.supervision import Supervision, Watched
from tonus.drivers.canopen.supervisor_monitor import SupervisorMonitor
from tonus.drivers.canopen.syncs import Arrival
from tonus.drivers.cia301.pdo import Mapping
from tonus.drivers.cia301.setting import Setting
from tonus.drivers.devices import drive as drives
from tonus.drivers.devices import force_cell
from tonus.drivers.devices.drive_errors import Errors
from tonus.drivers.errors import BringUpError, DriverError, SdoError
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import NOT_YET, Exchange
from tonus.drivers.fieldbus import BusEvent, FrameTap, Progress
from tonus.drivers.process_image import ProcessImage

OpenBus = Callable[[str], can.BusABC]
Clock = Callable[[], int]

_OPERATIONAL = bytes((NmtState.OPERATIONAL,))


class CanopenFieldbus:
    """A `Fieldbus` on python-can.

    Until the first `collect` a task polls the buses each millisecond and keeps the master's
    heartbeat going; from then on the ticks do both.
    """

    def __init__(
        self,
        config: Config,
        image: ProcessImage,
        tap: FrameTap | None = None,
        *,
        open_bus: OpenBus | None = None,
        clock: Clock | None = None,
    ) -> None:
        """``open_bus`` makes a channel's bus from its name, by default with ``can.Bus``; ``clock``
        gives ns and is the running loop's by default. Raises `DriverError` for a PDO mapping or an
        interpolation period that control cannot work with."""
        if not isinstance(config.fieldbus, CanopenBus):
            raise DriverError(f"fieldbus kind {config.fieldbus.kind} is not canopen")
        period_us = config.control.rates.period_us
        for key, profile in config.fieldbus.every_profile.items():
            drives.require_interpolation(profile, key, period_us)
        self.image = image
        self._config = config
        self._bus = bus = config.fieldbus
        self.channels = tuple(channel.name for channel in bus.channels)
        self._tap = tap
        self._open_bus = open_bus or self._open_with_python_can
        self._clock = clock
        self._events = EventLog()
        places = bus.axis_places
        self._exchange = Exchange(
            config.robot,
            bus.force_cell,
            config.control.freshness,
            image,
            self._events,
            [places.get(axis, self.channels[0]) for axis in range(config.robot.cables)],
        )
        self._period_us = period_us
        self._poll_s = bus.master.poll_us * 1e-6
        self._heartbeat_ticks = max(1, bus.master.heartbeat_ms * 1000 // period_us)
        self._next_heartbeat = 0
        self._next_look = 0
        self._supervision = Supervision(
            self._exchange, self._events, bus.master, config.tolerance, period_us
        )
        # One that holds a relay beats on the relay's channel alone.
        supervisor = config.supervisor if config.relay is None else None
        self._supervisor = SupervisorMonitor(supervisor, period_us, image, self._events)
        self._recovery = Recovery(self._supervision, self._supervisor, self._exchange, self._events)
        self._ticking = False
        self._pump_task: asyncio.Task[None] | None = None
        self._buses: list[Channel] = []
        self._nodes: list[Node] = []
        self._drives: dict[int, Node] = {}
        self._reception: Reception
        self._together: Channels
        """from `start` on"""
        self._outputs: list[tuple[int, Encode]] = []
        """axis and encoder of each RPDO"""
        frames = []
        for number, channel in enumerate(bus.channels):
            for drive in channel.drives:
                encode = drive_encoder(Mapping.of(bus.profile(drive.axis).rpdo))
                self._outputs.append((drive.axis, encode))
                frames.append((number, RPDO1 + drive.node_id, len(encode(0, 0))))
        self._set_points = Batch(frames)

    async def start(self, progress: Progress) -> None:
        """Raises `BringUpError`, one line that names every node that failed and why."""
        started = False
        self._exchange.forget()
        try:
            self._open_channels()
            self._pump_task = asyncio.get_running_loop().create_task(self._pump())
            count = f"{len(self._nodes)} nodes on {len(self._buses)} channels"
            progress(f"resetting and configuring {count}")
            await self._every_node("configured", lambda node: node.configure(progress))
            await self._supervisor.refuse_foreign()
            progress(f"starting {count}")
            await self._every_node("started", lambda node: node.start())
            progress(f"{count} are operational")
            started = True
        finally:
            if not started:
                await self.stop()
        self._events.take()

    def collect(self, tick: int) -> None:
        if not self._ticking:
            self._begin_ticking(tick)
        self._together.drain()
        for channel in self._buses:
            channel.discard_stale()
        self.image.bus_ns = max(channel.syncs.answered_ns for channel in self._buses)
        # The SYNC goes out before the sums are done: its jitter is everybody's sampling jitter.
        self._together.sync(tick)
        self._supervision.look_for_silence(tick)
        self._supervisor.look(tick)
        self.image.supervisor_ignored = self._supervisor.ignored
        self._exchange.fill(tick)

    def publish(self, tick: int) -> None:
        controlwords, torques = self._exchange.commands()
        self._set_points.fill(
            [encode(controlwords[axis], torques[axis]) for axis, encode in self._outputs]
        )
        self._together.send(self._set_points)
        if tick >= self._next_heartbeat:
            self._next_heartbeat = tick + self._heartbeat_ticks
            self._send_heartbeat()
        if tick >= self._next_look:
            self._next_look = tick + self._bus.master.health_ticks
            for channel in self._buses:
                channel.health.look()

    def take_events(self) -> list[BusEvent]:
        return self._events.take()

    async def sdo_read(self, axis: int, index: int, subindex: int) -> bytes:
        return await self._drives[axis].sdo.read(index, subindex)

    async def sdo_write(self, axis: int, index: int, subindex: int, data: bytes) -> None:
        await self._drives[axis].sdo.write(index, subindex, data)

    def distrust(self) -> None:
        """Others may have written to its nodes: `recover` brings each up anew, from a reset of all
        objects on, and until then the robot is not armed."""
        self._supervisor.doubt = True

    async def recover(self) -> None:
        await self._recovery()

    async def stop(self) -> None:
        """Power off, pre-operational, buses closed; safe at any point and more than once."""
        if not self._buses:
            return
        self._ticking = False
        for node in self._nodes:
            node.started = False
        configured = [node for node in self._nodes if node.configured]
        if configured:
            self._set_points.fill([encode(0, 0) for _, encode in self._outputs])
            self._together.send(self._set_points)
            self._together.sync(NOT_YET)
        if self._pump_task is None:
            self._pump_task = asyncio.get_running_loop().create_task(self._pump())
        await asyncio.gather(*(self._release(node) for node in configured))
        # So that the last frames leave before the bus is closed.
        await asyncio.sleep(2 * self._poll_s)
        self._stop_pump()
        for channel in self._buses:
            channel.shutdown()
        self._buses, self._nodes, self._drives = [], [], {}
        self._supervision.clear()
        self._supervisor.forget()
        self.image.supervisor_ignored = False

    # -- bring-up ---------------------------------------------------------------------------

    def _open_with_python_can(self, name: str) -> can.BusABC:
        bus = self._bus
        return can.Bus(interface=bus.interface, channel=name, bitrate=bus.bitrate)

    def _open_channels(self) -> None:
        clock = self._clock or _loop_clock()
        self._reception = Reception(len(self.channels), self._bus.master.late_ticks)
        for number, name in enumerate(self.channels):
            try:
                bus = self._open_bus(name)
            except (can.CanError, OSError, ValueError, ImportError) as error:
                raise BringUpError(
                    f"bring-up failed: {name} cannot be opened on interface "
                    f"{self._bus.interface}: {error}"
                ) from error
            fresh_ticks = self._config.control.freshness.measurement_ticks
            channel = Channel(
                number,
                bus,
                self._bus,
                self._period_us,
                fresh_ticks,
                clock,
                self._tap,
                self._events,
                self._reception,
            )
            self._buses.append(channel)
            drives = self._bus.channels[number].drives
            held = [each.axis for each in drives if self._bus.profile(each.axis).watches_supervisor]
            self._supervisor.listen(channel, held)
            self._add_drives(channel, number)
            self._add_cells(channel, number)
        self._together = Channels(self._buses, clock, self._tap, self._reception)

    def _add_drives(self, channel: Channel, number: int) -> None:
        for drive in self._bus.channels[number].drives:
            axis, profile = drive.axis, self._bus.profile(drive.axis)
            node = self._add_node(channel, drive.node_id, self._drive_role(axis, profile))
            if not profile.watches_supervisor:
                self._supervisor.cannot_stop(node.where)
            mapping = Mapping.of(profile.tpdo)
            arrival = self._arrival(node, mapping, drive_fields(mapping, axis, self._exchange))
            self._supervision.add(Watched(node, arrival, axis=axis))
            self._drives[axis] = node

    def _drive_role(self, axis: int, profile: DriveProfile) -> Role:
        settings = drives.settings(self._config.robot.drive_trains[axis], profile)
        tolerance = self._config.tolerance
        watches = []
        if profile.watches_master:
            timeout_ms = master_timeout_ms(self._bus, profile, tolerance)
            watches.append(Watch("master", self._bus.master.node_id, timeout_ms))
        supervisor = self._config.supervisor
        if supervisor is not None and supervisor.policy != "off" and profile.watches_supervisor:
            watches.append(Watch("supervisor", supervisor.node_id, supervisor.timeout_ms))
        behaviour = profile.on_communication_error
        if behaviour is not None:
            why = "behaviour on a communication error"
            settings = (*settings, Setting(0x1029, 1, behaviour, 1, why))
        return Role(
            f"drive of axis {axis}",
            profile,
            profile.tpdo,
            settings,
            drive=True,
            watches=tuple(watches),
            errors=Errors(profile),
            finish=lambda access: self._exchange.read_scale(axis, access, profile),
        )

    def _add_cells(self, channel: Channel, number: int) -> None:
        device, exchange = self._bus.force_cell, self._exchange
        for cell in self._bus.channels[number].force_cells:
            channels = len(cell.cells)
            tpdo = device.mapping(channels)
            mapping = Mapping.of(tpdo)
            kind = "load cell" if channels == 1 else "load cells"
            title = f"{kind} {', '.join(map(str, cell.cells))}"
            role = Role(title, device, tpdo, force_cell.settings(device, channels))
            node = self._add_node(channel, cell.node_id, role)
            arrival = self._arrival(node, mapping, cell_fields(mapping, cell.cells, exchange))
            self._supervision.add(Watched(node, arrival, cells=cell.cells))

    def _arrival(self, node: Node, mapping: Mapping, fields: list[Field]) -> Arrival:
        """The account of a node's answers, and the way of those into the exchange."""
        size, channel, identifier = mapping.layout.size, node.channel, TPDO1 + node.node_id
        reception, number = self._reception, channel.number
        answer = reception.add(number, identifier, size, fields, self._exchange)
        arrival = Arrival(size, channel.syncs, self._bus.master, self._events, node.where, answer)
        channel.arrivals.append(arrival)
        refuse = Refusal(size, self._events, node.where)

        def decode(data: bytes) -> None:
            if len(data) != size:
                refuse(len(data))
            elif (tick := arrival.book(data)) is not None:
                reception.store(number, answer, data, tick)

        channel.handlers[identifier] = decode
        return arrival

    def _add_node(self, channel: Channel, node_id: int, role: Role) -> Node:
        node = Node(channel, node_id, role, self._bus.master)
        self._nodes.append(node)
        channel.handlers[SDO_RESPONSE + node_id] = node.sdo.receive
        return node

    async def _every_node(
        self, done: str, step: Callable[[Node], Coroutine[Any, Any, None]]
    ) -> None:
        """All nodes at once; the failures of all are told together."""

        async def attempt(node: Node) -> str | None:
            try:
                await step(node)
            except DriverError as error:
                return f"{node.where} ({node.role.title}): {error}"
            return None

        results = await asyncio.gather(*(attempt(node) for node in self._nodes))
        failed = [text for text in results if text is not None]
        if failed:
            raise BringUpError(
                f"{len(failed)} of {len(self._nodes)} nodes could not be {done}: "
                + "; ".join(failed)
            )

    async def _release(self, node: Node) -> None:
        # A node that is gone needs no farewell; one that stays enabled is stopped by the silence.
        with contextlib.suppress(SdoError, NodeError):
            await node.release()
        node.command(Command.ENTER_PRE_OPERATIONAL)

    # -- while no tick runs -----------------------------------------------------------------

    async def _pump(self) -> None:
        loop = asyncio.get_running_loop()
        heartbeat_s = self._bus.master.heartbeat_ms * 1e-3
        due = loop.time()
        while True:
            if loop.time() >= due:
                due = loop.time() + heartbeat_s
                self._send_heartbeat()
            self._together.drain()
            await asyncio.sleep(self._poll_s)

    def _stop_pump(self) -> None:
        if self._pump_task is not None:
            self._pump_task.cancel()
            self._pump_task = None

    def _begin_ticking(self, tick: int) -> None:
        self._ticking = True
        self._stop_pump()
        self._next_heartbeat = self._next_look = tick
        self._supervision.begin(tick)

    def _send_heartbeat(self) -> None:
        for channel in self._buses:
            channel.send(HEARTBEAT + self._bus.master.node_id, _OPERATIONAL)


def _loop_clock() -> Clock:
    loop = asyncio.get_running_loop()
    now_ns: Clock | None = getattr(loop, "now_ns", None)
    return now_ns or (lambda: round(loop.time() * 1e9))
