"""How a logical datagram falls on a segment's slaves, worked out once per address and length."""

from __future__ import annotations

from collections.abc import Iterable

from sim.ethercat import registers as reg
from sim.ethercat.controller import READ, WRITE, Manager, Mapping
from sim.ethercat.slave import Slave

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


def compile_plan(slaves: Iterable[Slave], ways: int, start: int, length: int) -> list[Part]:
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
    return found


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
