"""A segment: slaves on one cable, and the frames that go through them.

A frame's processing takes no time of its own; each slave sees it ``hop_ns`` after the one before,
and on the way back again, which is what the distributed clocks measure.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tonus.sim.devices.samples import Samples
from tonus.sim.devices.timers import Callback
from tonus.sim.ethercat.cable import Cable
from tonus.sim.ethercat.disturbance import Disturbance, Fate
from tonus.sim.ethercat.frames import (
    COUNTER_BYTES,
    DATAGRAM,
    HEAD_BYTES,
    LENGTH_BITS,
    MORE,
    PASSED,
    Command,
    is_ethercat,
)
from tonus.sim.ethercat.plan import Plan, compile_plan
from tonus.sim.ethercat.slaves import registers as reg
from tonus.sim.ethercat.slaves.clock import NEVER, ClockTable, Integers
from tonus.sim.ethercat.slaves.controller import READ, WRITE
from tonus.sim.ethercat.slaves.slave import Slave
from tonus.sim.ethercat.sync0 import Sync0Plan, plan

_COUNTER = struct.Struct("<H")
_TIME = struct.Struct("<Q")
_SOURCE = 6
_TOGETHER_NS = 1000
"""SYNC0 of slaves within this time is one instant: a drive's current loop takes 40 us."""
_LONGEST_NS = 1_000_000_000
"""A pulse that is further away is looked for again by then: no timer waits for years."""
# A member of an enumeration is slow to look up.
_PASSES, _LOST, _CORRUPTED = Fate.PASSES, Fate.LOST, Fate.CORRUPTED
_LATE, _TWICE = Fate.LATE, Fate.TWICE
_FRMW = int(Command.FRMW)
_READS = frozenset((Command.APRD, Command.FPRD, Command.BRD))
_WRITES = frozenset((Command.APWR, Command.FPWR, Command.BWR))
_BROADCASTS = frozenset((Command.BRD, Command.BWR, Command.BRW))
_MULTIPLE = frozenset((Command.ARMW, Command.FRMW))
_COUNTING = frozenset((Command.APRD, Command.APWR, Command.APRW, Command.ARMW)) | _BROADCASTS
"""Commands whose address field counts the slaves."""
_WAYS = {Command.LRD: READ, Command.LWR: WRITE, Command.LRW: READ | WRITE}
_References = tuple[Integers, NDArray[np.bool_], Integers]
"""Of the slaves on a frame's way their rows among the clocks, which of them are the reference, and
when the frame comes to each (ns)."""
_PLANS = 64
"""How many are remembered, and reference clocks likewise; a master in order uses a few."""


class Lab(Protocol):
    """What a segment needs of its lab; see `tonus.sim.lab.engine.Lab`."""

    @property
    def now_ns(self) -> int: ...

    @property
    def samples(self) -> Samples: ...

    def advance(self, to_ns: int) -> None: ...

    def call_at(self, at_ns: int, callback: Callback) -> None: ...


@dataclass
class Counts:
    """What has gone through."""

    frames: int = 0
    datagrams: int = 0
    malformed: int = 0
    lost: int = 0
    late: int = 0
    duplicated: int = 0
    corrupted: int = 0


class Segment:
    """``exchange`` is all a master needs. ``ring``: the far end leads to a second port (1)."""

    def __init__(self, name: str, lab: Lab, *, hop_ns: int, ring: bool = False) -> None:
        self.name = name
        self.slaves: list[Slave] = []
        self.cable = Cable(self.slaves, hop_ns=hop_ns, ring=ring)
        self.counts = Counts()
        self.disturbance = Disturbance()
        self._lab = lab
        self._plans: dict[tuple[int, int, int, int, int], Plan] = {}
        self._clocks = ClockTable(0)
        self._stations: dict[tuple[int, int, int], list[Slave]] = {}
        self._references: dict[tuple[int, int, int], _References] = {}
        self._touched: dict[int, Slave] = {}
        self._mail = 0
        self._sync = 0  # timers of an older arrangement are stale
        self._pulses: dict[tuple[Slave, ...], Sync0Plan | None] = {}
        self._late: list[tuple[int, int, bytes]] = []
        self.awaits: Callable[[], None] | None = None
        """called when an answer comes later than `exchange` returns; it is then in `poll`"""

    def attach(self, make: Callable[[int], Slave]) -> Slave:
        """Add a slave at the far end; ``make`` is given its number, from 1."""
        slave = make(len(self.slaves) + 1)
        self.slaves.append(slave)
        self.cable.rewire()
        self._clocks = ClockTable(len(self.slaves))
        for row, each in enumerate(self.slaves):
            each.clock.move(self._clocks, row)
            each.sync.move(self._clocks, row)
        return slave

    # -- what slaves tell ------------------------------------------------------------------------

    def remapped(self) -> None:
        self._plans.clear()
        self._references.clear()
        self._stations.clear()

    def restated(self) -> None:
        self._pulses.clear()

    def exchanged(self, slave: Slave) -> None:
        self._touched[slave.number] = slave

    def mailbox_passed(self, *, read: bool) -> None:
        self._mail |= 1 if read else 2

    def resynchronised(self) -> None:
        self._arm()

    # -- frames ----------------------------------------------------------------------------------

    def exchange(self, frame: bytes, at_ns: int, port: int = 0) -> bytes | None:
        """The answer to a full Ethernet frame that comes in at ``at_ns``, None if none comes back
        in time. It leaves by `Cable.exit` of the port. Any other frame than EtherCAT's is dropped.
        """
        answer = self.answer(frame, at_ns, port)
        self.settle()
        return answer

    def answer(self, frame: bytes, at_ns: int, port: int = 0) -> bytes | None:
        """As `exchange`, but slaves without SYNC0 act only when `settle` is called: an answer on a
        wire need not wait for them."""
        lab = self._lab
        lab.advance(at_ns)
        now_ns = lab.now_ns
        counts = self.counts
        counts.frames += 1
        if not is_ethercat(frame):
            counts.malformed += 1
            return None
        disturbance = self.disturbance
        fate = disturbance.fate() if disturbance.active else _PASSES
        if fate is _LOST:
            counts.lost += 1
            return None
        if fate is _CORRUPTED:
            self._corrupt(disturbance.where)
            return None
        self._mail = 0
        answer = bytes(self._process(bytearray(frame), now_ns, port))
        if self._mail and disturbance.active and disturbance.takes_answer(self._mail):
            counts.lost += 1
            return None
        if fate is _LATE:
            counts.late += 1
            self._later(answer, now_ns + disturbance.delay_ns, port)
            return None
        if fate is _TWICE:
            counts.duplicated += 1
            self._later(answer, now_ns, port)
        return answer

    def settle(self) -> None:
        """Let the slaves that work without SYNC0 act on the frame: first take inputs, then apply
        outputs."""
        if not self._touched:
            return
        now_ns = self._lab.now_ns
        touched, self._touched = self._touched, {}
        for slave in touched.values():
            slave.latch(now_ns)
        for slave in touched.values():
            slave.act(now_ns)

    def poll(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Answers that were late or came twice and are there by now: port and frame."""
        due = [(port, frame) for at_ns, port, frame in self._late if at_ns <= now_ns]
        if due:
            self._late = [entry for entry in self._late if entry[0] > now_ns]
        return due

    def _later(self, answer: bytes, at_ns: int, port: int) -> None:
        self._late.append((at_ns, self.cable.exit(port), answer))
        self._late.sort(key=lambda entry: entry[0])
        # A timer of the lab's, so that its server wakes for it.
        self._lab.call_at(at_ns, lambda _: self.awaits() if self.awaits else None)

    def _corrupt(self, where: int) -> None:
        """A frame whose check sequence is wrong: the slave behind the bad cable counts it, nobody
        acts on it, and the master's interface throws it away."""
        self.counts.corrupted += 1
        if where < len(self.slaves):
            memory = self.slaves[where].controller.memory
            memory[reg.RECEIVE_ERRORS] = min(memory[reg.RECEIVE_ERRORS] + 1, 0xFF)

    def _process(self, frame: bytearray, now_ns: int, port: int) -> bytearray:
        slaves = self.cable.reach[port]
        if port and self.cable.whole:
            return frame  # the other way round nobody touches it
        if slaves:
            frame[_SOURCE] |= PASSED
        end = min(HEAD_BYTES + ((frame[14] | frame[15] << 8) & LENGTH_BITS), len(frame))
        at, more = HEAD_BYTES, True
        counts = self.counts
        while more:
            if at + DATAGRAM.size + COUNTER_BYTES > end:
                counts.malformed += 1
                break
            command, _, place, offset, length, _ = DATAGRAM.unpack_from(frame, at)
            size = length & LENGTH_BITS
            data = at + DATAGRAM.size
            after = data + size
            if after + COUNTER_BYTES > end:
                counts.malformed += 1
                break
            more = bool(length & MORE)
            counts.datagrams += 1
            added = 0
            if not size:
                pass
            elif command in _WAYS:
                added = self._logical(
                    slaves, command, place | offset << 16, frame, data, size, now_ns
                )
            elif command == _FRMW and offset == reg.SYSTEM_TIME and size == _TIME.size:
                added = self._pass_time(slaves, place, frame, data, now_ns)
            elif 0 < command <= _FRMW:
                added = self._physical(slaves, command, place, offset, frame, data, size, now_ns)
                if command in _COUNTING:
                    moved = place + len(slaves) & 0xFFFF
                    frame[at + 2], frame[at + 3] = moved & 0xFF, moved >> 8
            if added:
                total = (frame[after] | frame[after + 1] << 8) + added
                frame[after], frame[after + 1] = total & 0xFF, total >> 8 & 0xFF
            at = after + COUNTER_BYTES
        return frame

    def _pass_time(
        self, slaves: list[Slave], station: int, frame: bytearray, data: int, now_ns: int
    ) -> int:
        """FRMW of the system time, which comes with every cycle. Slaves before the reference see
        what the master has sent, so a master takes the first for it."""
        value = _TIME.unpack_from(frame, data)[0]
        key = (station, slaves[0].number if slaves else 0, len(slaves))
        references = self._references.get(key)
        if references is None:
            if len(self._references) >= _PLANS:
                self._references.clear()
            references = self._references[key] = (
                np.array([slave.number - 1 for slave in slaves], np.int64),
                np.array([slave.controller.answers_to(station) for slave in slaves], np.bool_),
                np.array([slave.arrival_ns for slave in slaves], np.int64),
            )
        _TIME.pack_into(frame, data, self._clocks.pass_time(*references, value, now_ns))
        return len(slaves)

    def _physical(
        self,
        slaves: list[Slave],
        command: int,
        place: int,
        offset: int,
        frame: bytearray,
        data: int,
        size: int,
        now_ns: int,
    ) -> int:
        """What the slaves add to the working counter."""
        end = data + size
        added = 0
        broadcast, multiple = command in _BROADCASTS, command in _MULTIPLE
        addressed = self._addressed(slaves, command, place)
        for slave in slaves if multiple else addressed:
            controller = slave.controller
            meant = not multiple or slave in addressed
            reads = meant and command not in _WRITES
            writes = not meant if multiple else command not in _READS
            given = bytes(frame[data:end]) if writes else b""
            found = controller.read(offset, size, now_ns) if reads else None
            if found is not None:
                # A broadcast collects, and so does a slave that adds its answer to what comes.
                frame[data:end] = _either(frame[data:end], found) if broadcast else found
                added += 1
            if writes and controller.write(offset, given, now_ns):
                added += 2 if reads else 1
        return added

    def _addressed(self, slaves: list[Slave], command: int, place: int) -> list[Slave]:
        """Those of the slaves on the way that a command is for."""
        if command in _BROADCASTS:
            return slaves
        if command in _COUNTING:
            number = -place & 0xFFFF
            return slaves[number : number + 1]
        key = (place, slaves[0].number if slaves else 0, len(slaves))
        addressed = self._stations.get(key)
        if addressed is None:
            if len(self._stations) >= _PLANS:
                self._stations.clear()
            addressed = [slave for slave in slaves if slave.controller.answers_to(place)]
            self._stations[key] = addressed
        return addressed

    def _logical(
        self,
        slaves: list[Slave],
        command: int,
        start: int,
        frame: bytearray,
        data: int,
        size: int,
        now_ns: int,
    ) -> int:
        first = slaves[0].number if slaves else 0
        key = (command, start, size, first, len(slaves))
        plan = self._plans.get(key)
        if plan is None:
            if len(self._plans) >= _PLANS:
                self._plans.clear()
            plan = self._plans[key] = compile_plan(slaves, _WAYS[Command(command)], start, size)
        plan.play(frame, data, size, now_ns)
        return plan.counter

    # -- SYNC0 -----------------------------------------------------------------------------------

    def _arm(self) -> None:
        """Wait for the next SYNC0 of any slave."""
        self._sync += 1
        number, now_ns = self._sync, self._lab.now_ns
        first_ns = self._clocks.next_pulse(now_ns)
        if first_ns < NEVER:
            at_ns = min(max(first_ns, now_ns + 1), now_ns + _LONGEST_NS)
            self._lab.call_at(at_ns, lambda at: self._pulse(number, at))

    def _pulse(self, number: int, now_ns: int) -> None:
        if number != self._sync:
            return
        rows = self._clocks.due(now_ns, now_ns + _TOGETHER_NS)
        due = tuple([self.slaves[row] for row in rows])
        if due not in self._pulses:
            if len(self._pulses) >= _PLANS:
                self._pulses.clear()
            self._pulses[due] = plan(due, self._lab.samples, self._clocks)
        planned = self._pulses[due]
        if planned is not None:
            planned(now_ns)
        else:
            for slave in due:
                slave.latch(now_ns)
            for slave in due:
                slave.pulse(now_ns)
        self._arm()


def _either(one: bytes | bytearray, other: bytes) -> bytes:
    return bytes(a | b for a, b in zip(one, other, strict=True))
