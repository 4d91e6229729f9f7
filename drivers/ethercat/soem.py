"""The SOEM master, through pysoem, as a `Wire` on a network interface.

SOEM waits for frames on a socket with a receive timeout of 1 us, which the kernel rounds up to its
own tick: a frame that is lost holds it for 4 to 8 ms, whatever timeout it was given. So its socket
is made non-blocking once process data are exchanged, and SOEM polls it until its own timer has run
out.

States are read, and AL control is written, with frames of our own through a second socket that
nobody waits on: pysoem has no call for either that leaves the interpreter lock alone. The kernel
sorts the answers by index.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from tonus.config.schema.bus import EthercatBus
from tonus.drivers.cia301.abort_codes import NO_SUCH_OBJECT
from tonus.drivers.cia301.setting import ObjectAccess
from tonus.drivers.errors import BringUpError, SdoAbortError, SdoError, SdoTimeoutError
from tonus.drivers.ethercat.al import AlState, name
from tonus.drivers.ethercat.deterministic import DeterministicMaster
from tonus.drivers.ethercat.port import FramePort, PacketPort, packet_sockets, select
from tonus.drivers.ethercat.ring import RingPort
from tonus.drivers.ethercat.slave import RX_ASSIGNMENT, TX_ASSIGNMENT
from tonus.drivers.ethercat.status import StateAccess, StatusFrames
from tonus.drivers.ethercat.wire import FIRST_STATION, Found, Sizes

Result = TypeVar("Result")

_SYSTEM = 0x0910
_REGISTER_TIMEOUT_US = 2000
_TRIES = 3
_CLOCKS_APART_NS = 5_000_000
"""More than any frame takes; what is left the clocks themselves make good."""
_MAP = ((0x0400, 2), (0x0420, 2), (0x0810, 16), (0x0600, 48))
"""Watchdog, sync managers 2 and 3, FMMUs: what makes process data of a slave's memory."""


class SoemMaster(StateAccess):
    """A `Wire` on pysoem.

    Everything that may wait runs in one thread beside the loop, with the interpreter lock released
    where pysoem can.
    """

    def __init__(self, bus: EthercatBus, clock: Callable[[], int]) -> None:
        """Raises `BringUpError` where pysoem is not installed."""
        try:
            import pysoem
        except ImportError as error:
            raise BringUpError(
                "EtherCAT needs pysoem, which is not installed; add it with: "
                "pip install 'tonus[ethercat]'"
            ) from error
        super().__init__()
        self._soem: Any = pysoem
        self._bus = bus
        self._clock = clock
        self._timeout_us = bus.master.receive_timeout_us
        self._thread: ThreadPoolExecutor | None = None
        self._master: Any = None
        self._slaves: list[Any] = []
        self._port: FramePort | None = None
        self._clocked = False
        self._helper: DeterministicMaster | None = None
        self._blocks: list[list[tuple[int, bytes]]] = []
        self._running = False
        self._polls = False
        self._descriptors: list[int] = []
        self.inputs: list[bytes] = []
        self.reference_ns: int | None = None

    async def _beside(self, action: Callable[[], Result]) -> Result:
        if self._thread is None:
            self._thread = _thread_below_this()
        call = asyncio.get_running_loop().run_in_executor(self._thread, action)
        try:
            return await asyncio.shield(call)
        except asyncio.CancelledError:
            # What stops the bus then must not meet SOEM at work in its thread.
            await asyncio.wait([call])
            raise

    # -- bring-up ---------------------------------------------------------------------------

    async def scan(self) -> list[Found]:
        self._open()
        return await self._beside(self._scan)

    def _open(self) -> None:
        soem = self._soem
        before = packet_sockets()
        master = soem.Master()
        for interface in self._bus.interfaces:
            if interface not in {there for _, there in socket.if_nameindex()}:
                raise BringUpError(
                    f"bring-up failed: there is no network interface {interface}; "
                    "see docs/ethercat.md for how to make or name one"
                )
        try:
            master.open(*self._bus.interfaces)
        except ConnectionError as error:
            raise BringUpError(
                f"bring-up failed: {' or '.join(self._bus.interfaces)} cannot be opened: {error}; "
                "raw sockets need root or CAP_NET_RAW"
            ) from error
        self._master = master
        for descriptor, target in packet_sockets().items():
            if before.get(descriptor) != target:
                self._descriptors.append(descriptor)
                with socket.socket(fileno=os.dup(descriptor)) as each:
                    select(each, ours=False)
        self._port = self._beside_soem()

    def _beside_soem(self) -> FramePort:
        """A port for frames of our own."""
        ports = [PacketPort(interface) for interface in self._bus.interfaces]
        return RingPort(*ports) if len(ports) > 1 else ports[0]

    def _scan(self) -> list[Found]:
        soem, master = self._soem, self._master
        master.sdo_read_timeout = master.sdo_write_timeout = self._bus.master.sdo_timeout_ms * 1000
        master.always_release_gil = True
        # A try takes 2 ms; SOEM's own limit leaves no second one for a frame that was lost.
        soem.settings.timeouts.ret = _TRIES * _REGISTER_TIMEOUT_US
        for _ in range(_TRIES):
            problem = self._initialise()
            if not problem:
                break
        else:
            raise BringUpError(f"bring-up failed: {problem}")
        # From here on: before, it would leave the slaves in INIT.
        master.manual_state_change = True
        assert self._port is not None
        stations = [FIRST_STATION + number for number in range(len(self._slaves))]
        self.states = StatusFrames(self._port, stations)
        return [Found(each.man, each.id, each.rev, each.name) for each in self._slaves]

    def _initialise(self) -> str:
        """All slaves to PREOP; what is wrong, if anything: a frame that was lost has SOEM set a
        slave up wrongly."""
        soem, master = self._soem, self._master
        if master.config_init() <= 0:
            return f"no slave answers on {self._bus.interface}"
        self._slaves = list(master.slaves)
        master.state_check(soem.PREOP_STATE, self._bus.master.state_timeout_ms * 1000)
        master.read_state()
        for number, slave in enumerate(self._slaves):
            where = f"{self._bus.interface}/{number + 1}"
            if slave.state != AlState.PREOP:
                return (
                    f"{where} stays in {name(slave.state & 0xF)}, asked for PREOP: AL status "
                    f"0x{slave.al_status:04X} {soem.al_status_code_to_string(slave.al_status)}"
                )
            if not slave.man:  # nobody has the vendor 0
                return f"{where}: its identity cannot be read"
        return ""

    def objects(self, slave: int) -> ObjectAccess:
        return _Objects(self, slave)

    async def read_object(self, slave: int, index: int, subindex: int) -> bytes:
        """As `ObjectAccess`, of one slave."""
        read = self._slaves[slave].sdo_read
        return await self._sdo(index, subindex, lambda: bytes(read(index, subindex)))

    async def write_object(self, slave: int, index: int, subindex: int, data: bytes) -> None:
        """As `ObjectAccess`, of one slave."""
        write = self._slaves[slave].sdo_write
        await self._sdo(index, subindex, lambda: write(index, subindex, data))

    async def _sdo(self, index: int, subindex: int, access: Callable[[], Result]) -> Result:
        """SOEM keeps the errors of one call for the next, and an emergency counts as one: neither
        is an answer to what was asked. So it is asked again, as after a frame that was lost: these
        reads and writes may happen twice. Raises `SdoError`."""
        soem, where = self._soem, f"0x{index:04X}:{subindex}"
        last: Exception | None = None
        for _ in range(_TRIES):
            try:
                return await self._beside(access)
            except soem.SdoError as error:
                raise SdoAbortError(error.abort_code, f"{where}: {error.desc}") from error
            except (soem.Emergency, soem.MailboxError, soem.PacketError, soem.WkcError) as error:
                last = error
        if isinstance(last, soem.WkcError):
            raise SdoTimeoutError(f"{where}: no answer in its mailbox") from last
        raise SdoError(f"{where}: {last}") from last

    async def align_clocks(self) -> int:
        if self._running:
            assert self._helper is not None
            return await self._helper.align_clocks()
        return await self._beside(self._align_clocks)

    def _align_clocks(self) -> int:
        if not self._master.config_dc():
            raise BringUpError(
                f"bring-up failed: no slave on {self._bus.interface} has a distributed clock"
            )
        self._clocked = True
        for _ in range(_TRIES):
            ahead = [self._ahead(slave) for slave in range(len(self._slaves))]
            apart, number = max((abs(each - ahead[0]), slave) for slave, each in enumerate(ahead))
            if apart <= _CLOCKS_APART_NS:
                return ahead[0]
            # A frame of its measuring was lost, which SOEM does not notice.
            self._master.config_dc()
        raise BringUpError(
            f"bring-up failed: {self._bus.interface}/{number + 1}: its clock cannot be set: it is "
            f"{apart / 1e6:.0f} ms from that of the first"
        )

    def _ahead(self, slave: int) -> int:
        """ns by which a slave's time is ahead of the loop's; the quickest answer says it best."""
        answers = []
        for _ in range(_TRIES):
            before = self._clock()
            system = int.from_bytes(self._register(slave, _SYSTEM, 8), "little")
            after = self._clock()
            answers.append((after - before, system - (before + after) // 2))
        return min(answers)[1]

    def _register(self, slave: int, register: int, size: int) -> bytes:
        read = self._slaves[slave]._fprd
        return bytes(
            self._again(
                slave,
                f"register 0x{register:04X} cannot be read",
                lambda: read(register, size, _REGISTER_TIMEOUT_US),
            )
        )

    def _set_watchdog(self, slave: int, watchdog_ms: int) -> None:
        its = self._slaves[slave]
        self._again(
            slave,
            "its watchdog cannot be set",
            lambda: its.set_watchdog("processdata", watchdog_ms),
        )

    def _again(self, slave: int, what: str, access: Callable[[], Result]) -> Result:
        """A register access, once more when its frame was lost. Raises `BringUpError`."""
        last: Exception | None = None
        for _ in range(_TRIES):
            try:
                return access()
            except self._soem.WkcError as error:
                last = error
        raise BringUpError(f"{self._bus.interface}/{slave + 1}: {what}") from last

    async def map(self, sizes: Sequence[Sizes], watchdog_ms: int) -> None:
        await self._beside(lambda: self._map(sizes, watchdog_ms))
        self._helper = helper = DeterministicMaster(
            self._bus, lambda *_: None, self._clock, self._beside_soem()
        )
        helper.know(len(self._slaves))
        self._blocks = [
            [(register, await helper.registers(number, register, size)) for register, size in _MAP]
            for number in range(len(self._slaves))
        ]

    def _map(self, sizes: Sequence[Sizes], watchdog_ms: int) -> None:
        soem, master = self._soem, self._master
        try:
            master.config_map()
        except soem.ConfigMapError as error:
            told = "; ".join(
                self._words(each) for each in error.error_list if not self._harmless(each, sizes)
            )
            if told:
                raise BringUpError(
                    f"bring-up failed: process data cannot be mapped: {told}"
                ) from error
        expected = 0
        for number, (slave, wanted) in enumerate(zip(self._slaves, sizes, strict=True)):
            there = Sizes(len(slave.output), len(slave.input))
            expected += bool(wanted.inputs) + 2 * bool(wanted.outputs)
            if there != wanted:
                raise BringUpError(
                    f"bring-up failed: {self._bus.interface}/{number + 1} has {there.outputs} + "
                    f"{there.inputs} bytes of process data, configured are {wanted.outputs} + "
                    f"{wanted.inputs}"
                )
            if wanted.outputs:
                self._set_watchdog(number, watchdog_ms)
        if master.expected_wkc != expected:
            raise BringUpError(
                f"bring-up failed: SOEM expects a working counter of {master.expected_wkc}, "
                f"these slaves give {expected}"
            )
        self.inputs = [bytes(each.inputs) for each in sizes]

    def _harmless(self, error: Any, sizes: Sequence[Sizes]) -> bool:
        """SOEM asks every slave for both assignments; one without outputs has no 0x1C12."""
        if not isinstance(error, self._soem.SdoError) or error.abort_code != NO_SUCH_OBJECT:
            return False
        size = sizes[error.slave_pos - 1]
        absent = {RX_ASSIGNMENT: not size.outputs, TX_ASSIGNMENT: not size.inputs}
        return absent.get(error.index, False)

    def _words(self, error: Any) -> str:
        if not isinstance(error, self._soem.SdoError):
            return str(error)
        return (
            f"{self._bus.interface}/{error.slave_pos}: 0x{error.index:04X}:{error.subindex}: "
            f"abort 0x{error.abort_code:08X}: {error.desc}"
        )

    async def start_sync(self, slave: int, period_ns: int, phase_ns: int) -> None:
        if self._running:
            assert self._helper is not None
            await self._helper.start_sync(slave, period_ns, phase_ns)
            return
        await self._beside(lambda: self._slaves[slave].dc_sync(True, period_ns, phase_ns))

    async def reconfigure(self, slave: int) -> None:
        """With frames of our own: SOEM's calls for this hold the interpreter lock for seconds."""
        self._running = True
        assert self._helper is not None
        await self._helper.reconfigure(slave)

    async def remap(self, slave: int) -> None:
        """What SOEM had written into its sync managers and FMMUs, as it was."""
        assert self._helper is not None
        for register, block in self._blocks[slave]:
            await self._helper.set_registers(slave, register, block)

    # -- the tick ---------------------------------------------------------------------------

    def send(self, outputs: Sequence[bytes]) -> int:
        for slave, data in zip(self._slaves, outputs, strict=True):
            if data:
                slave.output = data
        if not self._polls:
            # Not before: a bring-up has time, and polling takes the processor from others.
            self._polls = True
            for descriptor in self._descriptors:
                os.set_blocking(descriptor, False)
        sent_ns = self._clock()
        self._master.send_processdata()
        return sent_ns

    def receive(self) -> int | None:
        counter: int = self._master.receive_processdata(self._timeout_us)
        if counter < 0:
            return None
        self.reference_ns = self._master.dc_time if self._clocked else None
        self.inputs = [slave.input for slave in self._slaves]
        return counter

    def close(self) -> None:
        if self._thread is not None:
            self._thread.shutdown(wait=True)
        if self._port is not None:
            self._port.close()
        if self._helper is not None:
            self._helper.close()
        if self._master is not None:
            self._master.close()


def _thread_below_this() -> ThreadPoolExecutor:
    """A thread that this one can interrupt and ordinary processes cannot: SOEM gives a frame 2 ms
    to come back. A real-time process hands its priority to no thread by itself."""
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    priority = max(os.sched_getparam(0).sched_priority - 1, 1)

    def begin() -> None:
        if policy in (os.SCHED_FIFO, os.SCHED_RR):
            # Refused only where it would have been refused to the caller.
            with contextlib.suppress(PermissionError):
                os.sched_setscheduler(0, policy, os.sched_param(priority))

    return ThreadPoolExecutor(1, thread_name_prefix="soem", initializer=begin)


class _Objects:
    def __init__(self, master: SoemMaster, slave: int) -> None:
        self._master = master
        self._slave = slave

    async def read(self, index: int, subindex: int) -> bytes:
        return await self._master.read_object(self._slave, index, subindex)

    async def write(self, index: int, subindex: int, data: bytes) -> None:
        await self._master.write_object(self._slave, index, subindex, data)
