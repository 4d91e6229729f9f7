"""A drive's position and speed controllers: from a demanded motion to a current.

Gains, whose units are read as the maker's SI unit words (0x30A1:9) have them: position P uA/rad,
I uA/(rad s), D uA s/rad; speed P uA s/rad, I uA/rad; feed-forward of speed uA s/rad and of
acceleration uA s2/rad. Both give a current; the current loop is the plant's. The integral begins
at the present current, so that a cable under tension is held and not let go.
"""

from __future__ import annotations

from math import pi

from tonus.sim.devices.objects import ObjectDictionary
from tonus.sim.devices.samples import Samples

PERIOD_NS = 400_000
"""The EPOS4's position and speed loops run at 2.5 kHz."""
PERIOD = PERIOD_NS * 1e-9
RPM = pi / 30.0
_MICRO = 1e-6


class Servo:
    """One axis' controllers. `measure` first, then one of the `follow_` calls, once a period.

    Positions are in increments of the encoder, speeds in increments per second.
    """

    def __init__(self, axis: int, objects: ObjectDictionary, samples: Samples) -> None:
        self._axis = axis
        self._objects = objects
        self.find = objects.find
        self._samples = samples
        self._plant = samples.plant
        self._integral = 0.0
        self._speed_gains = [self.find(0x30A2, n) for n in range(1, 5)]
        self._position_gains = [self.find(0x30A1, n) for n in range(1, 6)]
        self.per_radian = samples.per_radian[axis]
        self.limit = 0.0
        """A, what may flow now"""
        self.limited = False
        self.velocity_unit = self.motor_speed_unit = self.acceleration_unit = RPM
        """rad/s for one unit of a velocity and of 0x6080, rad/s2 for one of an acceleration"""
        self.position = 0
        self.speed = 0.0
        self.position_demand = 0.0
        self.speed_demand = 0.0

    def value(self, index: int, subindex: int = 0) -> int:
        return self._objects.number(index, subindex)

    def rate(self, index: int, subindex: int = 0) -> float:
        """A speed object in increments/s."""
        return self.value(index, subindex) * self.velocity_unit * self.per_radian

    def ramp(self, index: int) -> float:
        """An acceleration object, within 0x60C5, in increments/s2."""
        return self.deceleration(min(self.value(index), self.value(0x60C5)))

    def deceleration(self, value: int) -> float:
        """An acceleration in increments/s2."""
        return value * self.acceleration_unit * self.per_radian

    @property
    def current(self) -> float:
        """A"""
        return self._plant.motor_current.item(self._axis)

    @property
    def encoder(self) -> int:
        """The encoder's own count, with an index pulse at every whole revolution."""
        return self._samples.count(self._axis)

    @property
    def revolution(self) -> int:
        return self._samples.per_revolution[self._axis]

    def start(self) -> None:
        """Begin at the present speed, position and current; the plant stands at the present."""
        self._integral = self.current
        self.limited = False
        self.measure()
        self.position_demand = float(self.position)
        self.speed_demand = self.speed

    def measure(self) -> None:
        self.position = self._samples.position(self._axis)
        self.speed = self._plant.motor_rate.item(self._axis) * self.per_radian

    def follow_speed(self, speed: float, acceleration: float = 0.0, extra: float = 0.0) -> None:
        """``extra`` ampere are added, as 0x60B2 asks."""
        self.speed_demand, self.position_demand = speed, float(self.position)
        per = _MICRO / self.per_radian
        error = (speed - self.speed) * per
        p, i, forward_speed, forward_acceleration = (gain.number for gain in self._speed_gains)
        forward = (forward_speed * speed + forward_acceleration * acceleration) * per
        self._drive(p * error + forward + extra, i * error)

    def follow_position(
        self, position: float, speed: float, acceleration: float = 0.0, extra: float = 0.0
    ) -> None:
        self.position_demand, self.speed_demand = position, speed
        per = _MICRO / self.per_radian
        error = (position - self.position) * per
        slip = (speed - self.speed) * per
        p, i, d, forward_speed, forward_acceleration = (g.number for g in self._position_gains)
        forward = (forward_speed * speed + forward_acceleration * acceleration) * per
        self._drive(p * error + d * slip + forward + extra, i * error)

    def _drive(self, direct: float, growth: float) -> None:
        current = direct + self._integral
        self.limited = abs(current) > self.limit
        if self.limited:
            # The integral waits while the current is at its limit.
            current = self.limit if current > 0.0 else -self.limit
        else:
            self._integral += growth * PERIOD
        self._plant.current_reference[self._axis] = current
