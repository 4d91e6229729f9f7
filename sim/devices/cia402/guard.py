"""What a drive watches of itself: supply, temperature, I2t of motor and power stage, speed.

Supply and temperature are compared when they change; the rest ten milliseconds at a time while
there is power, and as often as the speed loop runs while the motor is faster than half of 0x6080.
In between the current is taken as steady.
"""

from __future__ import annotations

from collections.abc import Callable

from tonus.config.schema.lab import PowerStage
from tonus.sim.devices.cia402.errors import OVERHEATED, OVERVOLTAGE, UNDERVOLTAGE, Codes
from tonus.sim.devices.cia402.servo import PERIOD_NS, Servo
from tonus.sim.devices.cia402.thermal import Thermal
from tonus.sim.devices.samples import Measured
from tonus.sim.devices.timers import Timers

_SLOW_NS = 10_000_000
_NEAR = 0.5
_BAND = 0.9
"""From this share of 0x6080 on the current that drives the motor on is limited."""


class Guard:
    """``low``, ``high``: A, between which the current may be now."""

    def __init__(
        self,
        axis: int,
        servo: Servo,
        plant: Measured,
        timers: Timers,
        stage: PowerStage,
        codes: Codes,
        fail: Callable[[int], None],
        changed: Callable[[], None],
        following: Callable[[], bool],
    ) -> None:
        """``changed`` is called when other currents are allowed; software limits are watched while
        the drive is ``following`` set-points, not while it stops."""
        self._axis = axis
        self._servo = servo
        self._plant = plant
        self._timers = timers
        self._stage = stage
        self._codes = codes
        self._fail = fail
        self._changed = changed
        self._following = following
        find = servo.find
        self._limit = find(0x3001, 2)
        self._nominal = find(0x3001, 1)
        self._winding = find(0x3001, 4)
        self._top = find(0x6080, 0)
        self._fences = (find(0x607D, 1), find(0x607D, 2))
        self._run = 0  # number of the present run; a timer of an older one is stale
        self._at_ns = timers.now_ns
        self._powered = False
        self.motor = Thermal()
        self.power_stage = Thermal()
        self.supply = stage.supply
        self.temperature = stage.temperature
        self.low = self.high = 0.0

    # -- supply and temperature ------------------------------------------------------------------

    def _limits(self) -> tuple[float, float, float]:
        value = self._servo.value
        return value(0x2201, 1) * 1e-3, value(0x2201, 2) * 1e-3, value(0x3201, 4) * 0.1

    def check(self, present: set[int]) -> None:
        """Raise what is out of range and not among the errors ``present``."""
        low, high, hot = self._limits()
        for code, wrong in (
            (UNDERVOLTAGE, self.supply < low),
            (OVERVOLTAGE, self.supply > high),
            (OVERHEATED, self.temperature > hot),
        ):
            if wrong and code not in present:
                self._fail(code)

    def recovered(self, present: set[int]) -> bool:
        """Whether every value is far enough back in its range for its error to be reset."""
        low, high, hot = self._limits()
        stage = self._stage
        out = {
            UNDERVOLTAGE: self.supply < low + stage.undervoltage_recovery,
            OVERVOLTAGE: self.supply > high - stage.overvoltage_recovery,
            OVERHEATED: self.temperature > hot - stage.thermal_recovery,
            self._codes.motor_overheated: self.motor.hot,
        }
        return not any(out[code] for code in present & out.keys())

    @property
    def supplied(self) -> bool:
        return self.supply >= self._limits()[0]

    # -- current and speed -----------------------------------------------------------------------

    def warm(self) -> None:
        """Bring the I2t levels to the present."""
        now, stage = self._timers.now_ns, self._stage
        seconds, self._at_ns = (now - self._at_ns) * 1e-9, now
        current, release = self._servo.current, stage.release_level
        if not self._powered:
            current = 0.0
        nominal, winding = self._nominal.number * 1e-3, self._winding.number * 0.1
        self.motor.pass_current(current, nominal, winding, seconds, release)
        self.power_stage.pass_current(
            current, stage.continuous_current, stage.thermal_time_constant, seconds, release
        )

    def limit(self) -> None:
        """Find anew what current may flow."""
        most = self._limit.number * 1e-3
        if self.motor.hot:
            most = min(most, self._nominal.number * 1e-3)
        if self.power_stage.hot:
            most = min(most, self._stage.continuous_current)
        low, high = -most, most
        speed = self._plant.motor_rate.item(self._axis)
        top = self._top.number * self._servo.motor_speed_unit
        if abs(speed) > _BAND * top:
            # As its speed loop would: so much current as the distance to the limit is worth.
            gain = self._servo.value(0x30A2, 1) * 1e-6
            room = min(max(gain * (top - abs(speed)), 0.0), most)
            low, high = (low, room) if speed > 0.0 else (-room, high)
        if (low, high) != (self.low, self.high):
            self.low, self.high = low, high
            self._servo.limit = most
            self._changed()

    def start(self) -> None:
        """Power goes on."""
        if not self._powered:
            self.warm()
            self._powered = True
            self._run += 1
            self.limit()
            self._again(self._timers.now_ns, self._run)

    def stop(self) -> None:
        """Power goes off."""
        if self._powered:
            self.warm()
            self._powered = False
            self._run += 1

    def restart(self) -> None:
        """The levels are not kept without power."""
        self.motor, self.power_stage = Thermal(), Thermal()

    def _again(self, now_ns: int, run: int) -> None:
        top = self._top.number * self._servo.motor_speed_unit
        fast = abs(self._plant.motor_rate.item(self._axis)) > _NEAR * top
        # The slow watch of all drives falls on the same instants, so that the lab wakes once.
        at_ns = now_ns + PERIOD_NS if fast else (now_ns // _SLOW_NS + 1) * _SLOW_NS
        self._timers.call_at(at_ns, lambda at_ns: self._step(at_ns, run))

    def _step(self, now_ns: int, run: int) -> None:
        if run != self._run:
            return
        self.warm()
        self.limit()
        self._fence()
        if run == self._run:
            self._again(now_ns, run)

    def _fence(self) -> None:
        """Beyond a software limit and still moving away from it."""
        servo = self._servo
        low, high = (entry.number for entry in self._fences)
        if low == high == 0 or not self._following():
            return
        servo.measure()
        beyond = servo.position > high and servo.speed > 0.0
        if beyond or (servo.position < low and servo.speed < 0.0):
            self._fail(self._codes.software_limit)
