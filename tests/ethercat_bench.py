"""A lab's EtherCAT segment in virtual time, and a master's few words for it, written anew."""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

from tonus.config import load
from tonus.config.schema.lab import LabScript
from tonus.config.schema.root import Config
from tonus.sim.ethercat.frames import Command, Datagram, build, parse, physical
from tonus.sim.ethercat.slaves.slave import Slave
from tonus.sim.lab.engine import Lab
from tonus.tools.run.supervision import without_relay

US, MS = 1_000, 1_000_000
CHANNEL = "tonus0"
INIT, PRE_OP, SAFE_OP, OP = 1, 2, 4, 8
STATION = 0x1001
LOGICAL = 0x10000
RPDO = (0x60400010, 0x60710010)
TPDO = (0x60410010, 0x60640020, 0x60770010)


@cache
def _config(name: str) -> Config:
    return without_relay(load(name)[0])


class SegmentBench:
    """``now`` is the time; nothing happens on its own. Slaves count from 0."""

    def __init__(
        self, seed: int = 1, script: LabScript | None = None, ring: bool = False, **end: Any
    ) -> None:
        config = _config("config/ethercat.yaml")
        lab = config.lab
        assert lab is not None
        if end:
            new = lab.ethercat.model_copy(update=end)
            config = config.model_copy(update={"lab": lab.model_copy(update={"ethercat": new})})
        if ring:
            bus = config.fieldbus.model_copy(update={"redundant_interface": "back"})
            config = config.model_copy(update={"fieldbus": bus})
        self.now = 0
        self.lab = Lab(config, script or LabScript(), seed=seed, clock=lambda: self.now)
        self.segment = self.lab.segments[CHANNEL]
        self.slaves: list[Slave] = self.segment.slaves
        self.count = len(self.slaves)
        self._mail = [0] * self.count
        self._index = 0

    # -- frames ----------------------------------------------------------------------------------

    def wait(self, ms: float) -> None:
        self.now += round(ms * MS)
        self.lab.advance(self.now)

    def frame(self, *datagrams: Datagram, port: int = 0) -> list[Datagram] | None:
        """The answer's datagrams, 10 us later."""
        self.now += 10 * US
        self._index = self._index + 1 & 0xFF
        for one in datagrams:
            one.index = self._index
        answer = self.segment.exchange(build(datagrams), self.now, port)
        return None if answer is None else parse(answer)

    def one(
        self, command: Command, place: int, offset: int, data: bytes | int, port: int = 0
    ) -> tuple[bytes, int]:
        """Data and working counter of one physical datagram; ``data``: bytes, or how many zeros."""
        given = bytes(data) if isinstance(data, int) else data
        answer = self.frame(Datagram(command, physical(place, offset), given), port=port)
        assert answer is not None, "no answer"
        return answer[0].data, answer[0].counter

    def logical(self, command: Command, address: int, data: bytes) -> tuple[bytes, int]:
        answer = self.frame(Datagram(command, address, data))
        assert answer is not None, "no answer"
        return answer[0].data, answer[0].counter

    def read(self, slave: int, register: int, size: int) -> bytes:
        data, counter = self.one(Command.FPRD, STATION + slave, register, size)
        assert counter == 1, f"register 0x{register:03X} of slave {slave} does not answer"
        return data

    def number(self, slave: int, register: int, size: int) -> int:
        return int.from_bytes(self.read(slave, register, size), "little")

    def write(self, slave: int, register: int, data: bytes) -> None:
        _, counter = self.one(Command.FPWR, STATION + slave, register, data)
        assert counter == 1, f"register 0x{register:03X} of slave {slave} does not answer"

    # -- states ----------------------------------------------------------------------------------

    def address(self) -> None:
        for place in range(self.count):
            self.one(Command.APWR, -place, 0x010, struct.pack("<H", STATION + place))

    def standing(self, slave: int) -> tuple[int, int]:
        """AL status and AL status code."""
        status, _, code = struct.unpack("<HHH", self.read(slave, 0x130, 6))
        return status, code

    def request(self, slave: int, state: int) -> tuple[int, int]:
        """Ask for a state, 0x10 to acknowledge with it; status and code after that."""
        self.write(slave, 0x120, struct.pack("<H", state))
        return self.standing(slave)

    def manager(
        self, slave: int, number: int, start: int, length: int, control: int, enable: int = 1
    ) -> None:
        block = struct.pack("<HHBBBB", start, length, control, 0, enable, 0)
        self.write(slave, 0x800 + 8 * number, block)

    def open_mailbox(self, slave: int) -> None:
        kind = self.slaves[slave].kind
        self.manager(slave, 0, kind.receive_mailbox, kind.mailbox_bytes, 0x26)
        self.manager(slave, 1, kind.send_mailbox, kind.mailbox_bytes, 0x22)

    def pre_op(self, *slaves: int) -> None:
        """Station addresses, mailboxes and PRE-OP; of all slaves if none is named."""
        self.address()
        for slave in slaves or range(self.count):
            self.open_mailbox(slave)
            self._mail[slave] = 0
            assert self.request(slave, PRE_OP) == (PRE_OP, 0)

    # -- mailbox ---------------------------------------------------------------------------------

    def post(
        self, slave: int, content: bytes, protocol: int = 3, counter: int | None = None
    ) -> int:
        """Write a mailbox; its working counter."""
        if counter is None:
            self._mail[slave] = counter = self._mail[slave] % 7 + 1
        kind = self.slaves[slave].kind
        head = struct.pack("<HHBB", len(content), 0, 0, protocol | counter << 4)
        box = (head + content).ljust(kind.mailbox_bytes, b"\0")
        return self.one(Command.FPWR, STATION + slave, kind.receive_mailbox, box)[1]

    def fetch(self, slave: int) -> tuple[int, bytes] | None:
        """Type byte and content of what is in the send mailbox, None if it is empty."""
        kind = self.slaves[slave].kind
        data, counter = self.one(
            Command.FPRD, STATION + slave, kind.send_mailbox, kind.mailbox_bytes
        )
        if not counter:
            return None
        length, _, _, what = struct.unpack_from("<HHBB", data)
        return what, data[6 : 6 + length]

    def ask(self, slave: int, content: bytes) -> bytes:
        """The content of the one CoE message that answers another."""
        assert self.post(slave, content) == 1
        found = self.fetch(slave)
        assert found is not None
        assert found[0] & 0x0F == 3
        return found[1]

    def upload(self, slave: int, index: int, sub: int = 0, whole: bool = False) -> bytes:
        """The object's bytes; an AssertionError carries the abort code."""
        command = 0x50 if whole else 0x40
        answer = self.ask(slave, struct.pack("<HBHB4x", 2 << 12, command, index, sub))
        head = answer[2]
        assert head != 0x80, f"abort 0x{struct.unpack_from('<I', answer, 6)[0]:08X}"
        assert struct.unpack_from("<H", answer)[0] == 3 << 12
        if head & 2:
            return answer[6 : 10 - (head >> 2 & 3)]
        (total,) = struct.unpack_from("<I", answer, 6)
        found = answer[10:]
        toggle = 0
        while len(found) < total:
            segment = self.ask(slave, struct.pack("<HB7x", 2 << 12, 0x60 | toggle << 4))
            assert segment[2] >> 5 == 0
            assert segment[2] >> 4 & 1 == toggle
            found += segment[3 : len(segment) - (segment[2] >> 1 & 7)]
            toggle ^= 1
            assert bool(segment[2] & 1) == (len(found) == total)
        return found

    def download(self, slave: int, index: int, sub: int, data: bytes, whole: bool = False) -> int:
        """The abort code, 0 for success."""
        access = 0x10 if whole else 0
        if len(data) <= 4:
            head = 0x23 | (4 - len(data)) << 2 | access
            content = struct.pack("<HBHB", 2 << 12, head, index, sub) + data.ljust(4, b"\0")
            return _abort(self.ask(slave, content))
        room = self.slaves[slave].kind.mailbox_bytes - 16
        content = struct.pack("<HBHBI", 2 << 12, 0x21 | access, index, sub, len(data))
        answer = self.ask(slave, content + data[:room])
        at, toggle = room, 0
        while at < len(data) and not _abort(answer):
            part = data[at : at + room + 7]
            at += len(part)
            last = at >= len(data)
            unused = max(7 - len(part), 0)
            head = toggle << 4 | unused << 1 | last
            answer = self.ask(slave, struct.pack("<HB", 2 << 12, head) + part.ljust(7, b"\0"))
            toggle ^= 1
        return _abort(answer)

    # -- process data ----------------------------------------------------------------------------

    def map(self, slave: int, rpdo: tuple[int, ...] = RPDO, tpdo: tuple[int, ...] = TPDO) -> None:
        """Both PDOs, sync managers 2 and 3."""
        kind = self.slaves[slave].kind
        ways = [(0x1C13, 0x1A00, tpdo, 3, kind.inputs, 0x20)]
        if kind.outputs:
            ways.append((0x1C12, 0x1600, rpdo, 2, kind.outputs, 0x64))
        for assignment, mapping, words, number, start, control in ways:
            assert self.download(slave, assignment, 0, b"\0") == 0
            assert self.download(slave, mapping, 0, b"\0") == 0
            for place, word in enumerate(words, start=1):
                assert self.download(slave, mapping, place, struct.pack("<I", word)) == 0
            assert self.download(slave, mapping, 0, bytes((len(words),))) == 0
            assert self.download(slave, assignment, 1, struct.pack("<H", mapping)) == 0
            assert self.download(slave, assignment, 0, b"\1") == 0
            size = sum(word & 0xFF for word in words) // 8
            self.manager(slave, number, start, size, control)

    def fmmu(
        self,
        slave: int,
        number: int,
        logical: int,
        length: int,
        place: int,
        way: int,
        bits: tuple[int, int, int] = (0, 7, 0),
    ) -> None:
        """``bits``: first and last logical bit, first physical bit."""
        first, last, bit = bits
        block = struct.pack("<IHBBHBBB3x", logical, length, first, last, place, bit, way, 1)
        self.write(slave, 0x600 + 16 * number, block)

    def operate(self, *slaves: int, sync_ns: int = 0) -> int:
        """Drives from INIT to OP with 4 bytes of outputs and 8 of inputs each, outputs first from
        `LOGICAL`; ``sync_ns``: SYNC0 with this cycle. Returns the first pulse's system time."""
        self.pre_op(*slaves)
        first = 0
        for slave in slaves:
            self.map(slave)
        if sync_ns:
            self.one(Command.BWR, 0, 0x900, 4)
            first = self.synchronise(sync_ns, *slaves)
        for place, slave in enumerate(slaves):
            kind = self.slaves[slave].kind
            self.fmmu(slave, 0, LOGICAL + 4 * place, 4, kind.outputs, 2)
            self.fmmu(slave, 1, LOGICAL + 4 * len(slaves) + 8 * place, 8, kind.inputs, 1)
            assert self.request(slave, SAFE_OP) == (SAFE_OP, 0)
        for slave in slaves:
            self.write(slave, 0x120, struct.pack("<H", OP))
        if sync_ns:
            self.wait(3)
        for slave in slaves:
            assert self.standing(slave) == (OP, 0)
        return first

    def synchronise(self, cycle_ns: int, *slaves: int) -> int:
        """One system time for all, with their delays, and SYNC0 from 2 ms on."""
        for slave in slaves:
            clock = self.slaves[slave].clock
            local = self.number(slave, 0x918, 8)
            hop = self.slaves[slave].arrival_ns
            reference = self.number(slaves[0], 0x918, 8)
            offset = reference + hop - local & (1 << 64) - 1
            self.write(slave, 0x920, struct.pack("<QI", offset, hop))
            assert clock.delay == hop
        start = self.number(slaves[0], 0x910, 8) + 2 * MS
        start -= start % cycle_ns
        for slave in slaves:
            self.write(slave, 0x981, b"\0")
            self.write(slave, 0x990, struct.pack("<Q", start))
            self.write(slave, 0x9A0, struct.pack("<I", cycle_ns))
            self.write(slave, 0x981, b"\3")
        return start

    def cycle(self, words: list[tuple[int, int]]) -> tuple[list[tuple[int, int, int]], int]:
        """One LRW with controlword and torque of each drive: statusword, position and torque of
        each, and the working counter."""
        outputs = b"".join(struct.pack("<Hh", *pair) for pair in words)
        data, counter = self.logical(Command.LRW, LOGICAL, outputs + bytes(8 * len(words)))
        inputs = data[len(outputs) :]
        found = [struct.unpack_from("<Hih", inputs, 8 * place) for place in range(len(words))]
        return found, counter


def _abort(answer: bytes) -> int:
    code: int = struct.unpack_from("<I", answer, 6)[0] if answer[2] == 0x80 else 0
    return code
