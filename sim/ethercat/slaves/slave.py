"""A slave: a device of the lab behind a slave controller, with its states, mailbox and clock."""

from __future__ import annotations

import struct
from typing import Protocol

from tonus.sim.devices.device import Device
from tonus.sim.devices.objects import AbortError
from tonus.sim.devices.timers import Timers
from tonus.sim.errors import LabError
from tonus.sim.ethercat.slaves import registers as reg
from tonus.sim.ethercat.slaves.clock import SHORTEST_NS, DistributedClock, SyncUnit
from tonus.sim.ethercat.slaves.coe import Coe, emergency
from tonus.sim.ethercat.slaves.controller import Controller, Manager
from tonus.sim.ethercat.slaves.eeprom import Eeprom
from tonus.sim.ethercat.slaves.identity import Kind
from tonus.sim.ethercat.slaves.mailbox import Mailbox
from tonus.sim.ethercat.slaves.process_data import ProcessData
from tonus.sim.ethercat.slaves.sii import INPUTS, MAILBOX_IN, MAILBOX_OUT, OUTPUTS, image
from tonus.sim.ethercat.slaves.states import (
    NO_ERROR,
    NO_SYNC,
    SYNC_LOST,
    WATCHDOG,
    Facts,
    Standing,
    State,
    next_standing,
)
from tonus.sim.ethercat.slaves.watchdog import Watchdog

PDO_ERROR = 0x8280
COMMUNICATION_ERROR = 0x8180
"""What a drive raises when its process data stay away, and when its master leaves OP."""
_WAIT_NS = 1_000_000_000
"""How long a request for OP waits for the first SYNC0."""
_VALID_CONTROL = 0x0F
_PULSED = 0x03
_ONE = struct.Struct("<H")
_TIME = struct.Struct("<Q")
_SPAN = struct.Struct("<I")
_SIGN = 1 << 31
_OUT, _IN = 2, 3
_SAFE_OP = int(State.SAFE_OP)  # a member of an enumeration is slow to look up
_VENDOR, _PRODUCT, _REVISION = 8, 10, 12
"""words in the EEPROM"""


class Chain(Protocol):
    """What a slave tells the segment it is in."""

    def remapped(self) -> None: ...

    def exchanged(self, slave: Slave) -> None:
        """Process data went by, of a slave that works without SYNC0."""

    def restated(self) -> None:
        """A slave is in another state, and may have other process data."""

    def resynchronised(self) -> None:
        """Another time for the next SYNC0."""

    def mailbox_passed(self, *, read: bool) -> None: ...


class Slave:
    """``number`` counts from 1 along the cable; ``drift`` as in `DistributedClock`."""

    def __init__(
        self,
        device: Device,
        kind: Kind,
        number: int,
        chain: Chain,
        timers: Timers,
        *,
        drift: float = 0.0,
        origin: int = 0,
    ) -> None:
        self.device = device
        self.kind = kind
        self.number = number
        self.standing = Standing(State.INIT, False, NO_ERROR)
        self.rejects: dict[int, int] = {}
        """AL status code with which a state is refused, for tests"""
        self.aborts: dict[tuple[int, int | None], list[int]] = {}
        """abort code and how often, by object (subindex None: any), for tests"""
        self.powered = True
        self.arrival_ns = 0
        """from the first slave to this one"""
        self.return_ns: int | None = None
        """until the frame is back here, None: this is the last"""
        self._chain = chain
        self._timers = timers
        self.clock = DistributedClock(drift, origin)
        self.sync = SyncUnit()
        for subindex, value in ((1, kind.vendor), (2, kind.product), (3, kind.revision)):
            device.objects.find(0x1018, subindex).set(value)
        serial = device.objects.number(0x1018, 4)
        self.process_data = ProcessData(device, kind, lambda: self.state is State.PRE_OP)
        self._coe = Coe(
            device.objects, kind.mailbox_bytes, complete=kind.complete_access, refuse=self._refusal
        )
        self.controller = Controller(self, Eeprom(image(kind, serial)))
        self.mailbox = Mailbox(self.controller, self._coe.serve, kind.mailbox_bytes)
        self._outputs: bytes | bytearray = bytearray()
        self.fresh = False
        """outputs have come that have not taken effect"""
        self._watchdog = Watchdog(self.controller, timers, self.expire)
        self._waiting = 0  # number of the present wait for SYNC0; 0: there is none
        self._waits = 0
        device.on_error = self._emergency
        device.set_operational(False)
        self._show()

    # -- what others see -------------------------------------------------------------------------

    @property
    def state(self) -> State:
        return self.standing.state

    def _emergency(self, code: int, register: int) -> None:
        if self.state is not State.INIT:
            self.mailbox.send(emergency(code, register))

    def _refusal(self, index: int, subindex: int) -> int:
        for key in ((index, subindex), (index, None)):
            planned = self.aborts.get(key)
            if planned is not None:
                planned[1] -= 1
                if planned[1] <= 0:
                    del self.aborts[key]
                return planned[0]
        return 0

    def set_identity(
        self, vendor: int | None = None, product: int | None = None, revision: int | None = None
    ) -> None:
        """Be another slave than the one that should be here; None leaves as it is."""
        given = ((_VENDOR, 1, vendor), (_PRODUCT, 2, product), (_REVISION, 3, revision))
        for word, subindex, value in given:
            if value is not None:
                self.controller.eeprom.put(word, value, 4)
                self.device.objects.find(0x1018, subindex).set(value)

    # -- states ----------------------------------------------------------------------------------

    def control(self, word: int, now_ns: int) -> None:
        """The master asks for a state."""
        request = word & 0x0F
        self._waiting = 0
        code = self.rejects.get(request)
        if code is not None and request > self.state:
            self._enter(Standing(self.state, True, code), now_ns)
            return
        wanted = next_standing(self.standing, word, self._facts())
        starts = wanted.state is State.OP and self.state is State.SAFE_OP
        if starts and self._pulsed and not self.sync.pulses:
            self._wait(now_ns)
            return
        self._enter(wanted, now_ns)

    def force(self, state: State, code: int, now_ns: int) -> None:
        """Fall to a state with an error, for whatever reason of the slave's own."""
        self._enter(Standing(state, bool(code), code), now_ns)

    def _wait(self, now_ns: int) -> None:
        """OP comes with the first SYNC0, or not at all."""
        self._waits += 1
        self._waiting = number = self._waits

        def give_up(at_ns: int) -> None:
            if self._waiting == number:
                self._waiting = 0
                self._enter(Standing(self.state, True, NO_SYNC), at_ns)

        self._timers.call_at(now_ns + _WAIT_NS, give_up)

    @property
    def _pulsed(self) -> bool:
        """Whether the master has set SYNC0 up."""
        return self.controller.memory[reg.SYNC_ACTIVATION] & _PULSED == _PULSED

    def _facts(self) -> Facts:
        outputs, inputs = self.process_data.sizes()
        kind, managers, size = self.kind, self.controller.managers, self.kind.mailbox_bytes
        cycle = _SPAN.unpack_from(self.controller.memory, reg.SYNC_CYCLE)[0]
        pulsed = self._pulsed
        return Facts(
            mailbox=_is(managers[0], kind.receive_mailbox, size, MAILBOX_OUT)
            and _is(managers[1], kind.send_mailbox, size, MAILBOX_IN),
            outputs=_is(managers[_OUT], kind.outputs, outputs, OUTPUTS),
            inputs=_is(managers[_IN], kind.inputs, inputs, INPUTS),
            sync=cycle >= SHORTEST_NS if pulsed else not self.process_data.wants_sync(),
        )

    def _enter(self, wanted: Standing, now_ns: int) -> None:
        before = self.state
        if wanted.state >= State.SAFE_OP > before:
            try:
                self.process_data.compile()
            except AbortError:
                wanted = Standing(before, True, 0x0024)
        self.standing = wanted
        self._chain.restated()
        state = wanted.state
        if before is State.INIT or state is State.INIT:
            self.mailbox.reset()
            self._coe.reset()
        self._show()
        if state is before:
            return
        operational = state is State.OP
        self.device.set_operational(operational)
        if operational:
            self._watchdog.start(now_ns)
        elif before is State.OP:
            self._watchdog.stop()
            self._left(wanted.code)
        if state >= State.SAFE_OP > before:
            self._outputs, self.fresh = bytearray(), False
            self.latch(now_ns)

    def _left(self, code: int) -> None:
        """A drive that was at work does as its option for a lost connection says."""
        if getattr(self.device, "enabled", False):
            self.device.fail(PDO_ERROR if code == WATCHDOG else COMMUNICATION_ERROR)

    def _show(self) -> None:
        """Registers and sync managers as the state wants them."""
        state, _, code = self.standing
        memory, controller = self.controller.memory, self.controller
        memory[reg.STATUS_AL : reg.STATUS_AL + 2] = _ONE.pack(self.standing.word)
        memory[reg.CODE_AL : reg.CODE_AL + 2] = _ONE.pack(code)
        for number in (0, 1):
            controller.lock(number, locked=state is State.INIT)
        for number in (_OUT, _IN):
            controller.lock(number, locked=state < State.SAFE_OP)

    # -- power and time --------------------------------------------------------------------------

    def switch_off(self) -> None:
        self.powered = False
        self._stop()

    def _stop(self) -> None:
        self._watchdog.stop()
        self._waiting = 0
        self.sync.restart()
        self.standing = Standing(State.INIT, False, NO_ERROR)
        self._chain.restated()
        self.device.set_operational(False)

    def switch_on(self) -> None:
        """As after a loss of power. Raises `LabError` if the device cannot bear that."""
        restart = getattr(self.device, "power_cycle", None)
        if restart is None:
            raise LabError(f"slave {self.number} has no supply to interrupt")
        self._stop()
        restart()
        self.device.communication_reset()
        self.controller.restart()
        self.clock.restart(self._timers.now_ns)
        self.mailbox.reset()
        self._coe.reset()
        self._outputs, self.fresh = bytearray(), False
        self.powered = True
        self._show()

    # -- process data ----------------------------------------------------------------------------

    def outputs_written(self, now_ns: int) -> None:
        manager = self.controller.managers[_OUT]
        whole = self.takes(manager.start, manager.length)
        memory = self.controller.memory
        self.outputs_came(memory[manager.start : manager.end] if whole else None, now_ns)

    def takes(self, start: int, size: int) -> bool:
        """Whether that is the whole output area, and as it was when the state was granted."""
        manager, granted = (
            self.controller.managers[_OUT],
            (self.kind.outputs, self.process_data.size),
        )
        return (start, size) == (manager.start, manager.length) == granted

    def outputs_came(self, outputs: bytes | bytearray | None, now_ns: int) -> None:
        """The last byte of the area was written; ``outputs`` if the slave `takes` it."""
        if outputs is not None:
            self._outputs = outputs
            self.fresh = True
        self._watchdog.heard(now_ns)
        if not self.sync.active:
            self._chain.exchanged(self)

    def inputs_read(self, now_ns: int) -> None:
        del now_ns
        if not self.sync.active:
            self._chain.exchanged(self)

    def latch(self, now_ns: int) -> None:
        """Take the inputs of this instant."""
        if self.standing.state >= _SAFE_OP:
            self.device.sample(now_ns)
            data = self.process_data.inputs()
            start = self.kind.inputs  # where the sync manager was when the state was granted
            self.controller.memory[start : start + len(data)] = data

    @property
    def input_area(self) -> memoryview:
        """Where masters read what is latched."""
        start = self.kind.inputs
        size = self.process_data.sizes()[1]
        return memoryview(self.controller.memory)[start : start + size]

    def take(self) -> bytes | bytearray:
        """The outputs that have come, which are to take effect now."""
        self.fresh = False
        return self._outputs

    def act(self, now_ns: int) -> None:
        """Let the outputs that have come take effect."""
        if self.fresh and self.state is State.OP:
            self.process_data.apply(self.take(), now_ns)

    def pulse(self, now_ns: int) -> None:
        """SYNC0; the inputs have been latched."""
        self.sync.pulse()
        if self._waiting:
            self._waiting = 0
            self._enter(Standing(State.OP, False, NO_ERROR), now_ns)
        elif self.state is State.OP:
            if not self.fresh:
                self.process_data.count_missed()
            self.act(now_ns)

    # -- watchdog --------------------------------------------------------------------------------

    def watchdog_set(self, now_ns: int) -> None:
        self._watchdog.changed(now_ns)

    def expire(self, now_ns: int) -> None:
        """The outputs have stayed away too long."""
        self._watchdog.count()
        self.force(State.SAFE_OP, WATCHDOG, now_ns)

    # -- mailbox ---------------------------------------------------------------------------------

    def mailbox_written(self, data: bytes, now_ns: int) -> None:
        self._chain.mailbox_passed(read=False)
        self.mailbox.received(data, now_ns)

    def mailbox_read(self, now_ns: int) -> None:
        del now_ns
        self._chain.mailbox_passed(read=True)
        self.mailbox.next()

    def repeat(self, now_ns: int) -> None:
        del now_ns
        self.mailbox.repeat()

    def remapped(self) -> None:
        self._chain.remapped()

    # -- clock -----------------------------------------------------------------------------------

    def set_drift(self, drift: float) -> None:
        """Let the clock run at another speed from now on."""
        self.clock.change_drift(drift, self._timers.now_ns)
        self._chain.resynchronised()

    def clock_read(self, now_ns: int) -> None:
        memory, clock = self.controller.memory, self.clock
        _TIME.pack_into(memory, reg.SYSTEM_TIME, clock.system(now_ns + self.arrival_ns))
        size = min(abs(clock.difference), _SIGN - 1)
        _SPAN.pack_into(memory, reg.DIFFERENCE, size | (_SIGN if clock.difference < 0 else 0))

    def system_time(self, now_ns: int) -> int:
        """As the slave shows it while a frame that came into the segment now passes."""
        return self.clock.system(now_ns + self.arrival_ns)

    def clock_written(self, start: int, data: bytes, now_ns: int) -> None:
        memory, clock, end = self.controller.memory, self.clock, start + len(data)
        if start <= reg.RECEIVE_TIME < end:
            self._latch_times(now_ns)
        if start <= reg.SYSTEM_TIME and end >= reg.SYSTEM_TIME + 4:
            self._compare_written(data[reg.SYSTEM_TIME - start :], now_ns)
        if start < reg.DIFFERENCE and end > reg.OFFSET:
            clock.offset = _TIME.unpack_from(memory, reg.OFFSET)[0]
            clock.delay = _SPAN.unpack_from(memory, reg.DELAY)[0]
            self.sync.jumped(self.system_time(now_ns))
            self._chain.resynchronised()
        if start < reg.SPEED_START + 2 and end > reg.SPEED_START:
            clock.forget()
        if start <= reg.SYNC_ACTIVATION < end:
            self._activate(now_ns)

    def _latch_times(self, now_ns: int) -> None:
        """When the frame came by, on the way out and on the way back."""
        memory, clock = self.controller.memory, self.clock
        came = clock.local(now_ns + self.arrival_ns)
        back = 0 if self.return_ns is None else clock.local(now_ns + self.return_ns)
        mask = (1 << 32) - 1
        struct.pack_into("<IIII", memory, reg.RECEIVE_TIME, came & mask, back & mask, 0, 0)
        _TIME.pack_into(memory, reg.LATCHED_TIME, came & (1 << 64) - 1)

    def _compare_written(self, data: bytes, now_ns: int) -> None:
        """A time of 32 bits is one near our own; zeros are a master that clears registers."""
        if not any(data):
            return
        if len(data) >= 8:
            reference = _TIME.unpack_from(data)[0]
        else:
            own = self.system_time(now_ns)
            low = _SPAN.unpack_from(data)[0]
            reference = own + ((low - own + (1 << 31)) % (1 << 32) - (1 << 31))
        self.clock.compare(reference, now_ns + self.arrival_ns)

    def _activate(self, now_ns: int) -> None:
        memory = self.controller.memory
        if not self._pulsed:
            was = self.sync.active
            self.sync.stop()
            if was and self.state is State.OP:
                self.force(State.SAFE_OP, SYNC_LOST, now_ns)
        else:
            first = _TIME.unpack_from(memory, reg.SYNC_START)[0]
            cycle = _SPAN.unpack_from(memory, reg.SYNC_CYCLE)[0]
            self.sync.start(first, cycle, self.system_time(now_ns))
        self._chain.resynchronised()


def _is(manager: Manager, start: int, length: int, control: int) -> bool:
    """Whether a sync manager is set up like that; none is wanted for no bytes."""
    if not length:
        return not manager.enabled or not manager.length
    same = manager.start == start and manager.length == length
    return manager.enabled and same and not (manager.control ^ control) & _VALID_CONTROL
