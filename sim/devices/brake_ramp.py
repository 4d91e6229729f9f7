"""A drive's controlled stop: its own velocity loop takes the motor to standstill and holds it.

Ramp: 0x6085. Loop: 0x30A2, whose units are read as uA s/rad and uA/rad, which puts the loop of the
robot's drum where its maker's tuning would. Standstill: 0x30E0. The integral begins at the present
current, so that a cable under tension is held and not let go.
"""

from __future__ import annotations

from collections.abc import Callable
from math import copysign, pi

from sim.devices.objects import ObjectDictionary
from sim.devices.samples import Measured
from sim.devices.timers import Timers

_RPM = pi / 30.0
_PERIOD_NS = 400_000
"""The EPOS4's velocity loop runs at 2.5 kHz."""
_PERIOD = _PERIOD_NS * 1e-9
_OFF = 0xFFFFFFFF
_MS_NS = 1_000_000


class BrakeRamp:
    """`start` begins; ``ended`` is called once at standstill; the motor is held until `stop`."""

    def __init__(
        self,
        axis: int,
        objects: ObjectDictionary,
        plant: Measured,
        timers: Timers,
        ended: Callable[[], None],
    ) -> None:
        self._axis = axis
        self._objects = objects
        self._plant = plant
        self._timers = timers
        self._ended = ended
        self._run = 0  # number of the present run; a timer of an older one is stale
        self.active = False

    def start(self, limit_ampere: float) -> None:
        """The plant stands at the present."""
        number = self._objects.number
        self._run += 1
        self.active = True
        self._limit = limit_ampere
        self._speed = float(self._plant.motor_rate[self._axis])
        self._integral = float(self._plant.current[self._axis])
        self._deceleration = number(0x6085, 0) * _RPM
        self._proportional = number(0x30A2, 1) * 1e-6
        self._rate = number(0x30A2, 2) * 1e-6
        window = number(0x30E0, 1)
        self._window = float("inf") if window == _OFF else window * _RPM
        self._window_ns = number(0x30E0, 2) * _MS_NS
        self._timeout_ns = number(0x30E0, 3) * _MS_NS
        self._still_ns = 0
        self._waited_ns = 0
        self._reported = False
        self._again(self._timers.now_ns, self._run)

    def stop(self) -> None:
        self._run += 1
        self.active = False

    def _again(self, now_ns: int, run: int) -> None:
        self._timers.call_at(now_ns + _PERIOD_NS, lambda at_ns: self._step(at_ns, run))

    def _step(self, now_ns: int, run: int) -> None:
        if run != self._run:
            return
        self._plant.advance(now_ns)
        rate = float(self._plant.motor_rate[self._axis])
        change = min(self._deceleration * _PERIOD, abs(self._speed))
        self._speed -= copysign(change, self._speed)
        error = self._speed - rate
        current = self._proportional * error + self._integral
        if abs(current) <= self._limit:
            self._integral += self._rate * error * _PERIOD
        else:
            current = copysign(self._limit, current)
        self._plant.current_reference[self._axis] = current
        if not self._reported and self._speed == 0.0:
            self._waited_ns += _PERIOD_NS
            self._still_ns = self._still_ns + _PERIOD_NS if abs(rate) <= self._window else 0
            if self._still_ns >= self._window_ns or self._waited_ns >= self._timeout_ns:
                self._reported = True
                self._ended()
        if run == self._run:
            self._again(now_ns, run)
