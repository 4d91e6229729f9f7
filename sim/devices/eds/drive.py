"""An emulated drive with the object dictionary of its EDS.

What a data sheet cannot say is as in CiA 402 and as on the robot's motor: 0x6076 in mN m, 0x6075 in
mA; positions in 0x608F (or 0x6092, where the profile says so) by 0x6091 counts a motor revolution;
speeds and accelerations in positions per s and s2, 0x6080 in rpm. Objects that a drive cannot work
without, and for which the sheet states no value or 0, hold what a drive set up for the motor would:
its data, limits and ramps. Errors are those of `StandardErrors`; the loops of other modes than
cyclic synchronous torque are an EPOS4's.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from tonus.config.schema.axis import Brake, Motor
from tonus.config.schema.lab import PowerStage
from tonus.sim.devices.cia402.drive import Cia402Drive
from tonus.sim.devices.cia402.errors import STANDARD_CODES, StandardErrors
from tonus.sim.devices.cia402.servo import RPM
from tonus.sim.devices.cia402.states import Command
from tonus.sim.devices.device import PdoDefault
from tonus.sim.devices.eds.sheet import Sheet
from tonus.sim.devices.epos4.objects import dictionary
from tonus.sim.devices.objects import Entry, Kind, ObjectDictionary, Value
from tonus.sim.devices.samples import Samples
from tonus.sim.devices.store import connect_store
from tonus.sim.devices.timers import Timers
from tonus.sim.errors import LabError

_STANDARD = range(0x6000, 0x6800)
_RPDO, _RPDO_MAPPING, _TPDO, _TPDO_MAPPING = 0x1400, 0x1600, 0x1800, 0x1A00
_PDO_AREA = range(_RPDO, 0x1C00)
_AREA = 0x200
_COE = frozenset({0x1000, 0x1001, 0x1003, 0x1008, 0x1009, 0x100A, 0x1010, 0x1011, 0x1018})
"""Communication objects that a drive on EtherCAT has too; its slave adds the others."""
_INVALID = 1 << 31
_EVENT = 255
_PREDEFINED = {_RPDO: 0x200, _TPDO: 0x180}
_CST_BIT = 9
_ROUNDING = 1e-6
"""So that a whole number that was computed is not one less."""
_MODES = (0, 1, 3, 6, 8, 9, 10)
_NEEDED = (
    (0x1001, 0, "error register"),
    (0x1018, 1, "vendor-ID"),
    (0x6040, 0, "controlword"),
    (0x6041, 0, "statusword"),
    (0x6060, 0, "modes of operation"),
    (0x6064, 0, "position actual value"),
    (0x6071, 0, "target torque"),
    (0x6077, 0, "torque actual value"),
)
_NEEDED_ON_CAN = (
    (0x1017, 0, "producer heartbeat time"),
    (0x1400, 1, "receive PDO 1, COB-ID"),
    (0x1400, 2, "receive PDO 1, transmission type"),
    (0x1600, 0, "receive PDO 1, mapping"),
    (0x1800, 1, "transmit PDO 1, COB-ID"),
    (0x1800, 2, "transmit PDO 1, transmission type"),
    (0x1A00, 0, "transmit PDO 1, mapping"),
)
_RPM_BASED = ((0x607F, 0), (0x6081, 0), (0x6083, 0), (0x6084, 0), (0x6085, 0), (0x6099, 1),
              (0x6099, 2), (0x609A, 0), (0x30E0, 1))  # fmt: skip
"""Speeds and accelerations, which the core's own table has in rpm and rpm/s."""
_OPTIONS = {0x6007: 1, 0x605A: 2, 0x605B: 0, 0x605C: 1, 0x605E: 2}
"""CiA 402: what an option code is where there is no object for it."""
_FLEETING = frozenset({0x1003, 0x1010, 0x1011, 0x6040, 0x6071, 0x607A, 0x60B0, 0x60B1, 0x60B2,
                       0x60FE, 0x60FF})  # fmt: skip
"""Commands and process data, which saving leaves out."""
_SCALES = ((0x6060, 0), (0x6072, 0), (0x6073, 0), (0x6075, 0), (0x6076, 0), (0x6080, 0),
           (0x608F, 1), (0x608F, 2), (0x6091, 1), (0x6091, 2), (0x6092, 1),
           (0x6092, 2))  # fmt: skip


class EdsDrive(Cia402Drive):
    """A drive for the robot's ``motor``, which has ``sheet``'s objects."""

    def __init__(
        self,
        axis: int,
        sheet: Sheet,
        motor: Motor,
        samples: Samples,
        timers: Timers,
        stage: PowerStage | None = None,
        brake: Brake | None = None,
        *,
        on_can: bool = True,
        feed: bool = False,
    ) -> None:
        """``feed``: positions count in 0x6092 instead of 0x608F. Raises `LabError` for a sheet
        without what an emulated drive needs."""
        for needed in _NEEDED + (_NEEDED_ON_CAN if on_can else ()):
            sheet.need(*needed)
        self.sheet = sheet
        self._motor = motor
        self._counted = 0x6092 if feed else 0x608F
        self._read_pdos(sheet)
        objects, core = _dictionaries(sheet, on_can=on_can)
        usual = dictionary(0)
        self._set_up(core)
        if brake is not None:
            core.find(0x3158, 1).set(round(brake.opening_ms))
            core.find(0x3158, 2).set(round(brake.closing_ms))
        counts = self._counts(core)
        samples.set_resolution(axis, counts)
        per_rpm = counts / 60.0
        for key in _RPM_BASED:
            self._begin(core, key, usual.number(*key) * per_rpm, own=key in objects.entries)
        super().__init__(
            axis,
            objects,
            core,
            samples,
            timers,
            stage,
            StandardErrors(),
            STANDARD_CODES,
            brake,
        )
        self._resolution = counts
        for key in _SCALES:
            if key in objects.entries:
                self._follow(key)
        for key, read in self._measured().items():
            if key in objects.entries:
                objects.find(*key).read = read
        if (0x1010, 1) in objects.entries and (0x1011, 1) in objects.entries:
            connect_store(objects)
        self.reset()

    # -- from the sheet --------------------------------------------------------------------------

    def _read_pdos(self, sheet: Sheet) -> None:
        self.receive_pdos = _pdos(sheet, _RPDO, _RPDO_MAPPING)
        self.transmit_pdos = _pdos(sheet, _TPDO, _TPDO_MAPPING)
        places = [
            sub for index, sub in sheet.entries if _RPDO_MAPPING <= index < _RPDO_MAPPING + _AREA
        ] + [sub for index, sub in sheet.entries if _TPDO_MAPPING <= index < _TPDO_MAPPING + _AREA]
        self.longest_mapping = max(places, default=8) or 8
        self.consumers = sum(index == 0x1016 and sub > 0 for index, sub in sheet.entries)
        self.event_timer = (_TPDO, 5) in sheet.entries
        self.error_behaviour = (0x1029, 1) in sheet.entries

    def _begin(
        self, core: ObjectDictionary, key: tuple[int, int], value: float, *, own: bool
    ) -> None:
        """Give an object the value of a drive that is set up, unless its ``own`` sheet states
        one."""
        entry = core.find(*key)
        if own and key in self.sheet.stated and entry.default:
            return
        low, high = entry.kind.limits
        entry.set(round(min(max(value, low), high)))
        entry.low, entry.high = min(entry.low, entry.number), max(entry.high, entry.number)

    def _set_up(self, core: ObjectDictionary) -> None:
        """The motor's data and what is left open, in the order in which they depend."""
        sheet, motor = self.sheet, self._motor
        for index, code in _OPTIONS.items():
            if (index, 0) not in sheet.entries:
                core.find(index, 0).set(code)
        core.find(0x3001, 1).set(round(motor.nominal_current * 1e3))
        core.find(0x3001, 5).set(round(motor.torque_constant * 1e6))
        rated = {
            (0x6075, 0): motor.nominal_current * 1e3,
            (0x6076, 0): motor.rated_torque * 1e3,
            (0x608F, 1): motor.increments_per_revolution,
            (0x608F, 2): 1,
            (0x6091, 1): 1,
            (0x6091, 2): 1,
        }
        for key, value in rated.items():
            self._fill(core, key, value)
        resolution = _ratio(core, 0x608F) or motor.increments_per_revolution
        self._fill(core, (0x6092, 1), resolution)
        self._fill(core, (0x6092, 2), 1)
        nominal = self._nominal(core)
        for index in (0x6072, 0x6073):
            self._fill(
                core, (index, 0), math.floor(1000 * motor.current_limit / nominal + _ROUNDING)
            )
        self._fill(core, (0x6080, 0), core.find(0x6080, 0).high)
        self._fill(core, (0x60C5, 0), core.find(0x60C5, 0).high)
        self._choose_modes(core)

    def _fill(self, core: ObjectDictionary, key: tuple[int, int], value: float) -> None:
        if key in self.sheet.entries:
            self._begin(core, key, value, own=True)

    def _choose_modes(self, core: ObjectDictionary) -> None:
        mode = core.find(0x6060, 0)
        known: tuple[int, ...] = _MODES
        if (0x6502, 0) in self.sheet.stated:
            bits = core.find(0x6502, 0).number
            if not bits >> _CST_BIT & 1:
                raise LabError(
                    f"{self.sheet.name}: object 0x6502:0: 0x{bits:X} lacks bit {_CST_BIT}, cyclic "
                    "synchronous torque; take a drive that has it"
                )
            known = tuple(m for m in _MODES if not m or bits >> (m - 1) & 1)
        mode.allowed = known

    # -- scales ----------------------------------------------------------------------------------

    def _nominal(self, core: ObjectDictionary) -> float:
        """A, which the rated torque takes."""
        if (0x6076, 0) in self.sheet.entries:
            return core.number(0x6076, 0) * 1e-3 / self._motor.torque_constant
        if (0x6075, 0) in self.sheet.entries:
            return core.number(0x6075, 0) * 1e-3
        return self._motor.nominal_current

    def _counts(self, core: ObjectDictionary) -> float:
        """Of 0x6064 a motor revolution."""
        has = self.sheet.entries
        counted = _ratio(core, self._counted) if (self._counted, 2) in has else 0.0
        gear = _ratio(core, 0x6091) if (0x6091, 2) in has else 0.0
        return (counted or self._motor.increments_per_revolution) / (gear or 1.0)

    def _configure(self) -> None:
        core, servo = self._core, self._output.servo
        nominal = self._nominal(core)
        self._samples.set_nominal_current(self.axis, nominal)
        counts = self._counts(core)
        if counts != self._resolution:
            self._resolution = counts
            self._samples.set_resolution(self.axis, counts)
            self._lose_position()
        servo.per_radian = counts / (2.0 * math.pi)
        servo.velocity_unit = servo.acceleration_unit = 1.0 / servo.per_radian
        servo.motor_speed_unit = RPM
        most = self._motor.current_limit
        for index in (0x6072, 0x6073):
            if (index, 0) in self.sheet.entries:
                most = min(most, core.number(index, 0) * 1e-3 * nominal)
        core.find(0x3001, 2).value = round(most * 1e3)
        self._output.set_scale(nominal * 1e-3)

    def _measured(self) -> dict[tuple[int, int], Callable[[], Value]]:
        axis, samples, timers, output = self.axis, self._samples, self._timers, self._output
        plant, servo, core = samples.plant, output.servo, self._core

        def word(place: int) -> Callable[[], Value]:
            return lambda: samples.at(timers.now_ns).item(place + axis)

        def speed() -> Value:
            plant.advance(timers.now_ns)
            return _fits(float(plant.motor_rate[axis]) / servo.velocity_unit)

        return {
            (0x6061, 0): lambda: core.number(0x6060, 0),
            (0x6062, 0): lambda: _fits(servo.position_demand),
            (0x6063, 0): word(0),
            (0x6064, 0): word(0),
            (0x606B, 0): lambda: _fits(servo.speed_demand),
            (0x606C, 0): speed,
            (0x6074, 0): lambda: output.target + output.offset,
            (0x6077, 0): word(self._samples.torque),
            (0x6078, 0): word(self._samples.torque),
            (0x6079, 0): lambda: round(1e3 * output.guard.supply),
            (0x60F4, 0): lambda: _fits(servo.position_demand - servo.position),
        }

    # -- stops -----------------------------------------------------------------------------------

    def fail(self, code: int) -> None:
        """Raises KeyError for a number that is no error code."""
        option = self._core.number(0x6007, 0)
        if self.errors[code].reaction != "A" or option == 1:
            super().fail(code)
            return
        register = self._errors.push(code)
        self._errors.clear()
        if option == 2:
            self._machine.obey(Command.DISABLE_VOLTAGE)
        elif option == 3:
            self._machine.obey(Command.QUICK_STOP)
        self._done = None
        self._show()
        self.on_error(code, register)


def _ratio(core: ObjectDictionary, index: int) -> float:
    """Subindex 1 over 2; 0 where it is not known."""
    below = core.entries.get((index, 2))
    if below is None or not below.number:
        return 0.0
    return core.number(index, 1) / below.number


def _fits(value: float) -> int:
    low, high = Kind.I32.limits
    return int(min(max(round(value), low), high))


def _dictionaries(sheet: Sheet, *, on_can: bool) -> tuple[ObjectDictionary, ObjectDictionary]:
    """What masters see, and what the core reads: its own table with the sheet's entries in it."""
    objects, core = ObjectDictionary(), dictionary(0)
    objects.names |= sheet.names
    if (0x1003, 0) in sheet.entries:
        for key in [key for key in core.entries if key[0] == 0x1003]:
            del core.entries[key]
    for key in sorted(sheet.entries):
        index, entry = key[0], sheet.entries[key]
        if index in _PDO_AREA or (not on_can and index < 0x2000 and index not in _COE):
            continue
        entry.lasting = index not in _FLEETING
        objects.add(*key, entry)
        if index in (0x1001, 0x1003) or index in _STANDARD:
            core.entries[key] = entry
    if not on_can:
        for subindex, name in enumerate(("Product code", "Revision number", "Serial number"), 2):
            if (0x1018, subindex) not in objects.entries:
                objects.add(0x1018, subindex, Entry(name, Kind.U32, "ro", 0))
    return objects, core


def _pdos(sheet: Sheet, parameters: int, mapping: int) -> tuple[PdoDefault, ...]:
    """A device's PDOs as they begin; on EtherCAT only their mappings count."""
    entries = sheet.entries
    numbers = sorted({index - mapping for index, _ in entries if 0 <= index - mapping < _AREA})
    if numbers != list(range(len(numbers))):
        gap = next(place for place, number in enumerate(numbers) if place != number)
        raise LabError(
            f"{sheet.name}: has no object 0x{mapping + gap:04X}, though PDOs behind it; number "
            "them without a gap"
        )
    found = []
    for number in numbers or [0]:
        base = _PREDEFINED[parameters] + 0x100 * number
        cob = entries.get((parameters + number, 1))
        kind = entries.get((parameters + number, 2))
        count = entries.get((mapping + number, 0))
        words = (
            entries.get((mapping + number, place))
            for place in range(1, (count.number if count is not None else 0) + 1)
        )
        stated = cob is not None and (parameters + number, 1) in sheet.stated
        found.append(
            PdoDefault(
                cob.number - sheet.node_id if cob is not None and stated else base | _INVALID,
                kind.number if kind is not None and kind.number else _EVENT,
                tuple(word.number for word in words if word is not None and word.number),
            )
        )
    return tuple(found)
