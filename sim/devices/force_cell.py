"""An emulated CiA 404 force cell: one channel in newtons, as float and as integers.

Its low-pass is the plant's, its noise and range the samples'; here are its objects.
"""

from __future__ import annotations

from collections.abc import Callable

from config.schema.lab import CellNoise
from sim.devices.device import ErrorSink, PdoDefault, Reader, Writer
from sim.devices.objects import READ_ONLY, AbortError, Entry, Kind, ObjectDictionary, Value
from sim.devices.samples import CELL, Samples
from sim.devices.timers import Timers

DEVICE_TYPE = 0x00020194
VENDOR = 0x0000FFFF
PRODUCT = 0x00000404
REVISION = 0x00000001
NEWTON = 0x00210000
"""CiA 303-2"""
FORCE_SENSOR = 0x005A
_OVERFLOW = 3
_UNDERFLOW = 5
_DIGITS = 2
_MOST_DIGITS = 6
_INT16 = 0x7FFF
_SENSOR_ERROR = 0x5010
"""CiA 404: an open or broken sensor; error register bit 0."""
_VALID_NO_REMOTE = 0x40000000
_LIFE = 255


def _no_sink(code: int, register: int) -> None:
    del code, register


class ForceCell:
    """One of the nine cells."""

    receive_pdos: tuple[PdoDefault, ...] = ()
    transmit_pdos: tuple[PdoDefault, ...] = (
        PdoDefault(_VALID_NO_REMOTE | 0x180, _LIFE, (0x91300120,)),
    )
    longest_mapping = 4
    consumers = 1

    def __init__(
        self, cell: int, node_id: int, samples: Samples, noise: CellNoise, timers: Timers
    ) -> None:
        self.cell = cell
        self.on_error: ErrorSink = _no_sink
        self._samples = samples
        self._range = noise.range
        self._timers = timers
        self.objects = self._dictionary(node_id)
        self.reset()

    def _dictionary(self, node_id: int) -> ObjectDictionary:
        objects = ObjectDictionary()

        def add(index: int, sub: int, name: str, kind: Kind, access: str, value: Value) -> Entry:
            return objects.add(index, sub, Entry(name, kind, access, value))

        add(0x1000, 0, "device type", Kind.U32, "ro", DEVICE_TYPE)
        add(0x1001, 0, "error register", Kind.U8, "ro", 0)
        add(0x1008, 0, "device name", Kind.STRING, "const", "force cell")
        for number, (name, value) in enumerate(
            (
                ("vendor", VENDOR),
                ("product code", PRODUCT),
                ("revision", REVISION),
                ("serial number", node_id),
            ),
            start=1,
        ):
            add(0x1018, number, name, Kind.U32, "ro", value)
        add(0x6110, 1, "sensor type", Kind.U16, "ro", FORCE_SENSOR)
        add(0x6112, 1, "operating mode", Kind.U8, "ro", 1)
        add(0x6131, 1, "physical unit", Kind.U32, "ro", NEWTON)
        digits = add(0x6132, 1, "decimal digits", Kind.U8, "rw", _DIGITS)
        digits.high = _MOST_DIGITS
        digits.write = lambda value: self._samples.set_decimal_digits(self.cell, value)
        now = self._timers

        def present(read: Callable[[], Value]) -> Callable[[], Value]:
            def sampled() -> Value:
                self._samples.at(now.now_ns)
                return read()

            return sampled

        for index, name, kind, read in (
            (0x6130, "process value, float", Kind.REAL32, self._newton),
            (0x7130, "process value, 16 bit", Kind.I16, self._int16),
            (0x9130, "process value, 32 bit", Kind.I32, self._int32),
            (0x6150, "status", Kind.U8, self._status),
        ):
            entry = add(index, 1, name, kind, "ro", 0)
            entry.mapping = "t"
            entry.read = present(read)
        return objects

    def _newton(self) -> float:
        return float(self._samples.force[self.cell])

    def _int32(self) -> int:
        return self._samples.words[CELL + self.cell]

    def _int16(self) -> int:
        return min(max(self._int32(), -_INT16 - 1), _INT16)

    def _status(self) -> int:
        force = self._newton()
        if force >= self._range:
            return _OVERFLOW
        return _UNDERFLOW if force <= -self._range else 0

    def sample(self, now_ns: int) -> None:
        self._samples.at(now_ns)

    def reader(self, index: int, subindex: int) -> Reader:
        del subindex
        samples, place = self._samples, CELL + self.cell
        if index == 0x9130:
            return lambda: samples.words[place]
        readers: dict[int, Reader] = {
            0x6130: self._newton,
            0x7130: self._int16,
            0x6150: self._status,
        }
        return readers[index]

    def writer(self, index: int, subindex: int) -> Writer:
        del index, subindex
        raise AbortError(READ_ONLY)

    def set_operational(self, operational: bool) -> None:
        """A cell measures in every state."""

    def break_sensor(self, *, broken: bool = True) -> None:
        """The bridge opens: overflow at once, and an emergency."""
        self._samples.break_cell(self.cell, broken=broken)
        register = int(broken)
        self.objects.find(0x1001, 0).value = register
        self.on_error(_SENSOR_ERROR if broken else 0, register)

    def fail(self, code: int) -> None:
        """Raise an error of the bus; a cell goes on measuring."""
        register = self.objects.number(0x1001, 0) | 0x10
        self.objects.find(0x1001, 0).value = register
        self.on_error(code, register)

    def communication_reset(self) -> None:
        """Nothing of a cell's own depends on the bus."""

    def reset(self) -> None:
        self.objects.restore(0x2000, 0xFFFF)
        self._samples.set_decimal_digits(self.cell, self.objects.number(0x6132, 1))
