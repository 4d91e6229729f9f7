"""An object dictionary after CiA 301: what a device lets others read and write, how it refuses.

A refusal is an `AbortError` with the code that an SDO server sends.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

Value = int | float | str

TOGGLE = 0x05030000
TIMEOUT = 0x05040000
COMMAND = 0x05040001
WRITE_ONLY = 0x06010001
READ_ONLY = 0x06010002
SUB0_FIRST = 0x06010003
NO_OBJECT = 0x06020000
NOT_MAPPABLE = 0x06040041
PDO_LENGTH = 0x06040042
INCOMPATIBLE = 0x06040043
INTERNAL = 0x06040047
HARDWARE = 0x06060000
TYPE_LENGTH = 0x06070010
LENGTH_LOW = 0x06070013
NO_SUBINDEX = 0x06090011
RANGE = 0x06090030
GENERAL = 0x08000000
CANNOT_STORE = 0x08000020
WRONG_STATE = 0x08000022
PASSWORD = 0x0F00FFBE
NMT_STATE = 0x0F00FFC0
"""The last two are the EPOS4's maker's."""

_TEXT = {
    TOGGLE: "the toggle bit did not change",
    TIMEOUT: "the transfer took too long",
    COMMAND: "the command is unknown",
    READ_ONLY: "the object is read only",
    WRITE_ONLY: "the object is write only",
    SUB0_FIRST: "subindex 0 must be 0 first",
    NO_OBJECT: "there is no such object",
    NOT_MAPPABLE: "the object cannot be mapped",
    PDO_LENGTH: "the mapped objects are longer than the PDO",
    INCOMPATIBLE: "the parameters do not go together",
    INTERNAL: "the device has nothing like that",
    HARDWARE: "the hardware has failed",
    TYPE_LENGTH: "the length does not suit the type",
    LENGTH_LOW: "the data are too short",
    NO_SUBINDEX: "there is no such subindex",
    RANGE: "the value is out of range",
    GENERAL: "general error",
    CANNOT_STORE: "the data cannot be stored",
    WRONG_STATE: "the device state forbids it",
    PASSWORD: "the password is wrong",
    NMT_STATE: "the NMT state forbids it",
}


class AbortError(LookupError):
    """A refused access, with its SDO abort code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}: {_TEXT.get(code, 'refused')}")
        self.code = code


class Kind(Enum):
    """A data type: bytes and little-endian struct letter."""

    U8 = (1, "B")
    U16 = (2, "H")
    U32 = (4, "I")
    U64 = (8, "Q")
    I8 = (1, "b")
    I16 = (2, "h")
    I32 = (4, "i")
    I64 = (8, "q")
    REAL32 = (4, "f")
    REAL64 = (8, "d")
    STRING = (0, "")

    @property
    def size(self) -> int:
        return self.value[0]

    @property
    def letter(self) -> str:
        return self.value[1]

    @property
    def real(self) -> bool:
        return self in (Kind.REAL32, Kind.REAL64)

    @property
    def limits(self) -> tuple[float, float]:
        if self.real:
            return float("-inf"), float("inf")
        bits = 8 * self.size
        if self.letter.islower():
            return -(1 << bits - 1), (1 << bits - 1) - 1
        return 0, (1 << bits) - 1


Row = tuple[int, int, str, Kind, str, int, int, int, str]
"""Index, subindex, name, type, access, default, low, high (0, 0: the type's), mapping."""
ALL = 0xFFFFFFFF


@dataclass(slots=True)
class Entry:
    """One subindex. ``access``: "ro", "rw", "wo" or "const".

    ``mapping``: "" not mappable, "r" into an RPDO, "t" into a TPDO, "rt" both.
    ``read`` replaces the value; ``write`` is called with a checked value, before it is taken over,
    and may raise `AbortError`. ``allowed`` narrows a range to single values. ``relative``: the
    value counts from the node's number. ``lasting``: saved with the parameters.
    """

    name: str
    kind: Kind
    access: str
    value: Value
    low: float = 0
    high: float = 0
    mapping: str = ""
    allowed: tuple[int, ...] = ()
    read: Callable[[], Value] | None = None
    write: Callable[[int], None] | None = None
    relative: bool = False
    lasting: bool = True
    default: Value = 0
    """as from the factory"""
    stored: Value = 0
    """as at the next switch-on"""

    def __post_init__(self) -> None:
        self.default = self.stored = self.value
        if self.low == self.high == 0 and self.kind is not Kind.STRING:
            self.low, self.high = self.kind.limits

    @property
    def number(self) -> int:
        """The value of an integer object that nothing replaces."""
        assert isinstance(self.value, int)
        return self.value

    def get(self) -> Value:
        return self.value if self.read is None else self.read()

    def set(self, value: Value) -> None:
        """A new default, of which no client knows."""
        self.value = self.default = self.stored = value

    def takes(self, value: float) -> bool:
        # Written so that a NaN is refused as well.
        if not self.low <= value <= self.high:
            return False
        return not self.allowed or value in self.allowed

    def measure(self) -> float:
        """What a PDO sends of it."""
        value = self.get()
        assert not isinstance(value, str)
        return value

    def put(self, value: int) -> None:
        """What a PDO brings; it cannot be refused, so that a wrong value has no effect."""
        if self.takes(value):
            if self.write is not None:
                self.write(value)
            self.value = value

    def encode(self) -> bytes:
        value = self.get()
        if isinstance(value, str):
            return value.encode("ascii")
        return struct.pack("<" + self.kind.letter, value)


class ObjectDictionary:
    """Entries by index and subindex. Every object has a subindex 0, given or made.

    ``names``: those of arrays and records, by index.
    """

    def __init__(self) -> None:
        self.entries: dict[tuple[int, int], Entry] = {}
        self.names: dict[int, str] = {}
        self._indices: set[int] = set()

    def add(self, index: int, subindex: int, entry: Entry) -> Entry:
        """A record's or array's subindex 0 is made with its first part and counts up."""
        self.entries[index, subindex] = entry
        self._indices.add(index)
        if subindex > 0:
            head = self.entries.get((index, 0))
            if head is None:
                count = Entry("Highest sub-index supported", Kind.U8, "ro", subindex)
                self.entries[index, 0] = count
            elif head.access == "ro":
                head.set(max(int(head.value), subindex))
        return entry

    def find(self, index: int, subindex: int) -> Entry:
        """Raises `AbortError`."""
        entry = self.entries.get((index, subindex))
        if entry is None:
            raise AbortError(NO_SUBINDEX if index in self._indices else NO_OBJECT)
        return entry

    def number(self, index: int, subindex: int) -> int:
        """The present value of an integer object."""
        value = self.find(index, subindex).get()
        assert isinstance(value, int)
        return value

    def read(self, index: int, subindex: int) -> bytes:
        """Little-endian bytes as SDO carries them. Raises `AbortError`."""
        entry = self.find(index, subindex)
        if entry.access == "wo":
            raise AbortError(WRITE_ONLY)
        return entry.encode()

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Raises `AbortError`; then nothing has changed."""
        entry = self.find(index, subindex)
        if entry.access in ("ro", "const"):
            raise AbortError(READ_ONLY)
        kind = entry.kind
        if kind is Kind.STRING:
            entry.value = data.decode("ascii", "replace")
            return
        if len(data) != kind.size:
            raise AbortError(LENGTH_LOW if len(data) < kind.size else TYPE_LENGTH)
        (value,) = struct.unpack("<" + kind.letter, data)
        if not entry.takes(value):
            raise AbortError(RANGE)
        if entry.write is not None:
            entry.write(value)
        entry.value = value

    def save(self) -> None:
        """Keep the present parameters over a reset."""
        for entry in self.entries.values():
            if entry.access == "rw" and entry.lasting:
                entry.stored = entry.value

    def forget(self) -> None:
        """Have the parameters of the factory again after the next reset."""
        for entry in self.entries.values():
            entry.stored = entry.default

    def restore(self, low: int, high: int) -> None:
        """Set objects of an index range (``high`` included) to what they are at switch-on."""
        for (index, _), entry in self.entries.items():
            if low <= index <= high and entry.access == "rw":
                entry.value = entry.stored
