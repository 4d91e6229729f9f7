"""A small EtherCAT master whose frames go through a function: for virtual time and for tests.

It does what a segment of ours needs and no more: a line of slaves with CoE, sync managers and SII
as ETG prescribes them, distributed clocks with the first slave as reference. It reads no clock but
the one it is given, so the same segment answers the same, byte for byte.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from tonus.config.schema.bus import EthercatBus
from tonus.drivers.cia301.setting import ObjectAccess
from tonus.drivers.errors import BringUpError
from tonus.drivers.ethercat import sii
from tonus.drivers.ethercat.al import ERROR, AlState, name, words
from tonus.drivers.ethercat.coe import Mailbox, Objects
from tonus.drivers.ethercat.frames import (
    FIRST_DATAGRAM,
    HEADER_BYTES,
    Answer,
    Command,
    Datagram,
    build,
    everyone,
    parse,
    position,
    station,
)
from tonus.drivers.ethercat.port import FrameExchange, FramePort, InjectedPort
from tonus.drivers.ethercat.status import AL_CONTROL, StateAccess, StatusFrames
from tonus.drivers.ethercat.wire import FIRST_STATION, Found, Sizes

_TYPE, _STATION, _AL_STATUS, _AL_CODE = 0x0000, 0x0010, 0x0130, 0x0134
_DL_STATUS, _FEATURES = 0x0110, 0x0008
_WATCHDOG_DIVIDER, _WATCHDOG = 0x0400, 0x0420
_EEPROM_OWNER, _FMMU, _SYNC_MANAGER = 0x0500, 0x0600, 0x0800
_LATCH, _PORT1, _LOCAL, _SYSTEM = 0x0900, 0x0904, 0x0918, 0x0910
_OFFSET, _DELAY, _SPEED = 0x0920, 0x0928, 0x0930
_SYNC_ASSIGNED, _SYNC_ACTIVE, _SYNC_START, _SYNC_CYCLE = 0x0980, 0x0981, 0x0990, 0x09A0
_HAS_CLOCK = 0x04
_SYNC0 = 0x03
_SYNC_AHEAD_NS = 100_000_000
"""SYNC0 starts so long after it is switched on."""
_LOGICAL = 0x0001_0000
_TRIES = 5
_FIRST_INDEX = 0x90
_WAITS = 10
"""Looks for an answer that takes its time, each a poll apart."""
_POLL_S = 1e-3
_WATCHDOG_STEP_NS = 100_000
_DIVIDER_100_US = 2498
_ENABLE = 0x01
_READ, _WRITE = 0x01, 0x02


@dataclass
class _Slave:
    """What the master knows of one slave."""

    address: int
    found: Found = field(default_factory=lambda: Found(0, 0, 0))
    image: sii.Image | None = None
    objects: Objects | None = None
    sizes: Sizes = field(default_factory=lambda: Sizes(0, 0))
    outputs_at: int = 0
    inputs_at: int = 0


class _Station:
    """Registers of one slave by its station address."""

    def __init__(self, master: DeterministicMaster, address: int) -> None:
        self._master = master
        self._address = address

    async def read(self, register: int, size: int, *, again: bool = True) -> Answer | None:
        ask = Datagram(Command.FPRD, station(self._address, register), bytes(size))
        return await self._master.transfer(ask, tries=_TRIES if again else 1)

    async def write(self, register: int, data: bytes) -> Answer | None:
        return await self._master.transfer(
            Datagram(Command.FPWR, station(self._address, register), data)
        )


class DeterministicMaster(StateAccess):
    """A `Wire` on any `FramePort`."""

    def __init__(
        self,
        bus: EthercatBus,
        exchange: FrameExchange,
        clock: Callable[[], int],
        beside: FramePort | None = None,
        states: FramePort | None = None,
    ) -> None:
        """``exchange`` is the segment, ``clock`` gives ns of the loop's time. ``beside`` is a port
        for another master's help: it carries what is not process data. ``states`` is one for what
        `StateAccess` sends, where that is not the segment: a ring's ends."""
        super().__init__()
        self.inputs: list[bytes] = []
        self.reference_ns: int | None = None
        self._bus = bus
        self._clock = clock
        self._acyclic: FramePort = beside or InjectedPort(exchange, clock)
        self._cyclic: FramePort = InjectedPort(exchange, clock)
        self._states: FramePort = states or InjectedPort(exchange, clock)
        self._frame_ns = round(bus.clocks.frame_us * 1e3)
        self._slaves: list[_Slave] = []
        self._index = _FIRST_INDEX
        self._cycle_index = 0
        self._watchdog_ms = 0  # known once `map` tells it
        self._question: list[Datagram] = []
        self._template = bytearray()
        self._expected = 0
        self._outputs: list[tuple[int, int]] = []

    # -- datagrams --------------------------------------------------------------------------

    async def transfer(self, datagram: Datagram, tries: int = _TRIES) -> Answer | None:
        """One datagram in a frame of its own; None when it did not come back."""
        port = self._acyclic
        for _ in range(tries):
            self._index = self._index + 1 if self._index < 0xFF else _FIRST_INDEX
            port.send(build(self._index, [datagram]))
            for _ in range(1 if port.instant else _WAITS):
                if not port.instant:
                    await asyncio.sleep(_POLL_S)
                while (frame := port.receive()) is not None:
                    answers = parse(frame, self._index, [datagram])
                    if answers is not None:
                        return answers[0]
        return None

    def know(self, slaves: int) -> None:
        """So many slaves, which another master has brought up."""
        self._slaves = [_Slave(FIRST_STATION + number) for number in range(slaves)]

    async def registers(self, slave: int, register: int, size: int) -> bytes:
        """Raises `BringUpError`."""
        return await self._read(self._slaves[slave], register, size)

    async def set_registers(self, slave: int, register: int, data: bytes) -> None:
        """Raises `BringUpError`."""
        await self._write(self._slaves[slave], register, data)

    async def _write(self, slave: _Slave, register: int, data: bytes) -> None:
        """Raises `BringUpError` unless the slave took it."""
        answer = await self.transfer(Datagram(Command.FPWR, station(slave.address, register), data))
        self._require(slave, register, answer)

    async def _read(self, slave: _Slave, register: int, size: int) -> bytes:
        answer = await self.transfer(
            Datagram(Command.FPRD, station(slave.address, register), bytes(size))
        )
        return self._require(slave, register, answer)

    def _require(self, slave: _Slave, register: int, answer: Answer | None) -> bytes:
        if answer is None or not answer.counter:
            what = "the frame was lost" if answer is None else "it does not answer"
            raise BringUpError(
                f"{self._bus.interface}/{self._slaves.index(slave) + 1}: register "
                f"0x{register:04X}: {what}"
            )
        return answer.data

    # -- bring-up ---------------------------------------------------------------------------

    async def scan(self) -> list[Found]:
        answer = await self.transfer(Datagram(Command.BRD, everyone(_TYPE), bytes(1)))
        count = answer.counter if answer is not None else 0
        if not count:
            raise BringUpError(f"bring-up failed: no slave answers on {self._bus.interface}")
        await self.transfer(Datagram(Command.BWR, everyone(_SYNC_ACTIVE), b"\0"))
        reset = (AlState.INIT | ERROR).to_bytes(2, "little")
        await self.transfer(Datagram(Command.BWR, everyone(AL_CONTROL), reset))
        self._slaves = [_Slave(FIRST_STATION + number) for number in range(count)]
        for number in range(count):
            await self._start_slave(number)
        self.states = StatusFrames(self._states, [slave.address for slave in self._slaves])
        return [slave.found for slave in self._slaves]

    async def _start_slave(self, number: int) -> None:
        """From anything to PREOP: an address, what the SII says, a mailbox."""
        slave = self._slaves[number]
        address = slave.address.to_bytes(2, "little")
        answer = await self.transfer(Datagram(Command.APWR, position(number, _STATION), address))
        self._require(slave, _STATION, answer)
        await self._change(slave, AlState.INIT)
        # Nothing of an earlier master may be left: a map, a sync manager, a clock that is started.
        await self._write(slave, _FMMU, bytes(48))
        await self._write(slave, _SYNC_MANAGER, bytes(32))
        registers = _Station(self, slave.address)
        slave.image = image = await sii.read(registers, f"{self._bus.interface}/{number + 1}")
        slave.found = Found(image.vendor, image.product, image.revision, image.name)
        if image.write_at[1] and image.read_at[1]:
            for place, ((start, size), control) in enumerate(
                ((image.write_at, 0x26), (image.read_at, 0x22))
            ):
                block = _sync_manager(start, size, control)
                await self._write(slave, _SYNC_MANAGER + 8 * place, block)
            timeout_s = self._bus.master.sdo_timeout_ms * 1e-3
            slave.objects = Objects(
                Mailbox(registers, image.write_at, image.read_at, timeout_s, lambda _: None)
            )
        await self._write(slave, _EEPROM_OWNER, b"\1")
        await self._change(slave, AlState.PREOP)

    async def _change(self, slave: _Slave, state: AlState) -> None:
        """Raises `BringUpError` with the slave's own code."""
        await self._write(slave, AL_CONTROL, (state | ERROR).to_bytes(2, "little"))
        loop = asyncio.get_running_loop()
        end = loop.time() + self._bus.master.state_timeout_ms * 1e-3
        while True:
            status = int.from_bytes(await self._read(slave, _AL_STATUS, 2), "little")
            if status == state:
                return
            refused = bool(status & ERROR)
            if refused or loop.time() >= end:
                code = int.from_bytes(await self._read(slave, _AL_CODE, 2), "little")
                raise BringUpError(
                    f"bring-up failed: {self._bus.interface}/{self._slaves.index(slave) + 1} "
                    f"stays in {name(status & 0xF)}, asked for {state.name}: "
                    f"0x{code:04X} {words(code)}"
                )
            await asyncio.sleep(_POLL_S)

    def objects(self, slave: int) -> ObjectAccess:
        objects = self._slaves[slave].objects
        if objects is None:
            raise BringUpError(f"{self._bus.interface}/{slave + 1} has no mailbox")
        return objects

    async def map(self, sizes: Sequence[Sizes], watchdog_ms: int) -> None:
        self._watchdog_ms = watchdog_ms
        place = _LOGICAL
        for slave, size in zip(self._slaves, sizes, strict=True):
            slave.sizes = size
            slave.outputs_at = place
            place += size.outputs
        for slave in self._slaves:
            slave.inputs_at = place
            place += slave.sizes.inputs
        for number in range(len(self._slaves)):
            await self.remap(number)
        self._compile(place - _LOGICAL)

    async def remap(self, slave: int) -> None:
        its = self._slaves[slave]
        assert its.image is not None
        ticks = self._watchdog_ms * 1_000_000 // _WATCHDOG_STEP_NS
        await self._write(its, _WATCHDOG_DIVIDER, _DIVIDER_100_US.to_bytes(2, "little"))
        await self._write(its, _WATCHDOG, ticks.to_bytes(2, "little"))
        for number, (size, logical, kind) in enumerate(
            (
                (its.sizes.outputs, its.outputs_at, _WRITE),
                (its.sizes.inputs, its.inputs_at, _READ),
            )
        ):
            manager = its.image.sync_managers[2 + number]
            block = _sync_manager(manager.start, size, manager.control) if size else bytes(8)
            await self._write(its, _SYNC_MANAGER + 8 * (2 + number), block)
            fmmu = _fmmu(logical, size, manager.start, kind) if size else bytes(16)
            await self._write(its, _FMMU + 16 * number, fmmu)

    def _compile(self, size: int) -> None:
        reference = station(self._slaves[0].address, _SYSTEM)
        self._question = [
            Datagram(Command.LRW, _LOGICAL, bytes(size)),
            Datagram(Command.FRMW, reference, bytes(8)),
        ]
        self._template = bytearray(build(0, self._question))
        data = FIRST_DATAGRAM + HEADER_BYTES
        self._outputs = [
            (data + each.outputs_at - _LOGICAL, each.sizes.outputs) for each in self._slaves
        ]
        self.inputs = [bytes(each.sizes.inputs) for each in self._slaves]
        # 1 for inputs delivered, 2 for outputs taken, a slave each once.
        self._expected = sum(
            bool(each.sizes.inputs) + 2 * bool(each.sizes.outputs) for each in self._slaves
        )

    async def align_clocks(self) -> int:
        for slave in self._slaves:
            features = await self._read(slave, _FEATURES, 2)
            if not features[0] & _HAS_CLOCK:
                raise BringUpError(
                    f"bring-up failed: {self._bus.interface}/{self._slaves.index(slave) + 1} "
                    "has no distributed clock"
                )
        await self.transfer(Datagram(Command.BWR, everyone(_LATCH), bytes(4)))
        now_ns = self._clock()
        first_round = 0
        for number, slave in enumerate(self._slaves):
            port0 = int.from_bytes(await self._read(slave, _LATCH, 4), "little")
            port1 = int.from_bytes(await self._read(slave, _PORT1, 4), "little")
            local = int.from_bytes(await self._read(slave, _LOCAL, 8), "little")
            last = number == len(self._slaves) - 1
            round_trip = 0 if last else (port1 - port0) & 0xFFFFFFFF
            if not number:
                first_round = round_trip
            delay = (first_round - round_trip) // 2
            offset = (now_ns + delay - local) & 0xFFFFFFFFFFFFFFFF
            await self._write(slave, _OFFSET, offset.to_bytes(8, "little"))
            await self._write(slave, _DELAY, delay.to_bytes(4, "little"))
            await self._write(slave, _SPEED, (0x1000).to_bytes(2, "little"))
        before = self._clock()
        system = int.from_bytes(await self._read(self._slaves[0], _SYSTEM, 8), "little")
        return system - before

    async def start_sync(self, slave: int, period_ns: int, phase_ns: int) -> None:
        its = self._slaves[slave]
        await self._write(its, _SYNC_ACTIVE, b"\0")
        await self._write(its, _SYNC_ASSIGNED, b"\0")
        system = int.from_bytes(await self._read(its, _SYSTEM, 8), "little")
        start = ((system + _SYNC_AHEAD_NS) // period_ns + 1) * period_ns + phase_ns
        await self._write(its, _SYNC_START, start.to_bytes(8, "little"))
        await self._write(its, _SYNC_CYCLE, period_ns.to_bytes(4, "little"))
        await self._write(its, _SYNC_ACTIVE, bytes((_SYNC0,)))

    async def reconfigure(self, slave: int) -> None:
        await self._start_slave(slave)

    # -- the tick ---------------------------------------------------------------------------

    def send(self, outputs: Sequence[bytes]) -> int:
        self._cycle_index = self._cycle_index % 0x7F + 1
        frame = self._template[:]
        index = self._cycle_index
        frame[FIRST_DATAGRAM + 1] = index
        frame[FIRST_DATAGRAM + HEADER_BYTES + len(self._question[0].data) + 3] = index
        for (place, size), data in zip(self._outputs, outputs, strict=True):
            frame[place : place + size] = data
        self._cyclic.send(bytes(frame), self._frame_ns)
        return self._clock() + self._frame_ns

    def receive(self) -> int | None:
        while (frame := self._cyclic.receive()) is not None:
            answers = parse(frame, self._cycle_index, self._question)
            if answers is not None:
                break
        else:
            return None
        image, clock = answers
        self.reference_ns = int.from_bytes(clock.data, "little") if clock.counter else None
        for number, each in enumerate(self._slaves):
            place = each.inputs_at - _LOGICAL
            self.inputs[number] = image.data[place : place + each.sizes.inputs]
        return image.counter

    def close(self) -> None:
        for port in (self._acyclic, self._cyclic, self._states):
            port.close()


def _sync_manager(start: int, size: int, control: int) -> bytes:
    """Start, length, control, status, activate, PDI control."""
    return struct.pack("<HHBBBB", start, size, control, 0, _ENABLE, 0)


def _fmmu(logical: int, size: int, physical: int, kind: int) -> bytes:
    """Whole bytes: start bit 0, end bit 7."""
    return struct.pack("<IHBBHBBB3x", logical, size, 0, 7, physical, 0, kind, _ENABLE)
