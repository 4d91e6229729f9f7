"""What a drive does itself, 2500 times a second, in every mode but cyclic synchronous torque."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from tonus.sim.devices.cia402.profile import Trapezoid
from tonus.sim.devices.cia402.servo import PERIOD, PERIOD_NS, Servo
from tonus.sim.devices.samples import Measured
from tonus.sim.devices.timers import Timers

TARGET_REACHED = 0x0400
FOLLOWS_COMMAND = 0x1000
HALT = 0x0100
UNLIMITED = 0xFFFFFFFF
_MS_NS = 1_000_000


class Task(Protocol):
    """One way of moving. ``bits``: what it shows in the statusword."""

    bits: int

    def start(self, word: int) -> None:
        """Take the motor over as it moves now; ``word``: the present controlword."""

    def controlword(self, word: int) -> None:
        """A controlword that differs from the last one."""

    def step(self) -> None:
        """Move on by `PERIOD`."""


class Braking:
    """Slow down with a ramp and hold the motor; ``ended`` is called once at standstill (0x30E0)."""

    def __init__(self, servo: Servo, ended: Callable[[], None]) -> None:
        self.bits = 0
        self.ramp = 0x6085
        """the object with the deceleration"""
        self._servo = servo
        self._ended = ended
        self._profile = Trapezoid()

    def start(self, word: int) -> None:
        del word
        value = self._servo.value
        self._profile.place(0.0, self._servo.speed)
        self._deceleration = self._servo.deceleration(value(self.ramp))
        window = value(0x30E0, 1)
        unit = self._servo.velocity_unit * self._servo.per_radian
        self._window = float("inf") if window == UNLIMITED else window * unit
        self._window_ns = value(0x30E0, 2) * _MS_NS
        self._timeout_ns = value(0x30E0, 3) * _MS_NS
        self._still_ns = self._waited_ns = 0
        self._reported = False

    def controlword(self, word: int) -> None:
        """Nothing in it concerns a stop."""

    def step(self) -> None:
        servo, profile = self._servo, self._profile
        stopped = profile.to_speed(0.0, self._deceleration, self._deceleration, PERIOD)
        servo.follow_speed(profile.speed)
        if self._reported or not stopped:
            return
        self._waited_ns += PERIOD_NS
        self._still_ns = self._still_ns + PERIOD_NS if abs(servo.speed) <= self._window else 0
        if self._still_ns >= self._window_ns or self._waited_ns >= self._timeout_ns:
            self._reported = True
            self._ended()


class Motion:
    """Runs one task at a time; ``changed`` is called when its statusword bits have changed."""

    def __init__(
        self, servo: Servo, plant: Measured, timers: Timers, changed: Callable[[], None]
    ) -> None:
        self._servo = servo
        self._plant = plant
        self._timers = timers
        self._changed = changed
        self._run = 0  # number of the present run; a timer of an older one is stale
        self._shown = (0, False)
        self.task: Task | None = None

    @property
    def bits(self) -> int:
        return self.task.bits if self.task is not None else 0

    @property
    def limited(self) -> bool:
        return self.task is not None and self._servo.limited

    def run(self, task: Task, word: int = 0) -> None:
        """The plant stands at the present."""
        self._run += 1
        self._servo.start()
        self.task = task
        task.start(word)
        self._again(self._timers.now_ns, self._run)

    def stop(self) -> None:
        self._run += 1
        self.task = None

    def _again(self, now_ns: int, run: int) -> None:
        self._timers.call_at(now_ns + PERIOD_NS, lambda at_ns: self._step(at_ns, run))

    def _step(self, now_ns: int, run: int) -> None:
        if run != self._run or self.task is None:
            return
        self._plant.advance(now_ns)
        self._servo.measure()
        self.task.step()
        if run != self._run:
            return
        shown = (self.task.bits, self._servo.limited)
        if shown != self._shown:
            self._shown = shown
            self._changed()
        self._again(now_ns, run)
