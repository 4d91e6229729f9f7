"""Homing mode: the methods of 0x60E3 (CiA 402 numbers; the negative ones are the maker's).

A search goes to a switch, or until the current says that the motor is at a stop (0x30B2), at
0x6099:1. At 0x6099:2 it goes back off the switch, and on to the next index pulse where the method
has one. From there the motor moves by 0x30B1, and where it ends is called 0x30B0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from tonus.sim.devices.cia402.motion import HALT, TARGET_REACHED
from tonus.sim.devices.cia402.profile import Trapezoid
from tonus.sim.devices.cia402.servo import PERIOD, Servo
from tonus.sim.devices.cia402.terminals import Function, Terminals

START = 0x0010
ATTAINED = 0x1000
HERE = 37
"""The method that does not move."""


@dataclass(frozen=True)
class Method:
    """``search``: the direction to go at first. ``mark``: the switch, or None with ``stop`` for a
    mechanical stop. ``back``: the direction in which the switch is left."""

    search: int
    mark: Function | None = None
    stop: bool = False
    back: int = 0
    index: bool = False


_N, _P, _H = Function.NEGATIVE_LIMIT, Function.POSITIVE_LIMIT, Function.HOME
METHODS = {
    1: Method(-1, _N, back=1, index=True),
    2: Method(1, _P, back=-1, index=True),
    7: Method(1, _H, back=-1, index=True),
    11: Method(-1, _H, back=1, index=True),
    17: Method(-1, _N, back=1),
    18: Method(1, _P, back=-1),
    23: Method(1, _H, back=-1),
    27: Method(-1, _H, back=1),
    33: Method(-1, index=True),
    34: Method(1, index=True),
    -1: Method(1, stop=True, back=-1, index=True),
    -2: Method(-1, stop=True, back=1, index=True),
    -3: Method(1, stop=True, back=-1),
    -4: Method(-1, stop=True, back=1),
}


class _Phase(Enum):
    IDLE = 0
    SEARCH = 1
    LEAVE = 2
    INDEX = 3
    OFFSET = 4
    DONE = 5


class Homing:
    def __init__(
        self, servo: Servo, terminals: Terminals, referenced: Callable[[int], None]
    ) -> None:
        """``referenced`` is told what the present position is called from now on."""
        self.bits = 0
        self._servo = servo
        self._terminals = terminals
        self._referenced = referenced
        self._profile = Trapezoid()

    def start(self, word: int) -> None:
        self.word = word
        self._phase = _Phase.IDLE
        self._profile.place(float(self._servo.position), self._servo.speed)
        self.bits = TARGET_REACHED

    def controlword(self, word: int) -> None:
        begins = word & ~self.word & START
        self.word = word
        if begins:
            self._begin()
        elif not word & START and self._phase not in (_Phase.IDLE, _Phase.DONE):
            self._phase = _Phase.IDLE  # taking the bit away ends it

    def _begin(self) -> None:
        value = self._servo.value
        number = value(0x6098)
        self.bits = 0
        if number == HERE:
            self._target = self._servo.position
            self._finish()
            return
        self._method = METHODS[number]
        self._direction = self._method.search
        self._fast, self._slow = self._servo.rate(0x6099, 1), self._servo.rate(0x6099, 2)
        self._ramp = self._servo.ramp(0x609A)
        if self._method.mark is None and not self._method.stop:
            self._to_index()
        elif self._method.mark is not None and self._terminals.active(self._method.mark):
            self._leave()
        else:
            self._phase = _Phase.SEARCH

    def _leave(self) -> None:
        """Back over the mark, which the motor may have run past while it slowed down."""
        self._phase = _Phase.LEAVE
        self._direction = self._method.back
        self._on_mark = False

    def _to_index(self) -> None:
        self._phase = _Phase.INDEX
        self._turn = self._servo.encoder // self._servo.revolution

    def _found(self) -> None:
        """The motor is at the mark; the offset counts from here."""
        self._phase = _Phase.OFFSET
        self._target = self._servo.position + self._servo.value(0x30B1)

    def _finish(self) -> None:
        self._phase = _Phase.DONE
        self.bits = ATTAINED | TARGET_REACHED
        shift = self._servo.value(0x30B0) - self._target
        self._referenced(self._servo.position + shift)
        self._servo.measure()
        self._profile.place(self._profile.position + shift, self._profile.speed)

    def step(self) -> None:
        profile = self._profile
        if self._phase in (_Phase.IDLE, _Phase.DONE) or self.word & HALT:
            ramp = self._servo.ramp(0x609A)
            still = profile.to_speed(0.0, ramp, ramp, PERIOD)
            if self._phase is not _Phase.DONE:
                self.bits = TARGET_REACHED if still else 0
        elif self._phase is _Phase.OFFSET:
            self.bits = 0
            if profile.to_position(self._target, self._fast, self._ramp, self._ramp, PERIOD):
                self._finish()
        else:
            self.bits = 0
            self._look()
            speed = self._fast if self._phase is _Phase.SEARCH else self._slow
            profile.to_speed(speed * self._direction, self._ramp, self._ramp, PERIOD)
        self._servo.follow_position(profile.position, profile.speed, profile.acceleration)

    def _look(self) -> None:
        """For the mark of the present phase."""
        method, active = self._method, self._terminals.active
        if self._phase is _Phase.SEARCH:
            if method.stop:
                if abs(self._servo.current) * 1e3 >= self._servo.value(0x30B2):
                    self._at_the_stop()
            elif method.mark is not None and active(method.mark):
                self._leave()
            elif active(_P if self._direction > 0 else _N):
                self._direction = -self._direction  # the home switch is the other way
        elif self._phase is _Phase.LEAVE:
            if method.mark is not None and self._servo.speed * self._direction > 0.0:
                left = self._on_mark and not active(method.mark)
                self._on_mark = active(method.mark)
                if left:
                    self._passed()
        elif self._servo.encoder // self._servo.revolution != self._turn:
            self._found()

    def _at_the_stop(self) -> None:
        self._profile.place(float(self._servo.position))
        self._direction = self._method.back
        self._passed()

    def _passed(self) -> None:
        """Off the switch, or at the stop."""
        if self._method.index:
            self._to_index()
        else:
            self._found()
