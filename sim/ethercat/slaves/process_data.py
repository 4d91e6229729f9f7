"""Process data of a slave: PDO mapping and assignment, and what they compile to."""

from __future__ import annotations

import struct
from collections.abc import Callable

from tonus.sim.devices.device import Device, PdoDefault, Reader, Writer
from tonus.sim.devices.objects import (
    NOT_MAPPABLE,
    PDO_LENGTH,
    SUB0_FIRST,
    WRONG_STATE,
    AbortError,
    Entry,
    Kind,
)
from tonus.sim.ethercat.slaves.identity import Kind as SlaveKind

RECEIVE_MAPPING = 0x1600
TRANSMIT_MAPPING = 0x1A00
MANAGER_TYPES = 0x1C00
RECEIVE_ASSIGNMENT = 0x1C12
TRANSMIT_ASSIGNMENT = 0x1C13
OUTPUT_SYNC = 0x1C32
INPUT_SYNC = 0x1C33
FREE_RUN, BY_MANAGER, BY_SYNC0 = 0, 1, 2
_SUPPORTED = 0x0007
_CONTROLWORD = 0x6040
_SET_POINT = [0x60400010, 0x60710010]
"""Outputs of a drive in cyclic synchronous torque."""
_NAMES = {
    MANAGER_TYPES: "Sync manager communication type",
    RECEIVE_ASSIGNMENT: "Sync manager 2 PDO assignment",
    TRANSMIT_ASSIGNMENT: "Sync manager 3 PDO assignment",
    OUTPUT_SYNC: "Sync manager 2 synchronization",
    INPUT_SYNC: "Sync manager 3 synchronization",
}


class ProcessData:
    """``configurable`` says whether mapping and assignment may be written: in PRE-OP only."""

    def __init__(self, device: Device, kind: SlaveKind, configurable: Callable[[], bool]) -> None:
        self._device = device
        self._objects = device.objects
        self._kind = kind
        self._configurable = configurable
        self._has_outputs = bool(kind.outputs)
        self.size = 0
        """bytes of outputs, as compiled"""
        self._setters: list[tuple[int, Writer]] = []
        self._getters: tuple[Reader, ...] = ()
        self.places: tuple[int | None, ...] = ()
        """where each of the inputs stands in `Samples.values`; None: nowhere"""
        self.letters = ""
        """of the inputs, in a format of `struct`"""
        self.is_set_point = False
        """the outputs are a controlword and a target torque, and nothing else"""
        self._unpack = struct.Struct("<").unpack
        self._pack = struct.Struct("<").pack
        device.objects.names |= {
            index: name
            for index, name in _NAMES.items()
            if index != OUTPUT_SYNC or self._has_outputs
        }
        self._add_mappings()
        self._add_managers()

    # -- objects ---------------------------------------------------------------------------------

    def _add_mappings(self) -> None:
        device = self._device
        ways = (
            ("Receive", RECEIVE_MAPPING, device.receive_pdos),
            ("Transmit", TRANSMIT_MAPPING, device.transmit_pdos),
        )
        for name, index, defaults in ways:
            for number, default in enumerate(defaults):
                self._add_mapping(name, index, number, default)

    def _add_mapping(self, way: str, base: int, number: int, default: PdoDefault) -> None:
        objects, index = self._objects, base + number
        objects.names[index] = f"{way} PDO {number + 1} mapping"
        longest = self._kind.longest_mapping
        words = default.mapping
        count = Entry("Number of mapped objects", Kind.U8, "rw", len(words), 0, longest)
        count.write = lambda value: self._check_count(index, value)
        objects.add(index, 0, count)
        letter = "r" if base == RECEIVE_MAPPING else "t"
        for place in range(longest):
            word = words[place] if place < len(words) else 0
            entry = Entry(f"Mapped object {place + 1}", Kind.U32, "rw", word)
            entry.write = lambda value: self._check_entry(count, letter, value)
            objects.add(index, place + 1, entry)

    def _add_managers(self) -> None:
        objects = self._objects
        types = (1, 2, 3 if self._has_outputs else 0, 4)
        for number, use in enumerate(types, start=1):
            objects.add(MANAGER_TYPES, number, Entry(f"Type of SM{number - 1}", Kind.U8, "ro", use))
        ways = [
            (TRANSMIT_ASSIGNMENT, INPUT_SYNC, TRANSMIT_MAPPING, len(self._device.transmit_pdos))
        ]
        if self._has_outputs:
            count = len(self._device.receive_pdos)
            ways.insert(0, (RECEIVE_ASSIGNMENT, OUTPUT_SYNC, RECEIVE_MAPPING, count))
        else:
            # Masters read it of every slave, and find that nothing is assigned.
            empty = Entry("Number of assigned PDOs", Kind.U8, "ro", 0)
            objects.add(RECEIVE_ASSIGNMENT, 0, empty)
        for assignment, sync, mapping, pdos in ways:
            self._add_assignment(assignment, mapping, pdos)
            self._add_sync(sync)

    def _add_assignment(self, index: int, mapping: int, pdos: int) -> None:
        """One PDO at a time, as the maker's description has it."""
        count = Entry("Number of assigned PDOs", Kind.U8, "rw", 1, 0, 1)
        entry = Entry("Assigned PDO 1", Kind.U16, "rw", mapping, mapping, mapping + pdos - 1)

        def assign(value: int) -> None:
            del value
            self._check_state()
            if count.value != 0:
                raise AbortError(SUB0_FIRST)

        count.write = lambda _: self._check_state()
        entry.write = assign
        self._objects.add(index, 0, count)
        self._objects.add(index, 1, entry)

    def _add_sync(self, index: int) -> None:
        add = self._objects.add
        mode = add(index, 1, Entry("Synchronization type", Kind.U16, "rw", BY_MANAGER))
        mode.allowed = (FREE_RUN, BY_MANAGER, BY_SYNC0)
        mode.write = lambda _: self._check_state()
        add(index, 2, Entry("Cycle time", Kind.U32, "rw", 0))
        add(index, 4, Entry("Synchronization types supported", Kind.U16, "ro", _SUPPORTED))
        add(index, 5, Entry("Minimum cycle time", Kind.U32, "ro", 1_000_000))
        add(index, 11, Entry("SM event missed counter", Kind.U16, "ro", 0))
        add(index, 12, Entry("Cycle exceeded counter", Kind.U16, "ro", 0))

    def _check_state(self) -> None:
        if not self._configurable():
            raise AbortError(WRONG_STATE)

    def _check_count(self, index: int, value: int) -> None:
        self._check_state()
        words = [self._objects.number(index, place + 1) for place in range(value)]
        if not all(words):
            raise AbortError(NOT_MAPPABLE)
        if sum(word & 0xFF for word in words) > 8 * self._kind.longest_pdo:
            raise AbortError(PDO_LENGTH)

    def _check_entry(self, count: Entry, way: str, value: int) -> None:
        self._check_state()
        if count.value != 0:
            raise AbortError(SUB0_FIRST)
        if value == 0:
            return
        try:
            entry = self._objects.find(value >> 16, value >> 8 & 0xFF)
        except AbortError as abort:
            raise AbortError(NOT_MAPPABLE) from abort
        if way not in entry.mapping or value & 0xFF != 8 * entry.kind.size:
            raise AbortError(NOT_MAPPABLE)

    def count_missed(self) -> None:
        """A SYNC0 came and no new outputs had."""
        entry = self._objects.entries.get((OUTPUT_SYNC, 11))
        if entry is not None:
            entry.value = (entry.number + 1) & 0xFFFF

    def wants_sync(self) -> bool:
        """Whether the master has asked for SYNC0 by object."""
        index = OUTPUT_SYNC if self._has_outputs else INPUT_SYNC
        return self._objects.number(index, 1) == BY_SYNC0

    # -- what is mapped --------------------------------------------------------------------------

    def _words(self, assignment: int) -> list[int]:
        number = self._objects.number
        if (assignment, 0) not in self._objects.entries or not number(assignment, 0):
            return []
        index = number(assignment, 1)
        return [number(index, place + 1) for place in range(number(index, 0))]

    def sizes(self) -> tuple[int, int]:
        """Bytes of outputs and inputs as they are mapped now."""
        return self._bytes(RECEIVE_ASSIGNMENT), self._bytes(TRANSMIT_ASSIGNMENT)

    def _bytes(self, assignment: int) -> int:
        return sum(word & 0xFF for word in self._words(assignment)) // 8

    def compile(self) -> None:
        """Take the mapping over. Raises `AbortError` for what the device cannot exchange."""
        device = self._device
        outputs, inputs = self._words(RECEIVE_ASSIGNMENT), self._words(TRANSMIT_ASSIGNMENT)
        setters = [
            (place, device.writer(word >> 16, word >> 8 & 0xFF))
            for place, word in enumerate(outputs)
        ]
        # The controlword acts on what came with it.
        self._setters = sorted(setters, key=lambda item: outputs[item[0]] >> 16 == _CONTROLWORD)
        self._getters = tuple(device.reader(word >> 16, word >> 8 & 0xFF) for word in inputs)
        self.places = tuple(device.place(word >> 16, word >> 8 & 0xFF) for word in inputs)
        self.letters = self._letters(inputs)
        self.is_set_point = outputs == _SET_POINT
        layout = struct.Struct("<" + self._letters(outputs))
        self.size = layout.size
        self._unpack = layout.unpack
        self._pack = struct.Struct("<" + self.letters).pack

    def _letters(self, words: list[int]) -> str:
        find = self._objects.find
        return "".join(find(word >> 16, word >> 8 & 0xFF).kind.letter for word in words)

    def inputs(self) -> bytes:
        """Of the device's last sample."""
        return self._pack(*[get() for get in self._getters])

    def apply(self, outputs: bytes | bytearray, now_ns: int) -> None:
        """Give the device its outputs."""
        if not self._setters:
            return
        values = self._unpack(outputs)
        for place, setter in self._setters:
            setter(values[place])
        self._device.received(now_ns)
