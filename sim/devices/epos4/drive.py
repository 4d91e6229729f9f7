"""An emulated EPOS4 Compact 50/8 as a device without a bus.

Cyclic synchronous torque: the target torque (0x6071 plus 0x60B2, per mille of the rated torque)
becomes a current reference within what may flow; the current loop itself is the plant's. In all
other modes the drive's own loops move the motor (`tonus.sim.devices.cia402.motion`). The speed is
the encoder's true one, whatever 0x3010:1 says.
"""

from __future__ import annotations

from tonus.config.schema.lab import PowerStage
from tonus.sim.devices.cia402.error_memory import ErrorMemory
from tonus.sim.devices.cia402.output import (
    CYCLIC_POSITION,
    CYCLIC_TORQUE,
    CYCLIC_VELOCITY,
    HOMING,
    Output,
)
from tonus.sim.devices.cia402.servo import RPM
from tonus.sim.devices.cia402.set_points import SetPoints
from tonus.sim.devices.cia402.states import POWERED, Command, Machine, State
from tonus.sim.devices.cia402.terminals import Function, Terminals
from tonus.sim.devices.device import ErrorSink, Reader, Writer
from tonus.sim.devices.epos4.errors import (
    CORRUPT_PARAMETERS,
    ERRORS,
    NEGATIVE_LIMIT,
    PDO_TIMEOUT,
    POSITIVE_LIMIT,
    TORQUE_OFF,
    Recovery,
)
from tonus.sim.devices.epos4.objects import (
    POWER_OFF_ONLY,
    RECEIVE_PDOS,
    SENSORS,
    TRANSMIT_PDOS,
    dictionary,
    has_sensors,
)
from tonus.sim.devices.epos4.values import connect, scale_speeds
from tonus.sim.devices.objects import INTERNAL, PASSWORD, WRONG_STATE, AbortError
from tonus.sim.devices.samples import Samples
from tonus.sim.devices.store import connect_store
from tonus.sim.devices.timers import Timers

VOLTAGE_ENABLED = 0x0010
WARNING = 0x0080
REMOTE = 0x0200
REFERENCED = 0x8000
_CYCLIC = (CYCLIC_POSITION, CYCLIC_VELOCITY, CYCLIC_TORQUE)
_BUS_OBJECTS = (0x1000, 0x1FFF)
_OWN_OBJECTS = (0x2000, 0xFFFF)
_QUICK_STOP_RAMP = 0x6085
_PROFILE_RAMP = 0x6084
_QUICK_STOP = 3


def _no_sink(code: int, register: int) -> None:
    del code, register


class Epos4:
    """One drive on one axis of the plant."""

    receive_pdos = RECEIVE_PDOS
    transmit_pdos = TRANSMIT_PDOS
    longest_mapping = 12
    consumers = 2
    event_timer = False

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
        self._samples = samples
        self._machine = Machine(self)
        self._terminals = Terminals(objects)
        self._output = Output(
            axis,
            objects,
            samples,
            timers,
            stage or PowerStage(),
            self._terminals,
            holding_brake=holding_brake,
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
        self._errors = ErrorMemory(objects, self._show)
        self._statusword = VOLTAGE_ENABLED
        self._operational = False
        self._reference = False
        self._done: tuple[int, State] | None = None  # what changes nothing if it comes again
        self._mode = objects.find(0x6060, 0)
        self._timers = timers
        self._connect()
        self.reset()

    # -- objects ---------------------------------------------------------------------------------

    def _connect(self) -> None:
        find = self.objects.find
        output = self._output
        connect(self.axis, self.objects, self._samples, self._timers, output.servo, output.guard)
        find(0x6041, 0).read = self.statusword
        find(0x6040, 0).read = lambda: output.word
        find(0x6071, 0).read = lambda: output.target
        find(0x60B2, 0).read = lambda: output.offset
        writes: dict[tuple[int, int], Writer] = {
            (0x6040, 0): self.controlword,
            (0x6071, 0): output.set_target,
            (0x60B2, 0): output.set_offset,
            (0x1011, 4): self._locked,
        }
        for key, write in writes.items():
            find(*key).write = write
        for key in ((0x6060, 0), (0x3001, 1), (0x3001, 2), (0x3001, 5), (0x6080, 0), (0x60C2, 1)):
            self._follow(key)
        for key in POWER_OFF_ONLY:
            self._guarded(key)
        find(0x1011, 4).read = lambda: 1
        connect_store(self.objects, self._can_store)

    def _follow(self, key: tuple[int, int]) -> None:
        """Take the value over now, so that what depends on it can be computed from it."""
        entry = self.objects.find(*key)

        def write(value: int) -> None:
            changed, entry.value = entry.value != value, value
            self._configure()
            if changed and entry is self._mode and self._output.following:
                self._output.begin()

        entry.write = write

    def _guarded(self, key: tuple[int, int]) -> None:
        entry = self.objects.find(*key)

        def write(value: int) -> None:
            if self._machine.state in POWERED:
                raise AbortError(WRONG_STATE)
            if key == (0x3000, 1) and not has_sensors(value):
                raise AbortError(INTERNAL)
            entry.value = value
            if key[0] in SENSORS:
                self._lose_position()
            self._configure()

        entry.write = write

    def _configure(self) -> None:
        number = self.objects.number
        nominal = number(0x3001, 1) * 1e-3
        self._samples.set_nominal_current(self.axis, nominal)
        self._set_points.set_period(number(0x60C2, 1))
        self._output.servo.velocity_unit = RPM * scale_speeds(self.objects)
        # Torque is relative to the rated torque; without a torque constant there is none.
        self._output.set_scale(nominal * 1e-3 if number(0x6076, 0) else 0.0)

    def _can_store(self) -> bool:
        sound = CORRUPT_PARAMETERS not in self._errors.present
        return sound and self._output.guard.supplied

    def _locked(self, value: int) -> None:
        """The maker's own."""
        del value
        raise AbortError(PASSWORD)

    # -- process data ----------------------------------------------------------------------------

    def sample(self, now_ns: int) -> None:
        self._samples.at(now_ns)

    def reader(self, index: int, subindex: int) -> Reader:
        samples, axis = self._samples, self.axis
        if index == 0x6041:
            return self.statusword
        if index == 0x6064:
            return lambda: samples.words[axis]
        if index == 0x6077:
            place = samples.torque + axis
            return lambda: samples.words[place]
        return self.objects.find(index, subindex).measure

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

    def power(self, on: bool) -> None:
        if on:
            self._output.on()
        else:
            self._output.off()

    def ramp_down(self, then: State) -> None:
        if then is not State.FAULT:
            profile = then is not State.QUICK_STOP_ACTIVE
            self._output.braking.ramp = _PROFILE_RAMP if profile else _QUICK_STOP_RAMP
        self._output.ramp_down()

    def _standstill(self) -> None:
        self._machine.ramp_ended()
        self._show()

    def shutdown_ramp(self) -> bool:
        return self.objects.number(0x605B, 0) == 1

    def disable_ramp(self) -> bool:
        return self.objects.number(0x605C, 0) == 1

    def may_enable(self) -> bool:
        if self._terminals.torque_off:
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
        if self._terminals.torque_off and TORQUE_OFF in errors.present:
            return False
        return self._output.guard.recovered(errors.present)

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
                self._output.cut()
            self._machine.fault(ramp=ramp)
        self._done = None
        self._show()
        self.on_error(code, register)

    def _brakes(self, reaction: str) -> bool:
        """Whether an error is answered with a ramp, and the ramp chosen."""
        if reaction == "A":
            self._output.braking.ramp = _QUICK_STOP_RAMP
            return self.objects.number(0x6007, 0) == _QUICK_STOP
        option = self.objects.number(0x605E, 0)
        self._output.braking.ramp = _PROFILE_RAMP if option == 1 else _QUICK_STOP_RAMP
        return reaction == "F" and option != 0

    # -- the world -------------------------------------------------------------------------------

    def set_input(self, name: str, active: bool) -> None:
        """A wire's level changes: one of `terminals.WIRES`, or "sto", which is active when the
        torque is to be off. Raises KeyError for another.

        A limit switch is an error when it closes, so that the motor can be driven off it.
        """
        terminals = self._terminals
        if name == "sto":
            terminals.torque_off = active
            if active and self._output.powered:
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
        self.objects.find(0x200A, 0).value = self.objects.number(0x2001, 0)
        self._errors.restart()
        self._output.guard.restart()
        self._lose_position()
        self._configure()
        self._show()

    def power_cycle(self) -> None:
        """The supply goes and comes back."""
        self.objects.restore(*_BUS_OBJECTS)
        self.reset()
