"""An emulated EPOS4 Compact 50/8 as a device without a bus.

Cyclic synchronous torque: the target torque (0x6071 plus 0x60B2, per mille of the rated torque)
becomes a current reference within what may flow; the current loop itself is the plant's. In all
other modes the drive's own loops move the motor (`sim.devices.motion`). The speed is the encoder's
true one, whatever 0x3010:1 says.
"""

from __future__ import annotations

from config.schema.lab import PowerStage
from sim.devices.cia402 import POWERED, Command, Machine, State
from sim.devices.device import ErrorSink, PdoDefault, Reader, Writer
from sim.devices.epos4_errors import (
    ERRORS,
    NEGATIVE_LIMIT,
    PDO_TIMEOUT,
    POSITIVE_LIMIT,
    TORQUE_OFF,
    Recovery,
)
from sim.devices.epos4_objects import POWER_OFF_ONLY, SENSORS, dictionary
from sim.devices.epos4_values import connect, scale_speeds
from sim.devices.error_memory import ErrorMemory
from sim.devices.guard import Guard
from sim.devices.holding_brake import HoldingBrake
from sim.devices.homing import Homing
from sim.devices.modes import CyclicPosition, CyclicVelocity, ProfilePosition, ProfileVelocity
from sim.devices.motion import FOLLOWS_COMMAND, Braking, Motion, Task
from sim.devices.objects import CANNOT_STORE, WRONG_STATE, AbortError
from sim.devices.samples import POSITION, TORQUE, Samples
from sim.devices.servo import RPM, Servo
from sim.devices.terminals import Function, Terminals
from sim.devices.timers import Timers

VOLTAGE_ENABLED = 0x0010
WARNING = 0x0080
REMOTE = 0x0200
INTERNAL_LIMIT = 0x0800
REFERENCED = 0x8000
PROFILE_POSITION, PROFILE_VELOCITY, HOMING, CYCLIC_POSITION, CYCLIC_VELOCITY, CYCLIC_TORQUE = (
    1,
    3,
    6,
    8,
    9,
    10,
)
_CYCLIC = (CYCLIC_POSITION, CYCLIC_VELOCITY, CYCLIC_TORQUE)
_SAVE = 0x65766173
_LOAD = 0x64616F6C
_VALID_NO_REMOTE = 0x40000000
_DISABLED = 0xC0000000
_BUS_OBJECTS = (0x1000, 0x1FFF)
_OWN_OBJECTS = (0x2000, 0xFFFF)
_QUICK_STOP_RAMP = 0x6085
_PROFILE_RAMP = 0x6084
_QUICK_STOP = 3
_LIFE = 255
_MISSING = 2
"""Periods of 0x60C2 without a PDO that are a time-out: one PDO did not come."""
_MS_NS = 1_000_000
_STO_RELEASED = 3
"""0x3202: both channels have voltage"""


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

    def __init__(
        self,
        axis: int,
        node_id: int,
        samples: Samples,
        timers: Timers,
        stage: PowerStage | None = None,
        *,
        holding_brake: bool = False,
    ) -> None:
        self.axis = axis
        self.objects = objects = dictionary(node_id)
        self.on_error: ErrorSink = _no_sink
        stage = stage or PowerStage()
        plant = samples.plant
        self._samples = samples
        self._plant = plant
        self._timers = timers
        self._machine = Machine(self)
        self._servo = servo = Servo(axis, objects, samples)
        self._motion = Motion(servo, plant, timers, self._show)
        self._braking = Braking(servo, self._standstill)
        self._terminals = Terminals(objects)
        self._guard = Guard(axis, servo, plant, timers, stage, self.fail, self._allowed)
        self._brake = HoldingBrake(axis, objects, plant, timers, fitted=holding_brake)
        self._errors = ErrorMemory(objects, self._show)
        position = CyclicPosition(servo, self.fail, self._ampere)
        velocity = CyclicVelocity(servo, self._ampere)
        self._lines = (position.interpolation, velocity.interpolation)
        self._tasks: dict[int, Task] = {
            PROFILE_POSITION: ProfilePosition(servo, self.fail),
            PROFILE_VELOCITY: ProfileVelocity(servo),
            HOMING: Homing(servo, self._terminals, self._referenced),
            CYCLIC_POSITION: position,
            CYCLIC_VELOCITY: velocity,
        }
        self._statusword = VOLTAGE_ENABLED
        self._operational = False
        self._driving = False
        self._limited = False
        self._reference = False
        self._torque_off = False
        self._target = 0
        self._offset = 0
        self._per_mille = 0.0
        self._low = self._high = 0.0
        self._done: tuple[int, State] | None = None  # what changes nothing if it comes again
        self._controlword = 0
        self._interval_ns = 0
        self._heard_ns = 0
        self._expecting = False
        self._fault_ramp = _QUICK_STOP_RAMP
        self._mode = objects.find(0x6060, 0)
        self._connect()
        self.reset()

    # -- objects ---------------------------------------------------------------------------------

    def _connect(self) -> None:
        find = self.objects.find
        connect(self.axis, self.objects, self._samples, self._timers, self._servo, self._guard)
        find(0x6041, 0).read = self.statusword
        find(0x6040, 0).read = lambda: self._controlword
        find(0x6071, 0).read = lambda: self._target
        find(0x60B2, 0).read = lambda: self._offset
        find(0x3202, 1).read = lambda: 0 if self._torque_off else _STO_RELEASED
        writes: dict[tuple[int, int], Writer] = {
            (0x6040, 0): self.controlword,
            (0x6071, 0): self.target_torque,
            (0x60B2, 0): self._set_offset,
            (0x1010, 1): self._store,
            (0x1011, 1): self._restore,
            (0x1011, 4): self._restore,
        }
        for key, write in writes.items():
            find(*key).write = write
        for key in ((0x6060, 0), (0x3001, 1), (0x3001, 2), (0x3001, 5), (0x6080, 0), (0x60C2, 1)):
            self._follow(key)
        for key in POWER_OFF_ONLY:
            self._guarded(key)
        for key in ((0x1010, 1), (0x1011, 1), (0x1011, 4)):
            find(*key).read = lambda: 1

    def _follow(self, key: tuple[int, int]) -> None:
        """Take the value over now, so that what depends on it can be computed from it."""
        entry = self.objects.find(*key)

        def write(value: int) -> None:
            changed, entry.value = entry.value != value, value
            self._configure()
            if changed and entry is self._mode and self.enabled:
                self._begin()

        entry.write = write

    def _guarded(self, key: tuple[int, int]) -> None:
        entry = self.objects.find(*key)

        def write(value: int) -> None:
            if self._machine.state in POWERED:
                raise AbortError(WRONG_STATE)
            entry.value = value
            if key[0] in SENSORS:
                self._lose_position()
            self._configure()

        entry.write = write

    def _configure(self) -> None:
        number = self.objects.number
        nominal = number(0x3001, 1) * 1e-3
        self._samples.set_nominal_current(self.axis, nominal)
        # Torque is relative to the rated torque; without a torque constant there is none.
        self._per_mille = nominal * 1e-3 if number(0x6076, 0) else 0.0
        self._interval_ns = number(0x60C2, 1) * _MS_NS
        self._servo.velocity_unit = RPM * scale_speeds(self.objects)
        self._guard.limit()
        if self._driving:
            self._drive()

    def _store(self, value: int) -> None:
        if value != _SAVE:
            raise AbortError(CANNOT_STORE)
        self.objects.save()

    def _restore(self, value: int) -> None:
        """Takes effect with the next reset."""
        if value != _LOAD:
            raise AbortError(CANNOT_STORE)
        self.objects.forget()

    # -- process data ----------------------------------------------------------------------------

    def sample(self, now_ns: int) -> None:
        self._samples.at(now_ns)

    def reader(self, index: int, subindex: int) -> Reader:
        samples, axis = self._samples, self.axis
        if index == 0x6041:
            return self.statusword
        if index == 0x6064:
            return lambda: samples.words[POSITION + axis]
        if index == 0x6077:
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
            if entry.takes(value):
                if entry.write is not None:
                    entry.write(value)
                entry.value = value

        return write

    def received(self, now_ns: int) -> None:
        """A receive PDO has been applied."""
        if not self._interval_ns:
            return
        self._heard_ns = now_ns
        for line in self._lines:
            line.received()
        if not self._expecting and self.enabled:
            self._expecting = True
            self._timers.call_at(now_ns + _MISSING * self._interval_ns, self._overdue)

    def _overdue(self, now_ns: int) -> None:
        """0x60C2: the next PDO is due a period after the last."""
        due_ns = self._heard_ns + _MISSING * self._interval_ns
        self._expecting = False
        if not (self._interval_ns and self.enabled and self._mode.value in _CYCLIC):
            return
        if now_ns >= due_ns:
            self.fail(PDO_TIMEOUT)
        else:
            self._expecting = True
            self._timers.call_at(due_ns, self._overdue)

    def controlword(self, word: int) -> None:
        state = self._machine.state
        if (word, state) == self._done:
            return
        self._controlword = word
        self._machine.controlword(word)
        task = self._motion.task
        if self.enabled and task is not None:
            task.controlword(word)
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

    def _ampere(self, mille: int) -> float:
        return mille * self._per_mille

    def _allowed(self) -> None:
        """Other currents are allowed from now on."""
        self._low, self._high = self._guard.low, self._guard.high
        if self._driving:
            self._drive()

    def _drive(self) -> None:
        current = (self._target + self._offset) * self._per_mille
        limited = not self._low <= current <= self._high
        if limited:
            current = min(max(current, self._low), self._high)
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
        # Bit 5 of switch-on disabled and fault is open; ours is 0 as in the maker's default.
        word = self._machine.state | self._motion.bits
        if self._guard.supplied:
            word |= VOLTAGE_ENABLED
        if self._operational:
            word |= REMOTE
        if self._errors.warning:
            word |= WARNING
        if self._reference:
            word |= REFERENCED
        if self._driving:
            word |= FOLLOWS_COMMAND
        if self._limited or self._motion.limited:
            word |= INTERNAL_LIMIT
        self._statusword = word

    def power(self, on: bool) -> None:
        """Power stage on, in the chosen mode, or off."""
        plant, axis = self._plant, self.axis
        if on:
            plant.advance(self._timers.now_ns)
            plant.powered[axis] = True
            self._guard.start()
            self._brake.open(self._begin)
            return
        self._driving = False
        if self._brake.fitted and plant.powered[axis]:
            # The motor is held until the brake does.
            if self._motion.task is not self._braking:
                self._motion.run(self._braking)
            self._brake.close(self._cut)
        else:
            self._cut()

    def _cut(self) -> None:
        """Take the power at once; the brake follows."""
        plant, axis = self._plant, self.axis
        self._driving = self._limited = False
        self._motion.stop()
        self._guard.stop()
        if plant.powered[axis]:
            plant.advance(self._timers.now_ns)
        plant.powered[axis] = False
        plant.current_reference[axis] = 0.0
        self._brake.close(self._show)

    def _begin(self) -> None:
        """Follow the set-points of the chosen mode."""
        mode = int(self._mode.value)
        self._driving = mode == CYCLIC_TORQUE
        self._plant.advance(self._timers.now_ns)
        if self._driving:
            self._motion.stop()
            self._drive()
        else:
            self._motion.run(self._tasks[mode], self._controlword)
        self._show()

    def ramp_down(self, then: State) -> None:
        profile = then in (State.READY, State.SWITCHED_ON)
        if then is State.FAULT:
            profile = self._fault_ramp == _PROFILE_RAMP
        self._braking.ramp = _PROFILE_RAMP if profile else _QUICK_STOP_RAMP
        self._driving = self._limited = False
        self._plant.advance(self._timers.now_ns)
        self._motion.run(self._braking)

    def _standstill(self) -> None:
        self._machine.ramp_ended()
        self._show()

    def shutdown_ramp(self) -> bool:
        return self.objects.number(0x605B, 0) == 1

    def disable_ramp(self) -> bool:
        return self.objects.number(0x605C, 0) == 1

    def may_enable(self) -> bool:
        if self._torque_off:
            self.fail(TORQUE_OFF)
            return False
        terminals = self._terminals
        if terminals.active(Function.QUICK_STOP):
            return False
        return terminals.active(Function.DRIVE_ENABLE) or not terminals.has(Function.DRIVE_ENABLE)

    # -- errors ----------------------------------------------------------------------------------

    def resettable(self) -> bool:
        errors = self._errors
        if errors.needs(Recovery.COMMUNICATION) or errors.needs(Recovery.DEVICE):
            return False
        if self._torque_off and TORQUE_OFF in errors.present:
            return False
        return self._guard.recovered(errors.present)

    def fault_cleared(self) -> None:
        if any(ERRORS[code].loses_position for code in self._errors.present):
            self._lose_position()
        self._errors.clear()
        self.on_error(0, 0)

    def _lose_position(self) -> None:
        self._reference = False
        self._samples.set_position(self.axis, 0)
        self._show()

    def _referenced(self, position: int) -> None:
        """Homing has found where the motor is."""
        self._reference = True
        self._samples.set_position(self.axis, position)

    def fail(self, code: int) -> None:
        """Raises KeyError for a code that an EPOS4 does not have."""
        error = ERRORS[code]
        register = self._errors.push(code)
        if error.reaction != "W":
            ramp = self._brakes(error.reaction)
            if not ramp:
                self._cut()
            self._machine.fault(ramp=ramp)
        self._done = None
        self._show()
        self.on_error(code, register)

    def _brakes(self, reaction: str) -> bool:
        """Whether an error is answered with a ramp, and with which."""
        self._fault_ramp = _QUICK_STOP_RAMP
        if reaction == "A":
            return self.objects.number(0x6007, 0) == _QUICK_STOP
        option = self.objects.number(0x605E, 0)
        if option == 1:
            self._fault_ramp = _PROFILE_RAMP
        return reaction == "F" and option != 0

    # -- the world -------------------------------------------------------------------------------

    def set_input(self, name: str, active: bool) -> None:
        """A wire's level changes: one of `terminals.WIRES`, or "sto", which is active when the
        torque is to be off. Raises KeyError for another.

        A limit switch is an error when it closes, so that the motor can be driven off it.
        """
        terminals = self._terminals
        if name == "sto":
            self._torque_off = active
            if active and self._plant.powered[self.axis]:
                self.fail(TORQUE_OFF)
        else:
            before = terminals.functions()
            terminals.set(name, active=active)
            closed = terminals.functions() & ~before
            if self.enabled and self._mode.value != HOMING:
                for function, code in (
                    (Function.NEGATIVE_LIMIT, NEGATIVE_LIMIT),
                    (Function.POSITIVE_LIMIT, POSITIVE_LIMIT),
                ):
                    if closed >> function & 1:
                        self.fail(code)
            if terminals.active(Function.QUICK_STOP):
                self._machine.obey(Command.QUICK_STOP)
            if terminals.has(Function.DRIVE_ENABLE) and not terminals.active(Function.DRIVE_ENABLE):
                self._machine.obey(Command.DISABLE_VOLTAGE)
        self._done = None
        self._show()

    def set_supply(self, volt: float) -> None:
        self._guard.supply = volt
        self._guard.check(self._errors.present)
        self._show()

    def set_temperature(self, celsius: float) -> None:
        """Of the power stage."""
        self._guard.temperature = celsius
        self._guard.check(self._errors.present)

    def set_operational(self, operational: bool) -> None:
        self._operational = operational
        self._show()

    def communication_reset(self) -> None:
        self._errors.recovered(Recovery.COMMUNICATION)

    def reset(self) -> None:
        """The stored parameters are loaded; the encoder counts from 0."""
        self._done = None
        self._target = self._offset = self._controlword = 0
        self._cut()
        self._machine.start()
        self.objects.restore(*_OWN_OBJECTS)
        self._errors.restart()
        self._guard.restart()
        self._lose_position()
        self._configure()
        self._show()

    def power_cycle(self) -> None:
        """The supply goes and comes back."""
        self.objects.restore(*_BUS_OBJECTS)
        self.reset()
