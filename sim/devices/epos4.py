"""An emulated EPOS4 Compact 50/8 as a device without a bus.

Cyclic synchronous torque: the target torque (0x6071 plus 0x60B2, per mille of the rated torque)
becomes a current reference within 0x3001:2; the current loop itself is the plant's. Modes that the
robot does not use can be chosen, but hold the motor at standstill.
"""

from __future__ import annotations

from collections.abc import Callable
from math import pi

from sim.devices.brake_ramp import BrakeRamp
from sim.devices.cia402 import POWERED, Machine, State
from sim.devices.device import ErrorSink, PdoDefault, Reader, Writer
from sim.devices.epos4_errors import ERRORS, NEEDS_COMMUNICATION_RESET
from sim.devices.epos4_objects import (
    CYCLIC_SYNCHRONOUS_TORQUE,
    POWER_OFF_ONLY,
    dictionary,
)
from sim.devices.error_memory import ErrorMemory
from sim.devices.objects import CANNOT_STORE, WRONG_STATE, AbortError, Entry, Value
from sim.devices.samples import POSITION, TORQUE, Samples
from sim.devices.timers import Timers

VOLTAGE_ENABLED = 0x0010
WARNING = 0x0080
REMOTE = 0x0200
INTERNAL_LIMIT = 0x0800
FOLLOWS_COMMAND = 0x1000
_SAVE = 0x65766173
_LOAD = 0x64616F6C
_VALID_NO_REMOTE = 0x40000000
_DISABLED = 0xC0000000
_BUS_OBJECTS = 0x1FFF
_RPM = pi / 30.0
_QUICK_STOP = 3
_LIFE = 255


def _no_sink(code: int, register: int) -> None:
    del code, register


class Epos4:
    """One drive on one axis of the plant."""

    receive_pdos: tuple[PdoDefault, ...] = (
        PdoDefault(0x200, _LIFE, (0x60400010,)),
        PdoDefault(0x300, _LIFE, (0x60400010, 0x60600008)),
        PdoDefault(0x400, _LIFE, (0x60400010, 0x607A0020)),
        PdoDefault(0x500, _LIFE, (0x60400010, 0x60FF0020)),
    )
    transmit_pdos: tuple[PdoDefault, ...] = (
        PdoDefault(_VALID_NO_REMOTE | 0x180, _LIFE, (0x60410010,)),
        PdoDefault(_DISABLED | 0x280, _LIFE, (0x60410010, 0x60610008)),
        PdoDefault(_DISABLED | 0x380, _LIFE, (0x60410010, 0x60640020)),
        PdoDefault(_DISABLED | 0x480, _LIFE, (0x60410010, 0x606C0020)),
    )
    longest_mapping = 12
    consumers = 2

    def __init__(self, axis: int, node_id: int, samples: Samples, timers: Timers) -> None:
        self.axis = axis
        self.objects = dictionary(node_id)
        self.on_error: ErrorSink = _no_sink
        self._statusword = VOLTAGE_ENABLED
        self._samples = samples
        self._plant = samples.plant
        self._timers = timers
        self._machine = Machine(self)
        self._ramp = BrakeRamp(axis, self.objects, samples.plant, timers, self._standstill)
        self._errors = ErrorMemory(self.objects)
        self._operational = False
        self._driving = False
        self._limited = False
        self._warning = False
        self._target = 0
        self._offset = 0
        self._done: tuple[int, State] | None = None  # what changes nothing if it comes again
        self._controlword = 0
        self._blocked: set[int] = set()
        self._factory = {key: entry.default for key, entry in self.objects.entries.items()}
        self._connect()
        self.reset()

    # -- objects ---------------------------------------------------------------------------------

    def _connect(self) -> None:
        find = self.objects.find
        axis, samples = self.axis, self._samples
        words = samples.at
        now = self._timers
        reads: dict[tuple[int, int], Callable[[], Value]] = {
            (0x6041, 0): self.statusword,
            (0x6064, 0): lambda: words(now.now_ns)[POSITION + axis],
            (0x60E4, 1): lambda: words(now.now_ns)[POSITION + axis],
            (0x6077, 0): lambda: words(now.now_ns)[TORQUE + axis],
            (0x30D2, 1): lambda: words(now.now_ns)[TORQUE + axis],
            (0x30D0, 0): lambda: round(1e3 * float(self._plant.current_reference[axis])),
            (0x30D1, 1): self._milliampere,
            (0x30D1, 2): self._milliampere,
            (0x606C, 0): self._speed_rpm,
            (0x30D3, 1): self._speed_rpm,
            (0x3000, 5): lambda: 4 * self.objects.number(0x3010, 1),
            (0x6061, 0): lambda: self.objects.number(0x6060, 0),
            (0x6040, 0): lambda: self._controlword,
            (0x6071, 0): lambda: self._target,
            (0x60B2, 0): lambda: self._offset,
            (0x6076, 0): self._rated_torque,
        }
        for key, read in reads.items():
            find(*key).read = read
        writes: dict[tuple[int, int], Writer] = {
            (0x6040, 0): self.controlword,
            (0x6071, 0): self.target_torque,
            (0x60B2, 0): self._set_offset,
            (0x6060, 0): lambda value: self._later(find(0x6060, 0), value),
            (0x3001, 1): lambda value: self._later(find(0x3001, 1), value),
            (0x3001, 2): lambda value: self._later(find(0x3001, 2), value),
            (0x3001, 5): lambda value: self._later(find(0x3001, 5), value),
            (0x1010, 1): self._store,
            (0x1011, 1): self._restore,
        }
        for key, write in writes.items():
            find(*key).write = write
        for key in POWER_OFF_ONLY:
            find(*key).write = self._only_without_power

    def _later(self, entry: Entry, value: int) -> None:
        """Store now, so that what depends on the value can be computed from it."""
        entry.value = value
        self._configure()

    def _configure(self) -> None:
        number = self.objects.number
        nominal = number(0x3001, 1) * 1e-3
        self._samples.set_nominal_current(self.axis, nominal)
        # Torque is relative to the rated torque; without a torque constant there is none.
        self._per_mille = nominal * 1e-3 if self._rated_torque() else 0.0
        self._limit = number(0x3001, 2) * 1e-3
        if self.enabled:
            self.power(on=True)

    def _rated_torque(self) -> int:
        return round(self.objects.number(0x3001, 1) * self.objects.number(0x3001, 5) / 1000)

    def _milliampere(self) -> int:
        self._plant.advance(self._timers.now_ns)
        return round(1e3 * float(self._plant.current[self.axis]))

    def _speed_rpm(self) -> int:
        self._plant.advance(self._timers.now_ns)
        return round(float(self._plant.motor_rate[self.axis]) / _RPM)

    def _only_without_power(self, value: int) -> None:
        del value
        if self._machine.state in POWERED:
            raise AbortError(WRONG_STATE)

    def _store(self, value: int) -> None:
        if value != _SAVE:
            raise AbortError(CANNOT_STORE)
        for entry in self.objects.entries.values():
            if entry.access == "rw" and entry.read is None:
                entry.default = entry.value
        self.objects.find(0x1010, 1).default = 1

    def _restore(self, value: int) -> None:
        """Takes effect with the next reset."""
        if value != _LOAD:
            raise AbortError(CANNOT_STORE)
        for key, default in self._factory.items():
            self.objects.entries[key].default = default

    # -- process data ----------------------------------------------------------------------------

    def sample(self, now_ns: int) -> None:
        self._samples.at(now_ns)

    def reader(self, index: int, subindex: int) -> Reader:
        samples, axis = self._samples, self.axis
        if index == 0x6041:
            return self.statusword
        if index in (0x6064, 0x60E4):
            return lambda: samples.words[POSITION + axis]
        if index in (0x6077, 0x30D2):
            return lambda: samples.words[TORQUE + axis]
        get = self.objects.find(index, subindex).get

        def number() -> float:
            value = get()
            assert not isinstance(value, str)
            return value

        return number

    def writer(self, index: int, subindex: int) -> Writer:
        if index == 0x6040:
            return self.controlword
        if index == 0x6071:
            return self.target_torque
        entry = self.objects.find(index, subindex)

        def write(value: int) -> None:
            # A PDO cannot be refused: what an SDO would abort has no effect.
            if entry.low <= value <= entry.high and (not entry.allowed or value in entry.allowed):
                if entry.write is not None:
                    entry.write(value)
                entry.value = value

        return write

    def controlword(self, word: int) -> None:
        state = self._machine.state
        if (word, state) == self._done:
            return
        self._controlword = word
        self._machine.controlword(word)
        self._done = (word, state) if self._machine.state is state else None
        self._show()

    def target_torque(self, mille: int) -> None:
        if mille != self._target:
            self._target = mille
            if self._driving:
                self._drive()

    def _set_offset(self, mille: int) -> None:
        self._offset = mille
        if self._driving:
            self._drive()

    def _drive(self) -> None:
        current = (self._target + self._offset) * self._per_mille
        limited = not -self._limit <= current <= self._limit
        if limited:
            current = min(max(current, -self._limit), self._limit)
        if limited is not self._limited:
            self._limited = limited
            self._show()
        plant = self._plant
        plant.advance(self._timers.now_ns)
        plant.current_reference[self.axis] = current

    # -- state -----------------------------------------------------------------------------------

    @property
    def state(self) -> State:
        return self._machine.state

    @property
    def enabled(self) -> bool:
        return self._machine.state is State.OPERATION_ENABLED

    def statusword(self) -> int:
        """0x6041 as it stands now."""
        return self._statusword

    def _show(self) -> None:
        word = self._machine.state | VOLTAGE_ENABLED
        if self._operational:
            word |= REMOTE
        if self._warning:
            word |= WARNING
        if self._driving:
            word |= FOLLOWS_COMMAND
            if self._limited:
                word |= INTERNAL_LIMIT
        # Bit 5 of switch-on disabled and fault is open; ours is 0 as in the maker's default.
        self._statusword = word

    def power(self, on: bool) -> None:
        """Power stage on, in the chosen mode, or off."""
        plant, axis = self._plant, self.axis
        self._ramp.stop()
        self._driving = on and self.objects.number(0x6060, 0) == CYCLIC_SYNCHRONOUS_TORQUE
        if on or plant.powered[axis]:
            plant.advance(self._timers.now_ns)
        plant.powered[axis] = on
        if self._driving:
            self._drive()
        elif on:
            self._ramp.start(self._limit)
        else:
            plant.current_reference[axis] = 0.0
            self._limited = False

    def ramp_down(self, then: State) -> None:
        del then
        self._driving = False
        self._plant.advance(self._timers.now_ns)
        self._ramp.start(self._limit)

    def _standstill(self) -> None:
        self._machine.ramp_ended()
        self._show()

    def shutdown_ramp(self) -> bool:
        return self.objects.number(0x605B, 0) == 1

    def disable_ramp(self) -> bool:
        return self.objects.number(0x605C, 0) == 1

    def resettable(self) -> bool:
        return not self._blocked

    def fault_cleared(self) -> None:
        self._errors.clear()
        self.on_error(0, 0)

    def fail(self, code: int) -> None:
        """Raises KeyError for a code that an EPOS4 does not have."""
        error = ERRORS[code]
        warning = error.reaction == "W"
        register = self._errors.push(code, error.register, warning=warning)
        if warning:
            self._warning = True
        else:
            if code in NEEDS_COMMUNICATION_RESET:
                self._blocked.add(code)
            self._machine.fault(ramp=self._brakes(error.reaction))
        self._done = None
        self._show()
        self.on_error(code, register)

    def _brakes(self, reaction: str) -> bool:
        if reaction == "A":
            return self.objects.number(0x6007, 0) == _QUICK_STOP
        return reaction == "F" and self.objects.number(0x605E, 0) != 0

    def set_operational(self, operational: bool) -> None:
        self._operational = operational
        self._show()

    def communication_reset(self) -> None:
        self._blocked.clear()

    def reset(self) -> None:
        self._blocked.clear()
        self._warning = False
        self._done = None
        self._target = self._offset = self._controlword = 0
        self._machine.start()
        self.objects.restore(_BUS_OBJECTS + 1, 0xFFFF)
        self._errors.clear()
        self._samples.zero_position(self.axis)
        self._configure()
        self._show()
