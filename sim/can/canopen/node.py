"""A CANopen node round a device: NMT, boot-up, SDO, PDO, SYNC, heartbeats and emergencies."""

from __future__ import annotations

import struct
from collections.abc import Callable
from enum import IntEnum

from tonus.sim.can.canopen.pdo import (
    COUNT,
    RPDO_MAPPING,
    RPDO_PARAMETERS,
    TPDO_MAPPING,
    TPDO_PARAMETERS,
    Pdos,
    ReceivePdo,
    TransmitPdo,
)
from tonus.sim.can.canopen.sdo_server import SdoServer
from tonus.sim.can.wire.channel import Narrow, Wide
from tonus.sim.can.wire.faulty import FaultyChannel
from tonus.sim.can.wire.frame import REMOTE, Frame
from tonus.sim.can.wire.port import Notice
from tonus.sim.devices.cia402.errors import CAN_PASSIVE, HEARTBEAT_LOST, PDO_LENGTH
from tonus.sim.devices.device import Device
from tonus.sim.devices.objects import Entry, Kind
from tonus.sim.devices.timers import Timers
from tonus.sim.errors import LabError

NMT = 0x000
SYNC = 0x080
EMERGENCY = 0x080
SDO_ANSWER = 0x580
SDO_REQUEST = 0x600
ERROR_CONTROL = 0x700
_MS_NS = 1_000_000
_POLL_NS = _MS_NS
"""An event-driven TPDO is looked at once a millisecond, a drive's fastest cycle for it."""
_EMERGENCY = struct.Struct("<HB5x")
_COMMUNICATION = (0x1005, 0x1FFF)
_PRODUCER = 0x1017
_CONSUMER = 0x1016
_ON_ERROR = 0x1029
_BUS_OFF = 0x81FD
_TRANSMIT_OVERFLOW = 0x81FF
_RAISED = {
    Notice.PASSIVE: CAN_PASSIVE,
    Notice.BUS_OFF: _BUS_OFF,
    Notice.OVERFLOW: _TRANSMIT_OVERFLOW,
}
"""What a device makes of its controller's trouble (CiA 301, and the EPOS4's own codes)."""


class Nmt(IntEnum):
    """States as the heartbeat carries them."""

    INITIALISING = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


_STATES = {0x01: Nmt.OPERATIONAL, 0x02: Nmt.STOPPED, 0x80: Nmt.PRE_OPERATIONAL}
"""where an NMT command leads to (CiA 301); to the state of before is no transition"""
_RESET_NODE, _RESET_COMMUNICATION = 0x81, 0x82


def _nothing() -> None:
    """A reset of the communication leaves the device alone."""


class Watch:
    """One entry of the heartbeat consumer; it begins with the first heartbeat heard."""

    __slots__ = ("active", "heard_ns", "timeout_ns")

    def __init__(self, timeout_ns: int) -> None:
        self.timeout_ns = timeout_ns
        self.heard_ns = 0
        self.active = False

    def hear(self, frame: Frame) -> bool:
        """False for a heartbeat that begins the watch."""
        self.heard_ns = frame.stamp_ns
        return self.active


class Node:
    """``device`` at ``node_id`` on ``channel``; boots when the lab calls `boot`."""

    def __init__(
        self, device: Device, node_id: int, channel: FaultyChannel, timers: Timers
    ) -> None:
        self.device = device
        self.node_id = node_id
        self.channel = channel
        self.state = Nmt.INITIALISING
        self.port = channel.attach(listens=False)
        self.port.name = f"node {node_id}"
        self.port.told = self._on_notice
        self._timers = timers
        self._subscribed: list[int] = []
        self._receive: list[ReceivePdo] = []
        self._transmit: list[TransmitPdo] = []
        self._remote: dict[int, TransmitPdo] = {}
        self._watches: dict[int, Watch] = {}
        self._epoch = 0  # timers of an older epoch are stale
        self._beat = 0  # the same for the heartbeat producer
        self._add_objects()
        self._pdos = Pdos(device, node_id, lambda: self.state is Nmt.OPERATIONAL)
        self._sdo = SdoServer(device.objects, self._changed, timers, self._answer_sdo)
        device.on_error = self._emergency

    def _add_objects(self) -> None:
        objects, node = self.device.objects, self.node_id
        objects.names = {
            _CONSUMER: "Consumer heartbeat time",
            _ON_ERROR: "Error behavior",
            0x1200: "SDO server parameter",
        } | objects.names

        def add(index: int, subindex: int, entry: Entry) -> None:
            if (index, subindex) not in objects.entries:  # a data sheet's own stays
                objects.add(index, subindex, entry)

        def relative(name: str, base: int) -> Entry:
            return Entry(name, Kind.U32, "ro", base + node, relative=True)

        add(0x1005, 0, Entry("COB-ID SYNC", Kind.U32, "const", SYNC))
        add(0x1014, 0, relative("COB-ID EMCY", EMERGENCY))
        for number in range(1, self.device.consumers + 1):
            name = f"Consumer {number} heartbeat time"
            add(_CONSUMER, number, Entry(name, Kind.U32, "rw", 0, 0, 0x7FFFFF))
        add(_PRODUCER, 0, Entry("Producer heartbeat time", Kind.U16, "rw", 0))
        if self.device.error_behaviour:
            add(_ON_ERROR, 1, Entry("Communication error", Kind.U8, "rw", 0, 0, 2))
        add(0x1200, 1, relative("COB-ID SDO client to server", SDO_REQUEST))
        add(0x1200, 2, relative("COB-ID SDO server to client", SDO_ANSWER))

    # -- state -----------------------------------------------------------------------------------

    def boot(self) -> None:
        """Switch-on, or the end of a reset."""
        self._sdo.reset()
        self._answer(ERROR_CONTROL + self.node_id, b"\0")
        self._enter(Nmt.PRE_OPERATIONAL)
        self._start_heartbeat()
        self._start_watches()

    def _enter(self, state: Nmt) -> None:
        self.state = state
        self._epoch += 1
        self.device.set_operational(state is Nmt.OPERATIONAL)
        self._compile()

    def _compile(self) -> None:
        """Build the process data anew and listen to what concerns this state."""
        operational = self.state is Nmt.OPERATIONAL
        self._receive = self._pdos.receive() if operational else []
        transmit = self._pdos.transmit() if operational else []
        self._transmit = [pdo for pdo in transmit if pdo.rate]
        self._remote = {pdo.identifier | REMOTE: pdo for pdo in transmit if pdo.remote}
        for pdo in transmit:
            if pdo.event:
                self._look(pdo, self._timers.now_ns, self._epoch)
        self._listen()

    def _listen(self) -> None:
        for identifier in self._subscribed:
            self.channel.unsubscribe(self.port, identifier)
        self._subscribed = []
        if not self.plugged or self.port.errors.off:
            return
        self._subscribe(NMT, self._on_nmt)
        for node, watch in self._watches.items():
            self._subscribe(ERROR_CONTROL + node, self._on_heartbeat, watch.hear)
        if self.state in (Nmt.PRE_OPERATIONAL, Nmt.OPERATIONAL):
            self._subscribe(SDO_REQUEST + self.node_id, self._on_sdo)
        if self._transmit or any(pdo.synchronous for pdo in self._receive):
            self._subscribe(SYNC, self._on_sync)
        for identifier in self._remote:
            self._subscribe(identifier, self._on_remote)
        for pdo in self._receive:
            narrow = pdo.hold if pdo.synchronous else None
            self._subscribe(pdo.identifier, self._receiver(pdo), narrow)

    def _subscribe(self, identifier: int, wide: Wide, narrow: Narrow | None = None) -> None:
        self.channel.subscribe(self.port, identifier, wide, narrow)
        self._subscribed.append(identifier)

    def _changed(self, index: int) -> None:
        """An object was written by SDO."""
        if index == _PRODUCER:
            self._start_heartbeat()
        elif index == _CONSUMER:
            self._start_watches()
        elif any(
            area <= index < area + COUNT
            for area in (RPDO_PARAMETERS, RPDO_MAPPING, TPDO_PARAMETERS, TPDO_MAPPING)
        ):
            # Only a TPDO's inhibit time may change while the node is operational.
            self._epoch += 1
            self._compile()

    @property
    def plugged(self) -> bool:
        """Whether the node is on its channel's wire, and not on one of its own."""
        return self.port.channel is self.channel

    def unplug(self) -> None:
        """Pull the cable: the device runs on, alone and deaf."""
        if self.plugged:
            self.channel.sever(self.port, self._timers.now_ns)
            self._listen()

    def replug(self) -> None:
        self.channel.rejoin(self.port, self._timers.now_ns)
        self._listen()

    def _on_notice(self, notice: Notice, now_ns: int) -> None:
        """The controller is in trouble, or out of it; a device in bus-off hears nothing."""
        del now_ns
        if notice in (Notice.BUS_OFF, Notice.RECOVERED):
            self._listen()
        if notice in _RAISED:
            self.device.fail(_RAISED[notice])

    def power_cycle(self) -> None:
        """Interrupt the supply for an instant. Raises `LabError` if the device cannot bear it."""
        restart = getattr(self.device, "power_cycle", None)
        if restart is None:
            raise LabError(f"node {self.node_id} on {self.channel.name} has no supply to interrupt")
        self.port.channel.restart(self.port)
        self._restart(restart)

    def _restart(self, reset: Callable[[], None]) -> None:
        self.state = Nmt.INITIALISING
        self.device.set_operational(False)
        reset()
        self.device.communication_reset()
        self.device.objects.restore(*_COMMUNICATION)
        self.boot()

    @property
    def transmitted(self) -> list[TransmitPdo]:
        """What it sends on SYNC."""
        return self._transmit

    @property
    def received(self) -> list[ReceivePdo]:
        """What it receives while it is operational."""
        return self._receive

    def hears(self, identifier: int) -> bool:
        """Whether it listens to an identifier on its channel."""
        return identifier in self._subscribed

    # -- frames ----------------------------------------------------------------------------------

    def _answer(self, identifier: int, data: bytes) -> None:
        port = self.port
        port.channel.answer(port, Frame(identifier, data), self._timers.now_ns)

    def _on_nmt(self, frame: Frame) -> None:
        if len(frame.data) < 2 or frame.data[1] not in (0, self.node_id):
            return
        command = frame.data[0]
        state = _STATES.get(command, self.state)
        if state is not self.state:
            self._enter(state)
        elif command == _RESET_NODE:
            self._restart(self.device.reset)
        elif command == _RESET_COMMUNICATION:
            self._restart(_nothing)

    def _on_sdo(self, frame: Frame) -> None:
        if len(frame.data) == 8:
            answer = self._sdo.request(frame.data)
            if answer is not None:
                self._answer_sdo(answer)

    def _answer_sdo(self, data: bytes) -> None:
        if self.state in (Nmt.PRE_OPERATIONAL, Nmt.OPERATIONAL):
            self._answer(SDO_ANSWER + self.node_id, data)

    def _on_sync(self, frame: Frame) -> None:
        """First take what is sent, then apply what was received before."""
        now = frame.stamp_ns
        if self._transmit:
            self.device.sample(now)
            for pdo in self._transmit:
                pdo.phase += 1
                if pdo.phase >= pdo.rate:
                    pdo.phase = 0
                    self.channel.answer(self.port, pdo.frame(), now)
        for received in self._receive:
            data = received.data
            if data is not None:
                received.data = None
                received.apply(data)
                self.device.received(now)

    def _receiver(self, pdo: ReceivePdo) -> Wide:
        def receive(frame: Frame) -> None:
            if len(frame.data) < pdo.length:
                self.device.fail(PDO_LENGTH)
            elif pdo.synchronous:
                pdo.data = frame.data
            else:
                pdo.apply(frame.data)
                self.device.received(frame.stamp_ns)

        return receive

    def _on_remote(self, frame: Frame) -> None:
        """The present values, whatever the transmission type."""
        self.device.sample(frame.stamp_ns)
        self.channel.answer(self.port, self._remote[frame.identifier].frame(), frame.stamp_ns)

    def _look(self, pdo: TransmitPdo, now_ns: int, epoch: int) -> None:
        """Send an event-driven TPDO if it has changed, then look again: after its inhibit time
        exactly, so that what changed meanwhile is not late by a cycle more."""
        if epoch != self._epoch:
            return
        self.device.sample(now_ns)
        frame = pdo.frame()
        wait_ns = _POLL_NS
        if pdo.wants(frame.data, now_ns):
            self.port.channel.answer(self.port, frame, now_ns)
            wait_ns = max(wait_ns, pdo.inhibit_ns)
        self._timers.call_at(now_ns + wait_ns, lambda at_ns: self._look(pdo, at_ns, epoch))

    def _emergency(self, code: int, register: int) -> None:
        if self.state in (Nmt.PRE_OPERATIONAL, Nmt.OPERATIONAL):
            self._answer(EMERGENCY + self.node_id, _EMERGENCY.pack(code, register))

    # -- heartbeats ------------------------------------------------------------------------------

    def _start_heartbeat(self) -> None:
        self._beat += 1
        period_ns = self.device.objects.number(_PRODUCER, 0) * _MS_NS
        if period_ns:
            self._produce(self._timers.now_ns, self._beat, period_ns)

    def _produce(self, now_ns: int, beat: int, period_ns: int) -> None:
        if beat != self._beat:
            return
        port = self.port
        beating = Frame(ERROR_CONTROL + self.node_id, bytes((self.state,)))
        port.channel.answer(port, beating, now_ns)
        self._timers.call_at(
            now_ns + period_ns, lambda at_ns: self._produce(at_ns, beat, period_ns)
        )

    def _start_watches(self) -> None:
        for watch in self._watches.values():
            watch.active = False
        self._watches = {}
        for number in range(1, self.device.consumers + 1):
            word = self.device.objects.number(_CONSUMER, number)
            node, period_ms = word >> 16, word & 0xFFFF
            if node and period_ms:
                self._watches[node] = Watch(period_ms * _MS_NS)
        self._listen()

    def _on_heartbeat(self, frame: Frame) -> None:
        watch = self._watches[frame.identifier - ERROR_CONTROL]
        watch.heard_ns = frame.stamp_ns
        if not watch.active:
            watch.active = True
            self._expect(watch)

    def _expect(self, watch: Watch) -> None:
        self._timers.call_at(
            watch.heard_ns + watch.timeout_ns, lambda at_ns: self._overdue(at_ns, watch)
        )

    def _overdue(self, now_ns: int, watch: Watch) -> None:
        if not watch.active:
            return
        if watch.heard_ns + watch.timeout_ns > now_ns:
            self._expect(watch)
            return
        watch.active = False
        self.device.fail(HEARTBEAT_LOST)
        behaviour = self.device.objects.number(_ON_ERROR, 1) if self.device.error_behaviour else 0
        if behaviour == 0 and self.state is Nmt.OPERATIONAL:
            self._enter(Nmt.PRE_OPERATIONAL)
        elif behaviour == 2:
            self._enter(Nmt.STOPPED)
