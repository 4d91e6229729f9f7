"""The distributed clocks of slaves: local time, system time, drift, and when SYNC0 comes.

All of a segment stand in one table, because every cycle concerns each of them.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]

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
NEVER = 1 << 62
_LOCAL, _SINCE, _COMPARED, _OFFSET, _DELAY, _DIFFERENCE = range(6)
_ACTIVE, _CYCLE, _NEXT, _PULSES = range(6, 10)
_COLUMNS = 10
"""Columns of the table: local time, when it was that, when it was last compared, and registers; of
SYNC0, whether it comes, its registers, and how often it came. Times of 64 bits are kept as signed
ones, whose differences wrap as they should."""
_DRIFT, _CORRECTION = range(2)


def _signed(time: int) -> int:
    return (time + _HALF & _MASK) - _HALF


@njit("int64(int64[::1], float64[::1], int64)", cache=True)
def _shown(clock: Integers, speed: Floats, now_ns: int) -> int:
    """Local time."""
    passed = now_ns - clock[_SINCE]
    share = speed[_DRIFT] + speed[_CORRECTION]
    return int(clock[_LOCAL] + passed + int(np.rint(passed * share)))


@njit("int64(int64[::1], float64[::1], int64, int64)", cache=True)
def _when(clock: Integers, speed: Floats, system: int, now_ns: int) -> int:
    """The lab's time at which the system time will be ``system``, as things stand."""
    left = system - (_shown(clock, speed, now_ns) + clock[_OFFSET])
    away = np.rint(left / (1.0 + (speed[_DRIFT] + speed[_CORRECTION])))
    return int(now_ns + int(min(max(away, -float(NEVER)), float(NEVER))))


@njit("void(int64[::1], float64[::1], int64, int64)", cache=True)
def _compare(clock: Integers, speed: Floats, reference: int, now_ns: int) -> None:
    local = _shown(clock, speed, now_ns)
    difference = local + clock[_OFFSET] - reference - clock[_DELAY]
    passed = max(now_ns - clock[_COMPARED], _LEAST_NS)
    step = int(difference / _PHASE)
    step = min(step, passed // _SLEW)
    step = max(step, -passed // _SLEW)
    correction = speed[_CORRECTION] - difference / _RATE / passed
    speed[_CORRECTION] = min(max(correction, -_SPEED_LIMIT), _SPEED_LIMIT)
    clock[_SINCE] = clock[_COMPARED] = now_ns
    clock[_LOCAL] = local - step
    clock[_DIFFERENCE] = difference


@njit(
    "int64(int64[:, ::1], float64[:, ::1], int64[::1], boolean[::1], int64[::1], int64, int64)",
    cache=True,
)
def _pass_time(
    clocks: Integers,
    speeds: Floats,
    rows: Integers,
    refers: NDArray[np.bool_],
    arrivals: Integers,
    time: int,
    now_ns: int,
) -> int:
    for i in range(rows.shape[0]):
        clock, speed, at_ns = clocks[rows[i]], speeds[rows[i]], now_ns + arrivals[i]
        if refers[i]:
            time = _shown(clock, speed, at_ns) + clock[_OFFSET]
        elif time:
            _compare(clock, speed, time, at_ns)
    return time


@njit("int64(int64[:, ::1], float64[:, ::1], int64, int64, int64[::1])", cache=True)
def _due(clocks: Integers, speeds: Floats, now_ns: int, limit_ns: int, due: Integers) -> int:
    count = 0
    for row in range(clocks.shape[0]):
        clock = clocks[row]
        if clock[_ACTIVE] and _when(clock, speeds[row], clock[_NEXT], now_ns) <= limit_ns:
            due[count] = row
            count += 1
    return count


@njit("int64(int64[:, ::1], float64[:, ::1], int64)", cache=True)
def _next_pulse(clocks: Integers, speeds: Floats, now_ns: int) -> int:
    first = NEVER
    for row in range(clocks.shape[0]):
        clock = clocks[row]
        if not clock[_ACTIVE]:
            continue
        at_ns = _when(clock, speeds[row], clock[_NEXT], now_ns)
        if at_ns < now_ns - clock[_CYCLE]:
            clock[_ACTIVE] = 0  # the time was set past it
        else:
            first = min(first, at_ns)
    return first


@njit("void(int64[:, ::1], int64[::1])", cache=True)
def _pulse(clocks: Integers, rows: Integers) -> None:
    for i in range(rows.shape[0]):
        clock = clocks[rows[i]]
        clock[_PULSES] += 1
        clock[_NEXT] += clock[_CYCLE]


class ClockTable:
    """A row for each slave: its clock and its SYNC0."""

    def __init__(self, rows: int) -> None:
        self.clocks = np.zeros((rows, _COLUMNS), np.int64)
        self.speeds = np.zeros((rows, 2))
        self._rows = np.zeros(rows, np.int64)

    def pass_time(
        self,
        rows: Integers,
        refers: NDArray[np.bool_],
        arrivals: Integers,
        time: int,
        now_ns: int,
    ) -> int:
        """A system time passes the clocks of ``rows``, at each so much later than ``now_ns``: those
        that it ``refers`` to put their own in its place, all others compare themselves with it,
        unless it is 0. Returns what comes out."""
        signed = _pass_time(self.clocks, self.speeds, rows, refers, arrivals, _signed(time), now_ns)
        return int(signed) & _MASK

    def due(self, now_ns: int, limit_ns: int) -> list[int]:
        """The rows whose SYNC0 comes by then, as it seems now."""
        count = _due(self.clocks, self.speeds, now_ns, limit_ns, self._rows)
        rows: list[int] = self._rows[:count].tolist()
        return rows

    def next_pulse(self, now_ns: int) -> int:
        """When the next SYNC0 comes, as it seems now, or `NEVER`. One that time has been set past
        by more than its cycle never comes again."""
        return int(_next_pulse(self.clocks, self.speeds, now_ns))

    def pulse(self, rows: Integers) -> None:
        """`SyncUnit.pulse` of these."""
        _pulse(self.clocks, rows)


class _Row:
    """Of a table of one's own, until it is moved into that of a segment."""

    def __init__(self) -> None:
        self._sit(ClockTable(1), 0)

    def _sit(self, table: ClockTable, row: int) -> None:
        self._clock, self._speed = table.clocks[row], table.speeds[row]
        # Python reads and writes single words of a memoryview in a third of an array's time.
        self._words: memoryview[int] = self._clock.data


class DistributedClock(_Row):
    """All times in ns. ``drift``: how much faster than the lab's clock it runs, as a share;
    ``origin``: what it shows at switch-on."""

    def __init__(self, drift: float, origin: int) -> None:
        super().__init__()
        self._origin = origin
        self._speed[_DRIFT] = drift
        self.restart(0)

    def move(self, table: ClockTable, row: int) -> None:
        """Into another table, with all that is in its columns."""
        table.clocks[row, :_ACTIVE] = self._clock[:_ACTIVE]
        table.speeds[row] = self._speed
        self._sit(table, row)

    def restart(self, now_ns: int) -> None:
        """As at switch-on."""
        self._clock[:_ACTIVE] = 0
        self._words[_LOCAL] = self._origin
        self._words[_SINCE] = self._words[_COMPARED] = now_ns
        self.forget()

    @property
    def drift(self) -> float:
        return float(self._speed[_DRIFT])

    @property
    def offset(self) -> int:
        return self._words[_OFFSET] & _MASK

    @offset.setter
    def offset(self, offset: int) -> None:
        self._words[_OFFSET] = _signed(offset)

    @property
    def delay(self) -> int:
        return self._words[_DELAY]

    @delay.setter
    def delay(self, delay: int) -> None:
        self._words[_DELAY] = delay

    @property
    def difference(self) -> int:
        """Own time less the reference's, at the last comparison."""
        return self._words[_DIFFERENCE]

    def local(self, now_ns: int) -> int:
        return int(_shown(self._clock, self._speed, now_ns))

    def system(self, now_ns: int) -> int:
        return self.local(now_ns) + self._words[_OFFSET] & _MASK

    def when(self, system: int, now_ns: int) -> int:
        """The lab's time at which the system time will be ``system``, as things stand."""
        return int(_when(self._clock, self._speed, _signed(system), now_ns))

    def change_drift(self, drift: float, now_ns: int) -> None:
        """Run at another speed from now on."""
        self._words[_LOCAL] = self.local(now_ns)
        self._words[_SINCE] = now_ns
        self._speed[_DRIFT] = drift

    def forget(self) -> None:
        """Begin the comparison with the reference anew."""
        self._speed[_CORRECTION] = 0.0

    def compare(self, reference: int, now_ns: int) -> None:
        """The reference clock's time has come by, and is to be followed."""
        _compare(self._clock, self._speed, _signed(reference), now_ns)


class SyncUnit(_Row):
    """SYNC0: its first time and its cycle, in system time."""

    def move(self, table: ClockTable, row: int) -> None:
        """Into another table, with all that is in its columns."""
        table.clocks[row, _ACTIVE:] = self._clock[_ACTIVE:]
        self._sit(table, row)

    def restart(self) -> None:
        self._clock[_ACTIVE:] = 0

    @property
    def active(self) -> bool:
        return self._words[_ACTIVE] != 0

    @property
    def next(self) -> int:
        """System time of the next pulse."""
        return self._words[_NEXT] & _MASK

    @property
    def pulses(self) -> int:
        return self._words[_PULSES]

    def start(self, first: int, cycle: int, system: int) -> None:
        """A start time that has passed never comes, as in a real controller."""
        words = self._words
        words[_CYCLE], words[_NEXT], words[_PULSES] = cycle, _signed(first), 0
        words[_ACTIVE] = cycle >= SHORTEST_NS and _signed(first - system) > 0

    def stop(self) -> None:
        self._words[_ACTIVE] = 0

    def jumped(self, system: int) -> None:
        """The system time was set: a pulse that it has jumped over never comes, nor those after;
        less than a cycle is caught up with."""
        if self.active and _signed(system - self.next) > self._words[_CYCLE]:
            self.stop()

    def pulse(self) -> None:
        words = self._words
        words[_PULSES] += 1
        words[_NEXT] = _signed(words[_NEXT] + words[_CYCLE])
