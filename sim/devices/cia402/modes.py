"""The modes of operation in which a drive moves by itself: PPM, PVM, CSP and CSV (CiA 402).

Speeds beyond 0x6080, and in profile modes beyond 0x607F, are not driven; accelerations end at
0x60C5. With 0x60C2 above zero CSP and CSV go in a straight line from set-point to set-point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tonus.sim.devices.cia402.errors import FOLLOWING
from tonus.sim.devices.cia402.motion import FOLLOWS_COMMAND, HALT, TARGET_REACHED, UNLIMITED
from tonus.sim.devices.cia402.profile import Trapezoid
from tonus.sim.devices.cia402.servo import PERIOD, PERIOD_NS, Servo

NEW_SET_POINT = 0x0010
IMMEDIATELY = 0x0020
RELATIVE = 0x0040
ENDLESS = 0x8000
ACKNOWLEDGE = 0x1000
FOLLOWING_ERROR = 0x2000
_MS_NS = 1_000_000
Fail = Callable[[int], None]


class _Watched:
    """What the two position modes watch: following error (0x6065) and software limits (0x607D)."""

    def __init__(self, servo: Servo, fail: Fail, software_limit: int) -> None:
        """``software_limit`` is the code of that error."""
        self.bits = 0
        self._servo = servo
        self._fail = fail
        self._software_limit = software_limit

    def _lost(self, demand: float) -> bool:
        """Raises the following error; with 0x6066 fixed at 0 it trips at once."""
        window = self._servo.value(0x6065)
        if window == UNLIMITED or abs(demand - self._servo.position) <= window:
            return False
        self.bits |= FOLLOWING_ERROR
        self._fail(FOLLOWING)
        return True

    def _outside(self, target: float) -> bool:
        """Both limits at 0: there are none."""
        low, high = self._servo.value(0x607D, 1), self._servo.value(0x607D, 2)
        if low == high == 0 or low <= target <= high:
            return False
        self._fail(self._software_limit)
        return True


@dataclass(frozen=True)
class _SetPoint:
    target: float
    speed: float
    up: float
    down: float


class ProfilePosition(_Watched):
    """Bit 4 takes a set-point over; one more may wait behind the one on its way. Relative targets
    count from the last set-point. Endless: at profile speed in the target's direction."""

    def __init__(self, servo: Servo, fail: Fail, software_limit: int) -> None:
        super().__init__(servo, fail, software_limit)
        self._profile = Trapezoid()

    def start(self, word: int) -> None:
        self.word = word
        self._profile.place(float(self._servo.position), self._servo.speed)
        self._now: _SetPoint | None = None
        self._next: _SetPoint | None = None
        self._last = float(self._servo.position)
        self._inside_ns = 0
        self._down = self._servo.ramp(0x6084)
        self.bits = 0

    def controlword(self, word: int) -> None:
        new = word & ~self.word & NEW_SET_POINT
        self.word = word
        if new:
            self._take(word)
        self._acknowledge()

    def _take(self, word: int) -> None:
        value, rate = self._servo.value, self._servo.rate
        if not word & IMMEDIATELY and self._now is not None and self._next is not None:
            return  # no room: the acknowledge is still there from the last one
        target = float(value(0x607A))
        if word & RELATIVE:
            target += self._last
        if word & ENDLESS:
            target = float("inf") if value(0x607A) >= 0 else float("-inf")
        elif self._outside(target):
            return
        speed = min(rate(0x6081), rate(0x607F), rate(0x6080))
        ramp = self._servo.ramp
        point = _SetPoint(target, speed, ramp(0x6083), ramp(0x6084))
        if word & IMMEDIATELY or self._now is None:
            self._begin(point)
            self._next = None
        else:
            self._next = point
        self._last = self._profile.position if word & ENDLESS else target
        self.bits |= ACKNOWLEDGE

    def _begin(self, point: _SetPoint) -> None:
        self._now = point
        self._down = point.down
        self._inside_ns = 0
        self.bits &= ~TARGET_REACHED

    def _acknowledge(self) -> None:
        if not self.word & NEW_SET_POINT and self._next is None:
            self.bits &= ~ACKNOWLEDGE

    def step(self) -> None:
        profile, point = self._profile, self._now
        if self.word & HALT:
            self._show(profile.to_speed(0.0, self._down, self._down, PERIOD))
        elif point is None:
            profile.to_speed(0.0, self._down, self._down, PERIOD)
        elif abs(point.target) == float("inf"):
            speed = point.speed if point.target > 0.0 else -point.speed
            profile.to_speed(speed, point.up, point.down, PERIOD)
            self._show(False)
        elif not profile.to_position(point.target, point.speed, point.up, point.down, PERIOD):
            self._show(False)
        elif self._next is not None:
            self._begin(self._next)
            self._next = None
            self._acknowledge()
        elif self._settled(point.target):
            self._show(True)
            self._now = None  # a set-point that comes now begins at once
        if not self._lost(profile.position):
            self._servo.follow_position(profile.position, profile.speed, profile.acceleration)

    def _settled(self, target: float) -> bool:
        """The position window, 0x6067 for the time 0x6068."""
        window = self._servo.value(0x6067)
        near = window == UNLIMITED or abs(target - self._servo.position) <= window
        self._inside_ns = self._inside_ns + PERIOD_NS if near else 0
        return near and self._inside_ns > self._servo.value(0x6068) * _MS_NS

    def _show(self, reached: bool) -> None:
        self.bits = self.bits | TARGET_REACHED if reached else self.bits & ~TARGET_REACHED


class ProfileVelocity:
    """Ramps to 0x60FF; target reached when the ramp has ended."""

    def __init__(self, servo: Servo) -> None:
        self.bits = 0
        self._servo = servo
        self._profile = Trapezoid()

    def start(self, word: int) -> None:
        self.word = word
        self._profile.place(0.0, self._servo.speed)
        self.bits = 0

    def controlword(self, word: int) -> None:
        self.word = word

    def step(self) -> None:
        servo, profile = self._servo, self._profile
        top = min(servo.rate(0x607F), servo.rate(0x6080))
        wanted = 0.0 if self.word & HALT else min(max(servo.rate(0x60FF), -top), top)
        reached = profile.to_speed(wanted, servo.ramp(0x6083), servo.ramp(0x6084), PERIOD)
        self.bits = TARGET_REACHED if reached else 0
        servo.follow_speed(profile.speed, profile.acceleration)


class Interpolation:
    """Set-points as the drive sees them: each held, or joined by straight lines."""

    def __init__(self) -> None:
        self.value = 0.0
        self.slope = 0.0
        """per second"""
        self._goal = 0.0
        self._left = 0
        self._came = False

    def start(self, value: float) -> None:
        self.value = self._goal = value
        self.slope = 0.0
        self._left = 0

    def received(self) -> None:
        """A set-point has come, perhaps equal to the last."""
        self._came = True

    def step(self, target: float, period_ms: int) -> float:
        """With a period a line begins at the value of now when a set-point comes."""
        came, self._came = self._came, False
        if period_ms == 0:
            self.value, self.slope, self._left = target, 0.0, 0
            return target
        if came or (target != self._goal and self._left == 0):
            self._goal = target
            self._left = max(1, period_ms * _MS_NS // PERIOD_NS)
            self.slope = (target - self.value) / (self._left * PERIOD)
        if self._left > 0:
            self._left -= 1
            self.value += self.slope * PERIOD
            if self._left == 0:
                self.value = self._goal
        else:
            self.slope = 0.0
        return self.value


class CyclicPosition(_Watched):
    """0x607A plus 0x60B0 is the demanded position; 0x60B1 and 0x60B2 are fed forward."""

    def __init__(
        self, servo: Servo, fail: Fail, software_limit: int, ampere: Callable[[int], float]
    ) -> None:
        """``ampere`` turns per mille of the rated torque into a current."""
        super().__init__(servo, fail, software_limit)
        self._ampere = ampere
        self.interpolation = Interpolation()

    def start(self, word: int) -> None:
        del word
        self.interpolation.start(float(self._servo.position))
        self.bits = FOLLOWS_COMMAND

    def controlword(self, word: int) -> None:
        """CSP has no bits of its own."""

    def step(self) -> None:
        servo, line = self._servo, self.interpolation
        target = float(servo.value(0x607A) + servo.value(0x60B0))
        if self._outside(target):
            return
        position = line.step(target, servo.value(0x60C2, 1))
        if not self._lost(position):
            speed = line.slope + servo.rate(0x60B1)
            servo.follow_position(position, speed, 0.0, self._ampere(servo.value(0x60B2)))


class CyclicVelocity:
    """0x60FF plus 0x60B1 is the demanded speed; 0x60B2 is fed forward."""

    def __init__(self, servo: Servo, ampere: Callable[[int], float]) -> None:
        self.bits = 0
        self._servo = servo
        self._ampere = ampere
        self.interpolation = Interpolation()

    def start(self, word: int) -> None:
        del word
        self.interpolation.start(self._servo.speed)
        self.bits = FOLLOWS_COMMAND

    def controlword(self, word: int) -> None:
        """CSV has no bits of its own."""

    def step(self) -> None:
        servo = self._servo
        top = servo.rate(0x6080)
        target = min(max(servo.rate(0x60FF) + servo.rate(0x60B1), -top), top)
        speed = self.interpolation.step(target, servo.value(0x60C2, 1))
        extra = self._ampere(servo.value(0x60B2))
        servo.follow_speed(speed, self.interpolation.slope, extra)
