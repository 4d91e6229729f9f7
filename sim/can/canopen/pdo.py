"""Process data objects of a node: their parameters in the dictionary, and what they compile to."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

from tonus.sim.can.wire.frame import Frame, arbitration_key
from tonus.sim.devices.device import Device, PdoDefault, Reader, Writer
from tonus.sim.devices.objects import (
    INCOMPATIBLE,
    NMT_STATE,
    NOT_MAPPABLE,
    PDO_LENGTH,
    RANGE,
    SUB0_FIRST,
    AbortError,
    Entry,
    Kind,
)

RPDO_PARAMETERS = 0x1400
RPDO_MAPPING = 0x1600
TPDO_PARAMETERS = 0x1800
TPDO_MAPPING = 0x1A00
COUNT = 0x200
"""PDOs that an object area has room for."""
INVALID = 1 << 31
_NO_REMOTE = 1 << 30
_LAST_SYNCHRONOUS = 240
_ON_REQUEST = 253
_EVENT = (254, 255)
_INHIBIT = 10
_FRAME_BITS = 64
CONTROLWORD = 0x6040
# Identifiers that CiA 301 keeps for NMT, SYNC, EMCY of nobody, SDO and error control.
_RESERVED = (range(0x081), range(0x101, 0x181), range(0x580, 0x800))


class ReceivePdo:
    """A valid RPDO, ready to be applied. ``data`` waits for the SYNC."""

    __slots__ = ("_setters", "_unpack", "data", "identifier", "length", "synchronous", "words")

    def __init__(
        self,
        identifier: int,
        transmission: int,
        letters: str,
        setters: Sequence[Writer],
        words: Sequence[int],
    ) -> None:
        """``words`` are those of the mapping."""
        layout = struct.Struct("<" + letters)
        self.identifier = identifier
        self.length = layout.size
        self.synchronous = transmission <= _LAST_SYNCHRONOUS
        self.words = tuple(words)
        self.data: bytes | None = None
        self._unpack = layout.unpack_from
        self._setters = list(enumerate(setters))

    def put_last(self, place: int) -> None:
        """Apply the object at this place after the others."""
        self._setters.sort(key=lambda item: item[0] == place)

    def hold(self, frame: Frame) -> bool:
        """Keep a frame for the next SYNC; False if it is too short."""
        if len(frame.data) < self.length:
            return False
        self.data = frame.data
        return True

    def apply(self, data: bytes) -> None:
        values = self._unpack(data)
        for place, setter in self._setters:
            setter(values[place])


class TransmitPdo:
    """A valid TPDO, ready to be sent."""

    __slots__ = (
        "_getters",
        "_key",
        "_pack",
        "_sent_ns",
        "event",
        "fields",
        "identifier",
        "inhibit_ns",
        "last",
        "period_ns",
        "phase",
        "rate",
        "remote",
    )

    def __init__(
        self,
        cob_id: int,
        transmission: int,
        inhibit_ns: int,
        letters: str,
        getters: Sequence[Reader],
        fields: Sequence[tuple[int | None, int]],
    ) -> None:
        """``fields``: of each object its place in `Samples.values`, or None, and its bytes."""
        self.identifier = identifier = cob_id & 0x7FF
        self.rate = transmission if transmission <= _LAST_SYNCHRONOUS else 0
        """sent on every so many SYNCs; 0: not on SYNC"""
        self.event = transmission in _EVENT
        """sent when it changes"""
        self.remote = not cob_id & _NO_REMOTE
        """sent when a remote frame asks for it"""
        self.phase = 0
        self.inhibit_ns = inhibit_ns
        self.period_ns = 0
        """event timer: sent at the latest so long after the last time; 0: only on change"""
        self.last = b""
        self._sent_ns = 0
        self._key = arbitration_key(identifier)
        self._pack = struct.Struct("<" + letters).pack
        self._getters = tuple(getters)
        self.fields = tuple(fields)

    def wants(self, data: bytes, now_ns: int) -> bool:
        """Whether an event-driven PDO with these data is to be sent now, which then is booked."""
        late = 0 < self.period_ns <= now_ns - self._sent_ns
        if data == self.last and not late:
            return False
        self.last, self._sent_ns = data, now_ns
        return True

    def frame(self) -> Frame:
        data = self._pack(*[get() for get in self._getters])
        return Frame(self.identifier, data, len(data), self._key)


class Pdos:
    """The PDO part of a node's dictionary."""

    def __init__(self, device: Device, node_id: int, operational: Callable[[], bool]) -> None:
        self._device = device
        self._objects = device.objects
        self._operational = operational
        self._receive = len(device.receive_pdos)
        self._transmit = len(device.transmit_pdos)
        for number, default in enumerate(device.receive_pdos):
            self._add(number, default, node_id, RPDO_PARAMETERS, RPDO_MAPPING)
        for number, default in enumerate(device.transmit_pdos):
            self._add(number, default, node_id, TPDO_PARAMETERS, TPDO_MAPPING)

    def _add(
        self, number: int, default: PdoDefault, node_id: int, parameters: int, mapping: int
    ) -> None:
        add = self._objects.add
        names = self._objects.names
        kind_of = "Receive" if parameters == RPDO_PARAMETERS else "Transmit"
        names[parameters + number] = f"{kind_of} PDO {number + 1} parameter"
        names[mapping + number] = f"{kind_of} PDO {number + 1} mapping"
        cob = Entry("COB-ID", Kind.U32, "rw", default.cob_id + node_id, relative=True)
        cob.write = lambda value: self._check_cob_id(cob, value)
        add(parameters + number, 1, cob)
        kind = Entry("Transmission type", Kind.U8, "rw", default.transmission)
        kind.allowed = (*range(1, _LAST_SYNCHRONOUS + 1), *_EVENT)
        if parameters == RPDO_PARAMETERS:
            kind.allowed = (0, *kind.allowed)
        else:
            kind.allowed = (*kind.allowed, _ON_REQUEST)
        kind.write = self._check_state
        add(parameters + number, 2, kind)
        if parameters == TPDO_PARAMETERS:
            add(parameters + number, 3, Entry("Inhibit time", Kind.U16, "rw", _INHIBIT))
            if self._device.event_timer:
                add(parameters + number, 5, Entry("Event timer", Kind.U16, "rw", 0))
        longest = self._device.longest_mapping
        count = Entry("Number of mapped objects", Kind.U8, "rw", len(default.mapping), 0, longest)
        count.write = lambda value: self._check_count(mapping + number, cob, value)
        add(mapping + number, 0, count)
        way = "r" if mapping == RPDO_MAPPING else "t"
        for place in range(longest):
            word = default.mapping[place] if place < len(default.mapping) else 0
            entry = Entry(f"Mapped object {place + 1}", Kind.U32, "rw", word)
            entry.write = lambda value: self._check_entry(count, way, value)
            add(mapping + number, place + 1, entry)

    def _check_state(self, value: int) -> None:
        del value
        if self._operational():
            raise AbortError(NMT_STATE)

    def _check_cob_id(self, cob: Entry, value: int) -> None:
        self._check_state(value)
        identifier = value & ~(INVALID | _NO_REMOTE)
        if identifier > 0x7FF or any(identifier in kept for kept in _RESERVED):
            raise AbortError(RANGE)
        valid_before = not int(cob.value) & INVALID
        if valid_before and not value & INVALID and (int(cob.value) ^ value) & 0x7FF:
            raise AbortError(RANGE)  # a valid PDO keeps its identifier

    def _check_count(self, index: int, cob: Entry, value: int) -> None:
        self._check_state(value)
        if not int(cob.value) & INVALID:
            raise AbortError(INCOMPATIBLE)
        words = [self._objects.number(index, place + 1) for place in range(value)]
        if not all(words):
            raise AbortError(NOT_MAPPABLE)
        if sum(word & 0xFF for word in words) > _FRAME_BITS:
            raise AbortError(PDO_LENGTH)

    def _check_entry(self, count: Entry, way: str, value: int) -> None:
        self._check_state(value)
        if count.value != 0:
            raise AbortError(SUB0_FIRST)
        if value == 0:
            return
        entry = self._objects.find(value >> 16, value >> 8 & 0xFF)
        if way not in entry.mapping or value & 0xFF != 8 * entry.kind.size:
            raise AbortError(NOT_MAPPABLE)

    def _words(self, index: int) -> list[int]:
        number = self._objects.number
        return [number(index, place + 1) for place in range(number(index, 0))]

    def _letters(self, words: Sequence[int]) -> str:
        find = self._objects.find
        return "".join(find(word >> 16, word >> 8 & 0xFF).kind.letter for word in words)

    def receive(self) -> list[ReceivePdo]:
        """The valid RPDOs as they are configured now."""
        number = self._objects.number
        found = []
        for n in range(self._receive):
            cob = number(RPDO_PARAMETERS + n, 1)
            words = self._words(RPDO_MAPPING + n)
            if cob & INVALID or not words:
                continue
            setters = [self._device.writer(word >> 16, word >> 8 & 0xFF) for word in words]
            kind = number(RPDO_PARAMETERS + n, 2)
            pdo = ReceivePdo(cob & 0x7FF, kind, self._letters(words), setters, words)
            for place, word in enumerate(words):
                if word >> 16 == CONTROLWORD:
                    pdo.put_last(place)
            found.append(pdo)
        return found

    def transmit(self) -> list[TransmitPdo]:
        """The valid TPDOs as they are configured now."""
        number = self._objects.number
        found = []
        for n in range(self._transmit):
            cob = number(TPDO_PARAMETERS + n, 1)
            words = self._words(TPDO_MAPPING + n)
            if cob & INVALID or not words:
                continue
            getters = [self._device.reader(word >> 16, word >> 8 & 0xFF) for word in words]
            kind = number(TPDO_PARAMETERS + n, 2)
            inhibit_ns = number(TPDO_PARAMETERS + n, 3) * 100_000
            letters = self._letters(words)
            places = [self._device.place(word >> 16, word >> 8 & 0xFF) for word in words]
            fields = [
                (place, (word & 0xFF) // 8) for place, word in zip(places, words, strict=True)
            ]
            pdo = TransmitPdo(cob, kind, inhibit_ns, letters, getters, fields)
            if self._device.event_timer:
                pdo.period_ns = number(TPDO_PARAMETERS + n, 5) * 1_000_000
            found.append(pdo)
        return found
