"""A drive by CiA 402 on one axis of the plant, without a bus; whose objects it has is its maker's.

Cyclic synchronous torque: the target torque (0x6071 plus 0x60B2, per mille of the rated torque)
becomes a current reference within what may flow; the current loop itself is the plant's. In all
other modes the drive's own loops move the motor (`tonus.sim.devices.cia402.motion`).
"""

from __future__ import annotations

from tonus.config.schema.axis import Brake
from tonus.config.schema.lab import PowerStage
from tonus.sim.devices.cia402 import axis_table
from tonus.sim.devices.cia402.error_memory import ErrorMemory
from tonus.sim.devices.cia402.errors import PDO_TIMEOUT, Codes, ErrorTable, Recovery
from tonus.sim.devices.cia402.output import (
    CYCLIC_POSITION,
    CYCLIC_TORQUE,
    CYCLIC_VELOCITY,
    HOMING,
    Output,
)
from tonus.sim.devices.cia402.set_points import SetPoints
from tonus.sim.devices.cia402.states import Command, Machine, State
from tonus.sim.devices.cia402.terminals import TORQUE_OFF, Function, Terminals
from tonus.sim.devices.device import ErrorSink, PdoDefault, Reader, Writer
from tonus.sim.devices.objects import ObjectDictionary
from tonus.sim.devices.samples import Samples
from tonus.sim.devices.timers import Timers

VOLTAGE_ENABLED = 0x0010
WARNING = 0x0080
REMOTE = 0x0200
REFERENCED = 0x8000
_CYCLIC = (CYCLIC_POSITION, CYCLIC_VELOCITY, CYCLIC_TORQUE)
_BUS_OBJECTS = (0x1000, 0x1FFF)
_OWN_OBJECTS = (0x2000, 0xFFFF)
QUICK_STOP_RAMP = 0x6085
PROFILE_RAMP = 0x6084


def _no_sink(code: int, register: int) -> None:
    del code, register


class Cia402Drive:
    """What every drive has in common. A maker's drive calls `reset` when it is complete."""

    receive_pdos: tuple[PdoDefault, ...]
    transmit_pdos: tuple[PdoDefault, ...]
    longest_mapping: int
    consumers: int
    event_timer: bool
    error_behaviour: bool

    def __init__(
        self,
        axis: int,
        objects: ObjectDictionary,
        core: ObjectDictionary,
        samples: Samples,
        timers: Timers,
        stage: PowerStage | None,
        errors: ErrorTable,
        codes: Codes,
        brake: Brake | None,
    ) -> None:
        """``objects`` is what masters see. ``core`` holds every object that the states, loops and
        limits here read or write; entries of standard objects are the same in both."""
        self.axis: int = axis
        self.objects = objects
        self.errors = errors
        self.on_error: ErrorSink = _no_sink
        self._core = core
        self._codes = codes
        self._samples = samples
        self._machine = Machine(self)
        self._terminals = Terminals(core)
        self._output = Output(
            axis,
            core,
            samples,
            timers,
            stage or PowerStage(),
            self._terminals,
            codes,
            brake,
            fail=self.fail,
            changed=self._show,
            standstill=self._standstill,
            referenced=self._referenced,
        )
        self.target_torque: Writer = self._output.set_target
        """0x6071, per mille of the rated torque"""
        self._set_points = SetPoints(
            timers, self._output.lines, self._cyclic, lambda: self.fail(PDO_TIMEOUT)
        )
        self._errors = ErrorMemory(core, errors, self._show)
        self._statusword = VOLTAGE_ENABLED
        self._operational = False
        self._reference = False
        self._done: tuple[int, State] | None = None  # what changes nothing if it comes again
        self._mode = core.find(0x6060, 0)
        self._timers = timers
        output = self._output
        for key, read in (
            ((0x6041, 0), self.statusword),
            ((0x6040, 0), lambda: output.word),
            ((0x6071, 0), lambda: output.target),
            ((0x60B2, 0), lambda: output.offset),
        ):
            core.find(*key).read = read
        for key, write in (
            ((0x6040, 0), self.controlword),
            ((0x6071, 0), output.set_target),
            ((0x60B2, 0), output.set_offset),
        ):
            core.find(*key).write = write

    def _follow(self, key: tuple[int, int]) -> None:
        """Take the value over now, so that what depends on it can be computed from it."""
        entry = self._core.find(*key)

        def write(value: int) -> None:
            changed, entry.value = entry.value != value, value
            self._configure()
            if changed and entry is self._mode and self._output.following:
                self._output.begin()

        entry.write = write

    def _configure(self) -> None:
        """Work out anew what depends on objects."""
        raise NotImplementedError

    # -- process data ----------------------------------------------------------------------------

    def sample(self, now_ns: int) -> None:
        self._samples.at(now_ns)

    def reader(self, index: int, subindex: int) -> Reader:
        samples, axis = self._samples, self.axis
        if index == 0x6041:
            return self.statusword
        if index == 0x6064:
            return lambda: samples.values.item(axis)
        if index == 0x6077:
            place = samples.torque + axis
            return lambda: samples.values.item(place)
        return self.objects.find(index, subindex).measure

    def place(self, index: int, subindex: int) -> int | None:
        """Where in `Samples.values` an object's value stands; None: nowhere."""
        samples = self._samples
        firsts = {
            0x603F: samples.error,
            0x6041: samples.status,
            0x6064: 0,
            0x6077: samples.torque,
        }
        return firsts[index] + self.axis if index in firsts and subindex == 0 else None

    def writer(self, index: int, subindex: int) -> Writer:
        if index == 0x6040:
            return self.controlword
        if index == 0x6071:
            return self.target_torque
        return self.objects.find(index, subindex).put

    def received(self, now_ns: int) -> None:
        """A receive PDO has been applied."""
        self._set_points.received(now_ns)

    def _cyclic(self) -> bool:
        """Whether the drive follows set-points that come in every cycle."""
        return self.enabled and self._mode.value in _CYCLIC

    def controlword(self, word: int) -> None:
        state = self._machine.state
        if (word, state) == self._done:
            return
        self._output.word = word
        self._machine.controlword(word)
        if self.enabled:
            self._output.obey(word)
        self._done = (word, state) if self._machine.state is state else None
        self._show()

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
        word = self._machine.state | self._output.bits
        if self._output.guard.supplied:
            word |= VOLTAGE_ENABLED
        if self._operational:
            word |= REMOTE
        if self._errors.warning:
            word |= WARNING
        if self._reference:
            word |= REFERENCED
        self._statusword = word
        samples, done = self._samples, self._done
        samples.values[samples.status + self.axis] = word
        samples.values[samples.error + self.axis] = self._errors.code
        same = done is not None and done[1] is self._machine.state and not self._set_points.timed
        table = samples.axes.integers
        table[axis_table.DONE, self.axis] = done[0] if same and done else axis_table.NO_WORD

    def power(self, on: bool) -> None:
        if on:
            self._output.on()
        else:
            self._output.off()

    def ramp_down(self, then: State) -> None:
        if then is not State.FAULT:
            # Options 1 and 5 of the quick stop are the slow-down ramp's.
            profile = then is not State.QUICK_STOP_ACTIVE or self.quick_stop_option() in (1, 5)
            self._output.braking.ramp = PROFILE_RAMP if profile else QUICK_STOP_RAMP
        self._output.ramp_down()

    def _standstill(self) -> None:
        self._machine.ramp_ended()
        self._show()

    def shutdown_ramp(self) -> bool:
        return self._core.number(0x605B, 0) == 1

    def disable_ramp(self) -> bool:
        return self._core.number(0x605C, 0) == 1

    def quick_stop_option(self) -> int:
        return self._core.number(0x605A, 0)

    def may_enable(self) -> bool:
        if self._terminals.torque_off:
            self.fail(self._codes.torque_off)
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
        if self._terminals.torque_off and self._codes.torque_off in errors.present:
            return False
        return self._output.guard.recovered(errors.present)

    def fault_cleared(self) -> None:
        if any(self.errors[code].loses_position for code in self._errors.present):
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
        """Raises KeyError for a code that the drive does not have."""
        error = self.errors[code]
        register = self._errors.push(code)
        if error.reaction != "W":
            ramp = self._brakes(error.reaction)
            if not ramp:
                self._output.cut()
            self._machine.fault(ramp=ramp)
        self._done = None
        self._show()
        self.on_error(code, register)

    def _brakes(self, reaction: str) -> bool:
        """Whether an error is answered with a ramp, and the ramp chosen."""
        option = self._core.number(0x605E, 0)
        self._output.braking.ramp = PROFILE_RAMP if option == 1 else QUICK_STOP_RAMP
        return reaction != "D" and option != 0

    # -- the world -------------------------------------------------------------------------------

    def set_input(self, name: str, active: bool) -> None:
        """A wire's level changes: one of `terminals.WIRES`, or of `terminals.TORQUE_OFF`,
        which are active when the torque is to be off. Raises KeyError for another.

        A limit switch is an error when it closes, so that the motor can be driven off it.
        """
        terminals = self._terminals
        if name in TORQUE_OFF:
            terminals.set_torque_off(name, active=active)
            if active and self._output.powered:
                self.fail(self._codes.torque_off)
        else:
            before = terminals.functions()
            terminals.set(name, active=active)
            closed = terminals.functions() & ~before
            if self.enabled and self._mode.value != HOMING:
                for function, code in (
                    (Function.NEGATIVE_LIMIT, self._codes.negative_limit),
                    (Function.POSITIVE_LIMIT, self._codes.positive_limit),
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
        self._output.guard.supply = volt
        self._output.guard.check(self._errors.present)
        self._show()

    def set_temperature(self, celsius: float) -> None:
        """Of the power stage."""
        self._output.guard.temperature = celsius
        self._output.guard.check(self._errors.present)

    def set_operational(self, operational: bool) -> None:
        self._operational = operational
        self._show()

    def communication_reset(self) -> None:
        self._errors.recovered(Recovery.COMMUNICATION)

    def reset(self) -> None:
        """The stored parameters are loaded; the encoder counts from 0."""
        self._done = None
        output = self._output
        output.target = output.offset = output.word = 0
        self._output.cut()
        self._machine.start()
        self.objects.restore(*_OWN_OBJECTS)
        self._errors.restart()
        self._output.guard.restart()
        self._lose_position()
        self._configure()
        self._show()

    def power_cycle(self) -> None:
        """The supply goes and comes back."""
        self.objects.restore(*_BUS_OBJECTS)
        self.reset()
