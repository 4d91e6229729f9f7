"""What a drive puts on its motor: a set-point's torque, a motion of its own, or nothing."""

from __future__ import annotations

from collections.abc import Callable

from tonus.config.schema.axis import Brake
from tonus.config.schema.lab import PowerStage
from tonus.sim.devices.cia402 import axis_table
from tonus.sim.devices.cia402.errors import Codes
from tonus.sim.devices.cia402.guard import Guard
from tonus.sim.devices.cia402.holding_brake import HoldingBrake
from tonus.sim.devices.cia402.homing import Homing
from tonus.sim.devices.cia402.modes import (
    CyclicPosition,
    CyclicVelocity,
    ProfilePosition,
    ProfileVelocity,
)
from tonus.sim.devices.cia402.motion import FOLLOWS_COMMAND, Braking, Motion, Task
from tonus.sim.devices.cia402.servo import Servo
from tonus.sim.devices.cia402.terminals import Terminals
from tonus.sim.devices.objects import ObjectDictionary
from tonus.sim.devices.samples import Samples
from tonus.sim.devices.timers import Timers

PROFILE_POSITION = 1
PROFILE_VELOCITY = 3
HOMING = 6
CYCLIC_POSITION = 8
CYCLIC_VELOCITY = 9
CYCLIC_TORQUE = 10
INTERNAL_LIMIT = 0x0800


class Output:
    """The power stage, and what drives it. In cyclic synchronous torque a set-point is a current
    at once; 0x6080 takes current away near that speed, it does not brake."""

    def __init__(
        self,
        axis: int,
        objects: ObjectDictionary,
        samples: Samples,
        timers: Timers,
        stage: PowerStage,
        terminals: Terminals,
        codes: Codes,
        brake: Brake | None,
        *,
        fail: Callable[[int], None],
        changed: Callable[[], None],
        standstill: Callable[[], None],
        referenced: Callable[[int], None],
    ) -> None:
        """``changed``: other `bits`; ``standstill``: a ramp has ended; ``referenced``: homing has
        found what the present position is."""
        self._axis = axis
        self._plant = plant = samples.plant
        self._timers = timers
        self._changed = changed
        self.servo = servo = Servo(axis, objects, samples)
        self.guard = Guard(
            axis, servo, plant, timers, stage, codes, fail, self._allowed, lambda: self.following
        )
        self._motion = Motion(servo, plant, timers, changed)
        self.braking = Braking(servo, standstill)
        self._brake = HoldingBrake(axis, objects, plant, timers, brake)
        position = CyclicPosition(servo, fail, codes.software_limit, self._ampere)
        velocity = CyclicVelocity(servo, self._ampere)
        self.lines = (position.interpolation, velocity.interpolation)
        self._tasks: dict[int, Task] = {
            PROFILE_POSITION: ProfilePosition(servo, fail, codes.software_limit),
            PROFILE_VELOCITY: ProfileVelocity(servo),
            HOMING: Homing(servo, terminals, referenced),
            CYCLIC_POSITION: position,
            CYCLIC_VELOCITY: velocity,
        }
        self._mode = objects.find(0x6060, 0)
        self._driving = False
        self._limited = False
        self._integers = samples.axes.integers[:, axis]
        self._currents = samples.axes.currents[:, axis]
        self.offset = 0
        """per mille of the rated torque"""
        self._per_mille = 0.0
        self._low = self._high = 0.0
        self.word = 0
        """the present controlword"""

    @property
    def target(self) -> int:
        """Per mille of the rated torque."""
        return int(self._integers[axis_table.TARGET])

    @target.setter
    def target(self, mille: int) -> None:
        self._integers[axis_table.TARGET] = mille

    def _tell(self) -> None:
        """The axis table, what a set-point meets."""
        integers, currents = self._integers, self._currents
        integers[axis_table.OFFSET] = self.offset
        integers[axis_table.DRIVING] = self._driving
        integers[axis_table.LIMITED] = self._limited
        currents[axis_table.PER_MILLE] = self._per_mille
        currents[axis_table.LOW], currents[axis_table.HIGH] = self._low, self._high

    @property
    def bits(self) -> int:
        """Of the statusword."""
        bits = FOLLOWS_COMMAND if self._driving else self._motion.bits
        return bits | INTERNAL_LIMIT if self._limited or self._motion.limited else bits

    @property
    def following(self) -> bool:
        """Whether set-points move the motor, and no stop nor a brake that opens."""
        return self._driving or self._motion.task not in (None, self.braking)

    @property
    def powered(self) -> bool:
        return bool(self._plant.powered[self._axis])

    # -- set-points ------------------------------------------------------------------------------

    def set_scale(self, per_mille: float) -> None:
        """A for one per mille."""
        self._per_mille = per_mille
        self._tell()
        self.guard.limit()
        if self._driving:
            self._drive()

    def set_target(self, mille: int) -> None:
        if mille != self.target:
            self.target = mille
            if self._driving:
                self._drive()

    def set_offset(self, mille: int) -> None:
        self.offset = mille
        self._tell()
        if self._driving:
            self._drive()

    def obey(self, word: int) -> None:
        """A new controlword while operation is enabled."""
        self.word = word
        if self._motion.task is not None:
            self._motion.task.controlword(word)

    def _ampere(self, mille: int) -> float:
        return mille * self._per_mille

    def _allowed(self) -> None:
        """Other currents are allowed from now on."""
        self._low, self._high = self.guard.low, self.guard.high
        self._tell()
        if self._driving:
            self._drive()

    def _drive(self) -> None:
        current = (self.target + self.offset) * self._per_mille
        limited = not self._low <= current <= self._high
        if limited:
            current = min(max(current, self._low), self._high)
        if limited is not self._limited:
            self._limited = limited
            self._tell()
            self._changed()
        plant = self._plant
        plant.advance(self._timers.now_ns)
        plant.current_reference[self._axis] = current

    # -- power -----------------------------------------------------------------------------------

    def on(self) -> None:
        plant = self._plant
        plant.advance(self._timers.now_ns)
        plant.powered[self._axis] = True
        self.guard.start()
        self._brake.open(self.begin)

    def begin(self) -> None:
        """Follow the set-points of the chosen mode."""
        mode = int(self._mode.value)
        self._driving = mode == CYCLIC_TORQUE
        self._plant.advance(self._timers.now_ns)
        if self._driving:
            self._motion.stop()
            self._drive()
        elif mode in self._tasks:
            self._limited = False
            self._motion.run(self._tasks[mode], self.word)
        else:  # no mode is chosen yet
            self._limited = False
            self._motion.stop()
            self._plant.current_reference[self._axis] = 0.0
        self._tell()
        self._changed()

    def ramp_down(self) -> None:
        """Brake, and hold the motor."""
        self._driving = self._limited = False
        self._tell()
        self._plant.advance(self._timers.now_ns)
        self._motion.run(self.braking)

    def off(self) -> None:
        """Take the power; with a holding brake the motor is held until the brake does."""
        if not (self._brake.fitted and self.powered):
            self.cut()
            return
        if self._motion.task is not self.braking:
            self.ramp_down()
        self._brake.close(self.cut)

    def cut(self) -> None:
        """Take the power at once; the brake follows."""
        plant, axis = self._plant, self._axis
        self._driving = self._limited = False
        self._tell()
        self._motion.stop()
        self.guard.stop()
        if plant.powered[axis]:
            plant.advance(self._timers.now_ns)
        plant.powered[axis] = False
        plant.current_reference[axis] = 0.0
        self._brake.close(self._changed)
