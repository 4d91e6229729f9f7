"""An emulated CiA 404 amplifier of force cells: channels in newtons, as float and as integers.

A channel's low-pass is the plant's; its noise, range and scaling are the samples'; here are its
objects. A field value is the bridge's signal in mV/V (as integer uV/V); two points scale it to the
process value. Integer process values carry 0x6132 decimal digits.
"""

from __future__ import annotations

from collections.abc import Callable

from tonus.config.schema.lab import CellNoise
from tonus.sim.devices.device import ErrorSink, PdoDefault, Reader, Writer
from tonus.sim.devices.objects import (
    INCOMPATIBLE,
    RANGE,
    READ_ONLY,
    WRONG_STATE,
    AbortError,
    Entry,
    Kind,
    ObjectDictionary,
    Value,
)
from tonus.sim.devices.samples import Samples
from tonus.sim.devices.store import connect_store
from tonus.sim.devices.timers import Timers

DEVICE_TYPE = 0x00020194
VENDOR = 0x0000FFFF
PRODUCT = 0x00000404
REVISION = 0x00000001
NEWTON = 0x00210000
"""CiA 303-2"""
FORCE_SENSOR = 0x005A
ZERO = 0x6F72657A
"""What starts an autozero."""
BUSY, DONE, FAILED = 0x75, 0x66, 0x7265
"""0x2004: u, f, er"""
_ZERO_NS = 8_000_000
_ZERO_READINGS = 8
_DIGITS = 2
_MOST_DIGITS = 6
_SENSITIVITY = 2.0
"""mV/V at the end of the range"""
_MICRO = 1000.0
_LARGEST = 1e9
_LEAST = 1e-3
"""How far apart two points of calibration must be."""
_INT16 = 0x7FFF
_CONVERSION_US = 1000
_BIT_RATE = 7
"""0x2100: 1 Mbit/s"""
_SENSOR_ERROR = 0x5010
"""CiA 404: an open or broken sensor; error register bit 0."""
_BUS_ERROR = 0x10
_VALID_NO_REMOTE = 0x40000000
_EVENT = 255
_POINTS = ((0, "field value 1"), (1, "process value 1"), (2, "field value 2"))
_SCALING = (*_POINTS, (3, "process value 2"), (4, "offset"))


def _no_sink(code: int, register: int) -> None:
    del code, register


class Channel:
    """One cell behind its amplifier; the float forms of its settings hold them."""

    def __init__(self, cell: int, samples: Samples, timers: Timers) -> None:
        self.cell = cell
        self.zeroing = 0
        """0x2004"""
        self.settings: list[Entry] = []
        """0x6120 to 0x6124"""
        self._samples = samples
        self._timers = timers
        self._readings: list[float] = []

    # -- process value ---------------------------------------------------------------------------

    def newton(self) -> float:
        return float(self._samples.force[self.cell])

    def int32(self) -> int:
        return self._samples.values.item(self._samples.cell + self.cell)

    def int16(self) -> int:
        return min(max(self.int32(), -_INT16 - 1), _INT16)

    def status(self) -> int:
        """0, or why the process value is not valid."""
        return self._samples.values.item(self._samples.validity + self.cell)

    # -- scaling ---------------------------------------------------------------------------------

    def _numbers(self) -> list[float]:
        return [float(entry.value) for entry in self.settings]

    def scale(self) -> None:
        """Tell the samples what the settings make of a force."""
        field_1, process_1, field_2, process_2, offset = self._numbers()
        slope = (process_2 - process_1) / (field_2 - field_1)
        nominal = self.settings[3].default
        assert isinstance(nominal, float)
        gain = slope * _SENSITIVITY / nominal
        self._samples.set_scaling(self.cell, gain, process_1 - slope * field_1 + offset)

    def change(self, place: int, value: float) -> None:
        """Set one of the settings. Raises `AbortError`."""
        numbers = self._numbers()
        numbers[place] = value
        if abs(numbers[2] - numbers[0]) < _LEAST or abs(numbers[3] - numbers[1]) < _LEAST:
            raise AbortError(INCOMPATIBLE)
        self.settings[place].value = value
        self.scale()

    # -- autozero --------------------------------------------------------------------------------

    def zero(self, value: int) -> None:
        """0x6125. Raises `AbortError`."""
        if value != ZERO:
            raise AbortError(RANGE)
        if self.zeroing == BUSY:
            raise AbortError(WRONG_STATE)
        self.zeroing = BUSY
        self._readings = []
        self._again(self._timers.now_ns)

    def _again(self, now_ns: int) -> None:
        self._timers.call_at(now_ns + _ZERO_NS // _ZERO_READINGS, self._read)

    def _read(self, now_ns: int) -> None:
        if self.zeroing != BUSY:
            return
        self._samples.at(now_ns)
        self._readings.append(self.newton())
        if self.status():
            self.zeroing = FAILED
        elif len(self._readings) < _ZERO_READINGS:
            self._again(now_ns)
        else:
            mean = sum(self._readings) / _ZERO_READINGS
            self.change(4, self._numbers()[4] - mean)
            self.zeroing = DONE


class ForceCell:
    """The amplifier of one or more of the cells; subindex n is that of ``cells[n-1]``."""

    axis: int | None = None
    receive_pdos: tuple[PdoDefault, ...] = ()
    longest_mapping = 4
    consumers = 1
    event_timer = True
    error_behaviour = True

    def __init__(
        self,
        cells: tuple[int, ...],
        node_id: int,
        samples: Samples,
        noise: CellNoise,
        timers: Timers,
    ) -> None:
        self.cells = cells
        self.on_error: ErrorSink = _no_sink
        self._samples = samples
        self._range = noise.range
        self._timers = timers
        self.channels = [Channel(cell, samples, timers) for cell in cells]
        words = tuple(0x71300010 | n << 8 for n in range(1, len(cells) + 1))
        if len(cells) == 1:
            words = (0x91300120,)
        self.transmit_pdos = (PdoDefault(_VALID_NO_REMOTE | 0x180, _EVENT, words),)
        self.objects = self._dictionary(node_id)
        self.reset()

    # -- objects ---------------------------------------------------------------------------------

    def _dictionary(self, node_id: int) -> ObjectDictionary:
        objects = ObjectDictionary()
        add = objects.add
        add(0x1000, 0, Entry("Device type", Kind.U32, "ro", DEVICE_TYPE))
        add(0x1001, 0, Entry("Error register", Kind.U8, "ro", 0))
        add(0x1008, 0, Entry("Device name", Kind.STRING, "const", "force cell"))
        objects.names |= {
            0x1010: "Store parameters",
            0x1011: "Restore default parameters",
            0x1018: "Identity object",
            0x2004: "Autozero status",
        }
        add(0x1010, 1, Entry("Save all parameters", Kind.U32, "rw", 1))
        add(0x1011, 1, Entry("Restore all default parameters", Kind.U32, "rw", 1))
        connect_store(objects)
        add(0x1018, 1, Entry("Vendor-ID", Kind.U32, "ro", VENDOR))
        add(0x1018, 2, Entry("Product code", Kind.U32, "ro", PRODUCT))
        add(0x1018, 3, Entry("Revision number", Kind.U32, "ro", REVISION))
        add(0x1018, 4, Entry("Serial number", Kind.U32, "ro", node_id))
        rate = add(0x2100, 0, Entry("Bit rate", Kind.U8, "rw", _BIT_RATE))
        rate.allowed = tuple(range(8))
        for number, channel in enumerate(self.channels, start=1):
            self._add_channel(objects, number, channel)
        return objects

    def _add_channel(self, objects: ObjectDictionary, n: int, channel: Channel) -> None:
        def add(index: int, name: str, kind: Kind, access: str, value: Value) -> Entry:
            objects.names.setdefault(index, f"AI {name}")
            return objects.add(index, n, Entry(f"AI {name} {n}", kind, access, value))

        def present(read: Callable[[], Value]) -> Callable[[], Value]:
            def sampled() -> Value:
                self._samples.at(self._timers.now_ns)
                return read()

            return sampled

        zeroing = add(0x2004, "autozero status", Kind.U16, "ro", 0)
        zeroing.read = lambda: channel.zeroing
        add(0x6110, "sensor type", Kind.U16, "ro", FORCE_SENSOR)
        add(0x6112, "operating mode", Kind.U8, "rw", 1).allowed = (1,)
        add(0x6114, "ADC sample rate", Kind.U32, "ro", _CONVERSION_US)
        defaults = (0.0, 0.0, _SENSITIVITY, self._range, 0.0)
        for place, name in _SCALING:
            entry = add(0x6120 + place, name, Kind.REAL32, "rw", defaults[place])
            entry.low, entry.high = -_LARGEST, _LARGEST
            entry.write = self._changes(channel, place)
            channel.settings.append(entry)
        add(0x6125, "autozero", Kind.U32, "wo", 0).write = channel.zero
        add(0x6131, "physical unit", Kind.U32, "ro", NEWTON)
        digits = add(0x6132, "decimal digits", Kind.U8, "rw", _DIGITS)
        digits.high = _MOST_DIGITS
        digits.write = lambda value: self._samples.set_decimal_digits(channel.cell, value)
        for base, kind in ((0x7000, Kind.I16), (0x9000, Kind.I32)):
            for place, name in _SCALING:
                entry = add(base + 0x120 + place, name, kind, "rw", 0)
                self._add_integer(entry, channel, place, digits)
            add(base + 0x125, "autozero", Kind.U32, "wo", 0).write = channel.zero
        for index, name, kind, read in (
            (0x6130, "process value", Kind.REAL32, channel.newton),
            (0x7130, "process value", Kind.I16, channel.int16),
            (0x9130, "process value", Kind.I32, channel.int32),
            (0x6150, "status", Kind.U8, channel.status),
        ):
            entry = add(index, name, kind, "ro", 0)
            entry.mapping = "t"
            entry.read = present(read)

    def _changes(self, channel: Channel, place: int) -> Writer:
        return lambda value: channel.change(place, value)

    def _add_integer(self, entry: Entry, channel: Channel, place: int, digits: Entry) -> None:
        """The integer form of a setting: another view of the float one."""

        def scale() -> float:
            if place in (0, 2):
                return _MICRO
            return float(10**digits.number)

        def read() -> Value:
            low, high = entry.kind.limits
            return int(min(max(round(float(channel.settings[place].value) * scale()), low), high))

        entry.read = read
        entry.write = lambda value: channel.change(place, value / scale())
        entry.lasting = False
        entry.set(read())

    # -- process data ----------------------------------------------------------------------------

    def sample(self, now_ns: int) -> None:
        self._samples.at(now_ns)

    def reader(self, index: int, subindex: int) -> Reader:
        channel = self.channels[subindex - 1]
        if index == 0x9130:
            samples = self._samples
            place = samples.cell + channel.cell
            return lambda: samples.values.item(place)
        readers: dict[int, Reader] = {
            0x6130: channel.newton,
            0x7130: channel.int16,
            0x6150: channel.status,
        }
        return readers[index]

    def place(self, index: int, subindex: int) -> int | None:
        """Where in `Samples.values` a process value stands; None: nowhere."""
        samples = self._samples
        firsts = {0x9130: samples.cell, 0x6150: samples.validity}
        return firsts[index] + self.channels[subindex - 1].cell if index in firsts else None

    def writer(self, index: int, subindex: int) -> Writer:
        del index, subindex
        raise AbortError(READ_ONLY)

    def received(self, now_ns: int) -> None:
        """No process data reach a cell."""

    # -- state -----------------------------------------------------------------------------------

    def set_operational(self, operational: bool) -> None:
        """A cell measures in every state."""

    def break_sensor(self, *, broken: bool = True) -> None:
        """The bridges open: overflow at once, and an emergency."""
        for cell in self.cells:
            self._samples.break_cell(cell, broken=broken)
        register = int(broken)
        self.objects.find(0x1001, 0).value = register
        self.on_error(_SENSOR_ERROR if broken else 0, register)

    def fail(self, code: int) -> None:
        """Raise an error of the bus; a cell goes on measuring."""
        register = self.objects.number(0x1001, 0) | _BUS_ERROR
        self.objects.find(0x1001, 0).value = register
        self.on_error(code, register)

    def communication_reset(self) -> None:
        """Nothing of a cell's own depends on the bus."""

    def reset(self) -> None:
        """The stored parameters are loaded; an autozero that ran is forgotten."""
        self.objects.restore(0x2000, 0xFFFF)
        for number, channel in enumerate(self.channels, start=1):
            channel.zeroing = 0
            channel.scale()
            self._samples.set_decimal_digits(channel.cell, self.objects.number(0x6132, number))

    def power_cycle(self) -> None:
        """The supply goes and comes back."""
        self.objects.restore(0x1000, 0x1FFF)
        self.reset()
