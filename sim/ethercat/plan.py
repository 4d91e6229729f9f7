"""How a logical datagram falls on a segment's slaves, worked out once per address and length."""

from __future__ import annotations

from collections.abc import Iterable
from struct import Struct

from tonus.sim.ethercat.slaves import registers as reg
from tonus.sim.ethercat.slaves.controller import READ, WRITE, Manager, Mapping
from tonus.sim.ethercat.slaves.slave import Slave

Copy = tuple[int, int, int]
"""Place in the datagram's data, address in the slave, bytes."""
Bit = tuple[int, int]
"""The same for one bit, counted from the start of either."""


class Part:
    """What one slave does with the datagram. ``counter`` is what it adds."""

    __slots__ = (
        "bit_reads",
        "bit_writes",
        "counter",
        "inputs",
        "outputs",
        "reads",
        "registers",
        "slave",
        "writes",
    )

    def __init__(self, slave: Slave) -> None:
        self.slave = slave
        self.writes: list[Copy] = []
        self.reads: list[Copy] = []
        self.bit_writes: list[Bit] = []
        self.bit_reads: list[Bit] = []
        self.registers: list[tuple[int, Copy]] = []
        """way and copy, for which the controller is asked"""
        self.outputs = False
        """the output area is complete with it"""
        self.inputs = False
        self.counter = 0

    def play(self, frame: bytearray, data: int, size: int, now_ns: int) -> None:
        """Do it. Bytes may be mapped both ways, in the frame and in the slave: each way takes what
        was there before."""
        slave = self.slave
        memory = slave.controller.memory
        writes = self.writes
        given = [frame[data + at : data + at + count] for at, _, count in writes]
        if self.bit_writes or self.bit_reads or self.registers:
            self._slowly(frame, data, size, now_ns)
        for at, place, count in self.reads:
            frame[data + at : data + at + count] = memory[place : place + count]
        for (_, place, count), piece in zip(writes, given, strict=True):
            memory[place : place + count] = piece
        if self.outputs:
            slave.outputs_written(now_ns)
        elif self.inputs:
            slave.inputs_read(now_ns)

    def _slowly(self, frame: bytearray, data: int, size: int, now_ns: int) -> None:
        """Single bits, and registers."""
        memory = self.slave.controller.memory
        given = frame[data : data + size]
        self._through(frame, data, now_ns)
        if self.bit_reads:
            found = frame[data : data + size]
            copy_bits(memory, found, ((to, where) for where, to in self.bit_reads))
            frame[data : data + size] = found
        if self.bit_writes:
            copy_bits(given, memory, self.bit_writes)

    def _through(self, frame: bytearray, data: int, now_ns: int) -> None:
        """Copies of registers, which do more than memory does."""
        controller = self.slave.controller
        for way, (at, place, count) in self.registers:
            if way == WRITE:
                controller.write(place, bytes(frame[data + at : data + at + count]), now_ns)
            else:
                found = controller.read(place, count, now_ns)
                if found is not None:
                    frame[data + at : data + at + count] = found


class Plan:
    """What all slaves do with the datagram: slave by slave, or ``straight``, with the same effect,
    where that is possible."""

    __slots__ = ("counter", "parts", "straight")

    def __init__(self, parts: list[Part]) -> None:
        self.parts = parts
        self.counter = sum(part.counter for part in parts)
        self.straight = _straighten(parts)

    def play(self, frame: bytearray, data: int, size: int, now_ns: int) -> None:
        """Do it; the datagram's data begin at ``data``."""
        straight = self.straight
        if straight is None:
            for part in self.parts:
                part.play(frame, data, size, now_ns)
            return
        for at, end, views in straight.runs:
            frame[data + at : data + end] = b"".join(views)
        pieces = straight.unpack(frame, data)
        for (slave, area), piece in zip(straight.areas, pieces, strict=True):
            if piece:
                area[:] = piece
                slave.outputs_came(piece, now_ns)
            else:
                slave.inputs_read(now_ns)


class Straight:
    """A plan in which each slave has one area each way at most, completes it and `takes` it, and no
    byte of the datagram goes both ways."""

    __slots__ = ("areas", "runs", "unpack")

    def __init__(
        self,
        runs: list[tuple[int, int, list[memoryview]]],
        areas: list[tuple[Slave, memoryview]],
        layout: Struct,
    ) -> None:
        self.runs = runs
        """inputs that lie one behind the other in the datagram: first place, end, whence"""
        self.areas = areas
        """every slave with its output area, empty if it has inputs only"""
        self.unpack = layout.unpack_from
        """the pieces of the datagram for these"""


def compile_plan(slaves: Iterable[Slave], ways: int, start: int, length: int) -> Plan:
    """``ways``: `READ` for LRD, `WRITE` for LWR, both for LRW. Slaves that have no part are left
    out; so are mappings that a sync manager does not let through."""
    found = []
    for slave in slaves:
        part = Part(slave)
        done = 0
        for mapping in slave.controller.mappings:
            for way in (WRITE, READ):
                if mapping.way & ways & way and _add(part, mapping, way, start, length):
                    done |= way
        if done:
            part.counter = {WRITE: 2 if ways & READ else 1, READ: 1}.get(done, 3)
            found.append(part)
    return Plan(found)


def _straighten(parts: list[Part]) -> Straight | None:
    read_at: set[int] = set()
    written_at: set[int] = set()
    runs: list[tuple[int, int, list[memoryview]]] = []
    areas = []
    layout, end_of_writes = "<", 0
    for part in parts:
        writes, reads = part.writes, part.reads
        if part.bit_reads or part.bit_writes or part.registers:
            return None
        if len(writes) > 1 or len(reads) > 1:
            return None
        if part.outputs != bool(writes) or part.inputs != bool(reads):
            return None
        memory = memoryview(part.slave.controller.memory)
        for at, place, count in reads:
            read_at.update(range(at, at + count))
            if not runs or runs[-1][1] != at:
                runs.append((at, at, []))
            first, _, views = runs[-1]
            runs[-1] = first, at + count, [*views, memory[place : place + count]]
        area = memory[:0]
        for at, place, count in writes:
            if at < end_of_writes or not part.slave.takes(place, count):
                return None
            layout += f"{at - end_of_writes}x{count}s"
            end_of_writes = at + count
            written_at.update(range(at, at + count))
            area = memory[place : place + count]
        if not writes:
            layout += "0s"
        areas.append((part.slave, area))
    if not areas or not read_at.isdisjoint(written_at):
        return None
    return Straight(runs, areas, Struct(layout))


def _add(part: Part, mapping: Mapping, way: int, start: int, length: int) -> bool:
    """Whether the mapping meets the datagram."""
    low = max(mapping.logical, start)
    high = min(mapping.logical + mapping.length, start + length)
    if low >= high:
        return False
    if not mapping.bytewise:
        return _add_bits(part, mapping, way, start, length)
    place = mapping.physical + low - mapping.logical
    size = high - low
    passage = part.slave.controller.may(way, place, place + size)
    if not passage:
        return False
    copy = (low - start, place, size)
    if place < reg.MEMORY:
        part.registers.append((way, copy))
        return True
    (part.writes if way == WRITE else part.reads).append(copy)
    _complete(part, passage, way, place + size)
    return True


def _complete(part: Part, passage: Manager | bool, way: int, end: int) -> None:
    if isinstance(passage, Manager) and end == passage.end:
        if way == WRITE:
            part.outputs = True
        else:
            part.inputs = True


def _add_bits(part: Part, mapping: Mapping, way: int, start: int, length: int) -> bool:
    count = 8 * (mapping.length - 1) + mapping.last_bit - mapping.first_bit + 1
    bits = []
    for number in range(max(count, 0)):
        place = 8 * (mapping.logical - start) + mapping.first_bit + number
        if 0 <= place < 8 * length:
            bits.append((place, 8 * mapping.physical + mapping.physical_bit + number))
    if not bits:
        return False
    first, end = bits[0][1] // 8, bits[-1][1] // 8 + 1
    passage = part.slave.controller.may(way, first, end)
    if not passage or (way == WRITE and first < reg.MEMORY):
        return False
    (part.bit_writes if way == WRITE else part.bit_reads).extend(bits)
    _complete(part, passage, way, end)
    return True


def copy_bits(source: bytearray, target: bytearray, bits: Iterable[Bit]) -> None:
    """Bit by bit, first place of each pair to the second."""
    for where, to in bits:
        mask = 1 << to % 8
        if source[where // 8] >> where % 8 & 1:
            target[to // 8] |= mask
        else:
            target[to // 8] &= ~mask
