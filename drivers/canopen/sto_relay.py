"""The relay in the circuit of the drives' safe torque off inputs, beside any fieldbus.

The supervisor holds its output; the daemon configures its node, so that the output is off without
the supervisor's heartbeat, and sees by the mirror contact whether it is closed.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

import can

from tonus.config.schema.root import Config
from tonus.config.schema.sto_relay import StoRelay
from tonus.config.timeouts import node_timeout_ms
from tonus.drivers.canopen import emcy
from tonus.drivers.canopen.channel import Channel, Clock
from tonus.drivers.canopen.channels import Channels
from tonus.drivers.canopen.identifiers import EMCY, HEARTBEAT, RPDO1, SDO_RESPONSE, TPDO1
from tonus.drivers.canopen.master import CanopenFieldbus
from tonus.drivers.canopen.nmt import Command, NmtState
from tonus.drivers.canopen.node import Node, NodeError, Role, Watch
from tonus.drivers.canopen.reception import Reception
from tonus.drivers.canopen.supervisor_monitor import SupervisorMonitor
from tonus.drivers.cia301.pdo import ON_EVENT
from tonus.drivers.cia301.setting import Setting
from tonus.drivers.errors import BringUpError, DriverError
from tonus.drivers.events import EventLog
from tonus.drivers.fieldbus import BusEvent, Fieldbus, Progress
from tonus.drivers.several import SeveralFieldbuses

OpenBus = Callable[[StoRelay], can.BusABC]
_RELEASED = 1
"""bit 0 of the inputs: the mirror contact is closed, so every other contact is open"""
_RESTART_TICKS = 100
"""between two attempts to start a node that its own watch has stopped"""
_ITEM = "sto relay"
_SETTINGS = (
    Setting(0x6206, 1, 0xFF, 1, "error mode of the outputs"),
    Setting(0x6207, 1, 0, 1, "outputs without a heartbeat"),
    # Pre-operational: process data close the relay again only when the daemon has started it.
    Setting(0x1029, 1, 0, 1, "behaviour on a communication error"),
)


class RelayedFieldbus:
    """A `Fieldbus`, and the relay beside it. No drive can be enabled while the relay is open, so
    arming waits for it whatever the supervisor's policy."""

    def __init__(
        self,
        config: Config,
        fieldbus: Fieldbus,
        *,
        open_bus: OpenBus | None = None,
        clock: Clock | None = None,
    ) -> None:
        """``open_bus`` makes the channel's bus, by default with ``can.Bus``; ``clock`` gives ns and
        is the running loop's by default. Raises `DriverError` without a relay."""
        relay, supervisor = config.relay, config.supervisor
        if relay is None or supervisor is None:
            raise DriverError("the configuration has no relay that a supervisor holds")
        self.fieldbus = fieldbus
        """beside which it is"""
        self.image = fieldbus.image
        self.channels = fieldbus.channels
        self._relay, self._config = relay, config
        self._open_bus, self._clock = open_bus or _open_with_python_can, clock
        self._events = EventLog()
        period_us = config.control.rates.period_us
        self._period_us = period_us
        self._supervisor = SupervisorMonitor(supervisor, period_us, self.image, self._events)
        silent_ms = node_timeout_ms(relay, relay.master, config.tolerance)
        self._silent_ticks = max(1, silent_ms * 1000 // period_us)
        # A tick may come right before a heartbeat, and the one before right behind.
        self._watch_ticks = max(1, relay.timeout_ms * 1000 // period_us - 1)
        """silence of the supervisor after which the node's watch may have stopped it"""
        watch = Watch("supervisor", supervisor.node_id, relay.timeout_ms)
        # By time too: a single frame of its inputs may be lost.
        cyclic = Setting(0x1800, 5, relay.heartbeat_ms, 2, "longest time between two TPDOs")
        self._role = Role(
            "relay of the STO inputs",
            relay,
            relay.tpdo,
            (*_SETTINGS, cyclic),
            watches=(watch,),
            transmission=ON_EVENT,
        )
        self._channel: Channel | None = None
        self._wire: Channels
        """the same, from `start` on"""
        self._node: Node | None = None
        self._pump_task: asyncio.Task[None] | None = None
        held_ms = relay.timeout_ms + relay.release_ms + 2 * relay.heartbeat_ms
        self._held_ticks = math.ceil(held_ms * 1000 / period_us)
        """after the supervisor's last heartbeat the contacts have to have opened"""
        self._released: bool | None = None
        """by the mirror contact; None: not reported, or no more"""
        self._reported = False
        self._restarted = self._silent = self._unproven = False
        """`_unproven`: its contacts have not been seen open since the supervisor fell silent"""
        self._stopped = False
        """its watch may have stopped it since it was heard to be operational"""
        self._heard_at = self._reported_at = self._held_at = self._started_at = 0

    # -- bring-up and end ------------------------------------------------------------------------

    async def start(self, progress: Progress) -> None:
        """The relay first: it is to be seen open. Raises a `DriverError`."""
        node = self._begin()
        started = False
        try:
            try:
                await self._bring_up(node, progress)
            except DriverError as error:
                text = f"bring-up failed: {node.where} ({node.role.title}): {error}"
                raise BringUpError(text) from error
            await self._supervisor.refuse_foreign()
            self._events.take()
            await self.fieldbus.start(progress)
            started = True
        finally:
            if not started:
                self._end()

    async def _bring_up(
        self, node: Node, progress: Progress, reset: Command = Command.RESET_COMMUNICATION
    ) -> None:
        """Raises `NodeError` for a relay that does not open without its output."""
        self._released = None
        await node.configure(progress, reset)
        boots = node.monitor.boots
        await asyncio.sleep(self._relay.release_ms * 1e-3)
        inputs = int.from_bytes(await node.sdo.read(0x6000, 1), "little")
        if not inputs & _RELEASED:
            raise NodeError(
                "its mirror contact does not report an open circuit while its output is off: a "
                "contact is welded, or the wire to its input is broken"
            )
        try:
            await node.start()
        finally:
            self._restarted |= node.monitor.boots != boots
        self._restarted = self._silent = self._unproven = self._supervisor.doubt = False

    def _begin(self) -> Node:
        try:
            bus = self._open_bus(self._relay)
        except (can.CanError, OSError, ValueError, ImportError) as error:
            raise BringUpError(
                f"bring-up failed: {self._relay.channel} cannot be opened on interface "
                f"{self._relay.interface}: {error}"
            ) from error
        fresh = self._config.control.freshness.measurement_ticks
        clock = self._clock or _loop_clock()
        reception = Reception(1, self._relay.master.late_ticks)
        channel = self._channel = Channel(
            0, bus, self._relay, self._period_us, fresh, clock, None, self._events, reception
        )
        self._wire = Channels((channel,), clock, None, reception)
        number = self._relay.node_id
        node = self._node = Node(channel, number, self._role, self._relay.master)
        torque_off_ticks = math.ceil(self._relay.torque_off_ms * 1000 / self._period_us)
        axes = range(len(self.image.axes))
        self._supervisor.listen(channel, axes, self._held_ticks + torque_off_ticks)
        handlers = channel.handlers
        handlers[SDO_RESPONSE + number] = node.sdo.receive
        handlers[HEARTBEAT + number] = self._on_heartbeat
        handlers[EMCY + number] = self._on_emcy
        handlers[TPDO1 + number] = self._on_inputs
        handlers[RPDO1 + number] = lambda _: None  # the supervisor's
        self._pump_task = asyncio.get_running_loop().create_task(self._pump())
        return node

    async def stop(self) -> None:
        """The relay keeps its watch, and opens; safe at any point and more than once."""
        try:
            await self.fieldbus.stop()
        finally:
            self._end()

    def _end(self) -> None:
        self._stop_pump()
        channel, node = self._channel, self._node
        if channel is not None and node is not None:
            node.command(Command.STOP)
            channel.shutdown()
        self._channel = self._node = None
        self._supervisor.forget()
        self.image.obstacles.pop(_ITEM, None)
        self.image.unguarded = self.image.supervisor_ignored = False

    async def recover(self) -> None:
        if self._supervisor.doubt:
            _distrust(self.fieldbus)
        node = self._node
        if node is not None:
            # Whatever it has: who has written to it since it was brought up, nobody knows.
            try:
                reset = (
                    Command.RESET_NODE if self._supervisor.doubt else Command.RESET_COMMUNICATION
                )
                await self._bring_up(node, lambda _: None, reset)
            except DriverError as error:
                text = f"{node.role.title}: {error}"
                self._events.add("recovery_failed", node.where, text)
            else:
                text = f"{node.role.title} is operational again"
                self._events.add("recovered", node.where, text)
        await self.fieldbus.recover()

    async def _pump(self) -> None:
        while True:
            self._wire.drain()
            await asyncio.sleep(self._relay.master.poll_us * 1e-6)

    def _stop_pump(self) -> None:
        if self._pump_task is not None:
            self._pump_task.cancel()
            self._pump_task = None

    # -- ticks -----------------------------------------------------------------------------------

    def collect(self, tick: int) -> None:
        if self._pump_task is not None:
            self._stop_pump()
            self._heard_at = self._reported_at = self._held_at = tick
        if self._channel is not None and self._node is not None:
            self._wire.drain()
            self._look(tick, self._node)
        self.fieldbus.collect(tick)
        self.image.supervisor_ignored = self._supervisor.ignored

    def publish(self, tick: int) -> None:
        self.fieldbus.publish(tick)

    def _look(self, tick: int, node: Node) -> None:
        self._supervisor.look(tick)
        if node.monitor.heard:
            node.monitor.heard = False
            self._heard_at = tick
            self._stopped &= node.monitor.state is not NmtState.OPERATIONAL
        elif tick - self._heard_at > self._silent_ticks and not self._silent:
            self._silent = True
            text = f"{node.role.title}: no heartbeat for more than {self._silent_ticks} ticks"
            self._events.begin("heartbeat_lost", node.where, text)
        self._stopped |= self._supervisor.silence(tick) >= self._watch_ticks
        # Whether its output would end with the heartbeat of the supervisor nobody knows.
        self.image.unguarded = self._silent
        if self._reported:
            self._reported = False
            self._reported_at = tick
        elif tick - self._reported_at > self._silent_ticks:
            self._released = None
        if self._supervisor.beating:
            self._held_at = tick
        if self._released or not self._supervisor.beating:
            self._unproven = not self._released
        if self.image.enabling:
            self._tell(node)
        else:
            self._restart(tick, node)
        problem = self._problem(node, tick)
        if problem:
            self.image.obstacles[_ITEM] = problem
        else:
            self.image.obstacles.pop(_ITEM, None)

    def _tell(self, node: Node) -> None:
        """Its watch has stopped a node that is not operational, and its output is off."""
        if self._released or node.monitor.state is not NmtState.OPERATIONAL:
            what = "it opened" if self._released else "its output is off"
            text = (
                f"the drives are enabled, and {what}: none has torque, unless a contact is welded"
            )
            self._events.begin("sto_relay_open", node.where, text)

    def _restart(self, tick: int, node: Node) -> None:
        """A node that its watch has stopped only waits to be started, and its output for the
        supervisor. One that nothing has stopped has restarted, unnoticed, and may wait for no
        heartbeat. Never while a drive is to be enabled."""
        self._events.end("sto_relay_open", node.where)
        stopped = node.monitor.state is NmtState.PRE_OPERATIONAL and node.started
        due = tick - self._started_at >= _RESTART_TICKS
        if stopped and due and not (self._restarted or self._silent):
            if self._stopped:
                self._started_at = tick
                node.command(Command.START)
            else:
                self._has_restarted(node)

    def _problem(self, node: Node, tick: int) -> str:
        if self._restarted:
            return "restarted and lost its configuration; reset"
        if self._silent:
            return "does not answer; check its supply and its cable, then reset"
        if node.monitor.state is not NmtState.OPERATIONAL:
            return "is not operational; reset"
        if self._released is None:
            return "does not report its contacts"
        if self._released:
            self._events.end("sto_relay_stuck", node.where)
            return "is open: the supervisor does not hold it"
        if tick - self._held_at > self._held_ticks:
            text = "is closed although its output is off"
            self._events.begin("sto_relay_stuck", node.where, f"{node.role.title} {text}")
            return f"{text}: a contact is welded"
        if self._unproven:
            return "was not seen to open while the supervisor was silent; reset"
        return ""

    def _on_heartbeat(self, data: bytes) -> None:
        node = self._node
        if node is None:
            return
        state = node.monitor.receive(data)
        if self._events.end("heartbeat_lost", node.where):
            text = f"{node.role.title}: heartbeat received again"
            self._events.counted("heartbeat_back", node.where, text)
            self._silent = False
        if state is NmtState.BOOT_UP and node.started:
            self._has_restarted(node)

    def _has_restarted(self, node: Node) -> None:
        self._restarted, self._released = True, None
        text = f"{node.role.title} restarted and lost its configuration"
        self._events.counted("boot_up", node.where, text)

    def _on_inputs(self, data: bytes) -> None:
        if len(data) == 1:
            self._reported, self._released = True, bool(data[0] & _RELEASED)

    def _on_emcy(self, data: bytes) -> None:
        node, parsed = self._node, emcy.parse(data)
        if node is not None and parsed is not None:
            code, register = parsed
            meaning = node.role.errors.text(code)
            text = f"{node.role.title}: 0x{code:04X}, register 0x{register:02X}: {meaning}"
            self._events.counted("emcy", node.where, text, kind=code)

    # -- the fieldbus' own -----------------------------------------------------------------------

    def take_events(self) -> list[BusEvent]:
        return self._events.take() + self.fieldbus.take_events()

    async def sdo_read(self, axis: int, index: int, subindex: int) -> bytes:
        return await self.fieldbus.sdo_read(axis, index, subindex)

    async def sdo_write(self, axis: int, index: int, subindex: int, data: bytes) -> None:
        await self.fieldbus.sdo_write(axis, index, subindex, data)


def _open_with_python_can(relay: StoRelay) -> can.BusABC:
    return can.Bus(interface=relay.interface, channel=relay.channel, bitrate=relay.bitrate)


def _loop_clock() -> Clock:
    loop = asyncio.get_running_loop()
    now_ns: Clock | None = getattr(loop, "now_ns", None)
    return now_ns or (lambda: round(loop.time() * 1e9))


def _distrust(fieldbus: Fieldbus) -> None:
    """Amplifiers on CAN beside drives on EtherCAT, to which others may have written."""
    if isinstance(fieldbus, SeveralFieldbuses):
        for _, part in fieldbus.parts:
            _distrust(part)
    elif isinstance(fieldbus, CanopenFieldbus):
        fieldbus.distrust()
