"""The distributed clock of a slave: local time, system time, drift, and when SYNC0 comes."""

from __future__ import annotations

_PHASE = 8
"""A difference to the reference clock is taken back by this part at each comparison ..."""
_RATE = 64
"""... and by this part of it, over the time since the last one, the rate is changed."""
_LEAST_NS = 100_000
"""Comparisons in quick succession say nothing about the rate."""
_SPEED_LIMIT = 5e-3
_SLEW = 10
"""A clock runs by a tenth faster or slower at most while it takes a difference back."""
SHORTEST_NS = 50_000
"""Cycle of SYNC0 that a slave can follow; a drive's current loop takes 40 us."""
_MASK = (1 << 64) - 1
_HALF = 1 << 63


def _less(one: int, other: int) -> int:
    """The difference of two 64-bit times, either sign."""
    return (one - other + _HALF & _MASK) - _HALF


class DistributedClock:
    """All times in ns. ``drift``: how much faster than the lab's clock it runs, as a share;
    ``origin``: what it shows at switch-on."""

    def __init__(self, drift: float, origin: int) -> None:
        self.drift = drift
        self._origin = origin
        self.restart(0)

    def restart(self, now_ns: int) -> None:
        """As at switch-on."""
        self._since_ns = now_ns
        self._local = self._origin
        self._correction = 0.0
        self._compared_ns = now_ns
        self.offset = 0
        self.delay = 0
        self.difference = 0
        """own time less the reference's, at the last comparison"""

    @property
    def _speed(self) -> float:
        return self.drift + self._correction

    def local(self, now_ns: int) -> int:
        passed = now_ns - self._since_ns
        return self._local + passed + round(passed * self._speed)

    def system(self, now_ns: int) -> int:
        return self.local(now_ns) + self.offset & _MASK

    def when(self, system: int, now_ns: int) -> int:
        """The lab's time at which the system time will be ``system``, as things stand."""
        # As `system`, and written out like `compare`: every slave is asked in every cycle.
        passed, speed = now_ns - self._since_ns, self.drift + self._correction
        shown = self._local + passed + round(passed * speed) + self.offset
        left = (system - shown + _HALF & _MASK) - _HALF
        return now_ns + round(left / (1.0 + speed))

    def change_drift(self, drift: float, now_ns: int) -> None:
        """Run at another speed from now on."""
        self._rebase(now_ns)
        self.drift = drift

    def _rebase(self, now_ns: int) -> None:
        self._local, self._since_ns = self.local(now_ns), now_ns

    def forget(self) -> None:
        """Begin the comparison with the reference anew."""
        self._correction = 0.0

    def compare(self, reference: int, now_ns: int) -> None:
        """The reference clock's time has come by, and is to be followed."""
        passed, correction = now_ns - self._since_ns, self._correction
        local = self._local + passed + round(passed * (self.drift + correction))
        difference = (local + self.offset - reference - self.delay + _HALF & _MASK) - _HALF
        passed = now_ns - self._compared_ns
        if passed < _LEAST_NS:
            passed = _LEAST_NS
        step = int(difference / _PHASE)
        if step > passed // _SLEW:
            step = passed // _SLEW
        elif step < -passed // _SLEW:
            step = -passed // _SLEW
        correction -= difference / _RATE / passed
        if correction > _SPEED_LIMIT:
            correction = _SPEED_LIMIT
        elif correction < -_SPEED_LIMIT:
            correction = -_SPEED_LIMIT
        self._since_ns = self._compared_ns = now_ns
        self._local, self._correction, self.difference = local - step, correction, difference


class SyncUnit:
    """SYNC0: its first time and its cycle, in system time."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        self.active = False
        self.cycle = 0
        self.next = 0
        """system time of the next pulse"""
        self.pulses = 0

    def start(self, first: int, cycle: int, system: int) -> None:
        """A start time that has passed never comes, as in a real controller."""
        self.cycle = cycle
        self.next = first
        self.pulses = 0
        self.active = cycle >= SHORTEST_NS and _less(first, system) > 0

    def stop(self) -> None:
        self.active = False

    def jumped(self, system: int) -> None:
        """The system time was set: a pulse that it has jumped over never comes, nor those after;
        less than a cycle is caught up with."""
        if self.active and _less(system, self.next) > self.cycle:
            self.active = False

    def pulse(self) -> None:
        self.pulses += 1
        self.next = self.next + self.cycle & _MASK
