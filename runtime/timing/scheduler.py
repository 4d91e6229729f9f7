"""The fixed period: integer ticks on an absolute schedule, paced by a timer or by virtual time.

Tick k is due at ``start + k * period``, where a bus with a clock of its own may move ``start`` by a
little each tick. A tick whose whole period passed before it could start is
missed: it is counted and skipped, never made up by a burst.
"""

from __future__ import annotations

import asyncio
import ctypes
import os
import struct
from dataclasses import dataclass
from typing import Protocol

from tonus.runtime.errors import SchedulingError
from tonus.runtime.timing.clock import RealTimeLoop, Stopwatch, Usage, VirtualTimeLoop, loop_clock

_CLOCK_MONOTONIC = 1
_TIMER_ABSTIME = 1
_SECOND_NS = 1_000_000_000
_TIMESPEC = struct.Struct("qq")
_TIMERSPEC = struct.Struct("qqqq")


@dataclass
class Misses:
    """Missed ticks by cause.

    ``own`` would have been missed as well had the host always woken us in time and never taken the
    processor from us: what we computed, and what we waited for by our own doing, was too long.
    ``host`` are all others.
    """

    own: int = 0
    host: int = 0


@dataclass
class Disturbances:
    """What happened to the thread between the start of a tick and its end, so far."""

    page_faults: int = 0
    switches: int = 0
    """context switches: the processor taken away, or given away by something that blocks"""


class Pacing(Protocol):
    """What a tick waits for."""

    async def until(self, due_ns: int) -> int | None:
        """Returns the processor time (ns) of the thread when it had nothing left to do but wait:
        what passes from there on is the host's. None: not known."""

    def steer(self, due_ns: int) -> int:
        """ns by which the tick that is due then, and all after it, are moved."""

    def close(self) -> None: ...


class VirtualPacing:
    """The next tick is when virtual time says so."""

    _loop: asyncio.AbstractEventLoop | None = None

    async def until(self, due_ns: int) -> None:
        # Asked for once: asyncio makes a system call each time, to see that no fork came between.
        loop = self._loop = self._loop or asyncio.get_running_loop()
        # To go through the loop takes a tenth of a tick, and most often nobody else is there.
        if isinstance(loop, VirtualTimeLoop) and loop.skip(due_ns):
            return
        arrived = loop.create_future()
        loop.call_at(due_ns * 1e-9, arrived.set_result, None)
        await arrived

    def steer(self, due_ns: int) -> int:
        del due_ns
        return 0

    def close(self) -> None:
        pass


class TimerPacing:
    """A Linux timerfd armed absolutely on CLOCK_MONOTONIC and awaited through the loop.

    asyncio's own timers are rounded up to the millisecond by epoll. What the loop itself costs
    between the timer and the tick can be had out of the way: with ``early_ns`` the timer expires so
    much earlier, and the rest is slept outside of the loop, the last ``spin_ns`` of it awake.
    """

    def __init__(self, early_ns: int = 0, spin_ns: int = 0) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        flags = os.O_NONBLOCK | os.O_CLOEXEC
        self._descriptor = self._libc.timerfd_create(_CLOCK_MONOTONIC, flags)
        if self._descriptor < 0:
            raise SchedulingError(f"timerfd_create: {os.strerror(ctypes.get_errno())}")
        self._waiting: asyncio.Future[None] | None = None
        self._spec = ctypes.create_string_buffer(_TIMERSPEC.size)
        self._until = ctypes.create_string_buffer(_TIMESPEC.size)
        self._early_ns, self._spin_ns = early_ns, spin_ns
        self._now_ns = loop_clock()
        self._processor_ns = Stopwatch(running=True).processor_ns
        loop = asyncio.get_running_loop()
        assert isinstance(loop, RealTimeLoop), "a timer keeps no virtual time"
        self._loop = loop
        loop.add_reader(self._descriptor, self._expired)

    async def until(self, due_ns: int) -> int:
        self._waiting = self._loop.create_future()
        waited_ns = self._loop.waited_ns
        _TIMERSPEC.pack_into(self._spec, 0, 0, 0, *divmod(due_ns - self._early_ns, _SECOND_NS))
        if self._libc.timerfd_settime(self._descriptor, _TIMER_ABSTIME, self._spec, None):
            raise SchedulingError(f"timerfd_settime: {os.strerror(ctypes.get_errno())}")
        await self._waiting
        idle_ns = self._processor_ns() - (self._loop.waited_ns - waited_ns)
        if self._early_ns and self._now_ns() < due_ns:
            _TIMESPEC.pack_into(self._until, 0, *divmod(due_ns - self._spin_ns, _SECOND_NS))
            # A signal may end it early: what is left is then spent awake.
            self._libc.clock_nanosleep(_CLOCK_MONOTONIC, _TIMER_ABSTIME, self._until, None)
            while self._now_ns() < due_ns:
                pass
        return idle_ns

    def steer(self, due_ns: int) -> int:
        del due_ns
        return 0

    def close(self) -> None:
        self._loop.remove_reader(self._descriptor)
        os.close(self._descriptor)

    def _expired(self) -> None:
        os.read(self._descriptor, 8)
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)


class Scheduler:
    """Hands out ticks: `next` returns the number of the tick that is to run now."""

    def __init__(self, period_ns: int, start_ns: int, pacing: Pacing, stopwatch: Stopwatch) -> None:
        self.period_ns = period_ns
        self.misses = Misses()
        self.disturbances = Disturbances()
        self.wakeup_ns = 0
        """how late the present tick started"""
        self.skipped = 0
        """ticks missed between the last one and the present one"""
        self._start_ns = start_ns
        self._pacing = pacing
        self._stopwatch = stopwatch
        self._now_ns = loop_clock()
        self._tick = -1
        self._own_late_ns = 0  # how late the present tick would have started on a perfect host
        self._began_ns = start_ns
        self._began_stalled_ns = stopwatch.stalled_ns(self._now_ns())
        self._began_processor_ns = stopwatch.processor_ns()
        self._began_usage = stopwatch.usage()

    def due_ns(self, tick: int) -> int:
        return self._start_ns + tick * self.period_ns

    async def next(self) -> int:
        """Wait for the next tick, count those that went by, and return the one to run."""
        stopwatch = self._stopwatch
        finished_ns = self._now_ns()
        finished_processor_ns = stopwatch.processor_ns()
        finished_stalled_ns = stopwatch.stalled_ns(finished_ns)
        blocked = stopwatch.running and self._disturbed(stopwatch.usage())
        wanted = self._tick + 1
        due = self.due_ns(wanted)
        moved = self._pacing.steer(due)
        if moved:
            self._start_ns += moved
            due += moved
        idle_ns = None
        if finished_ns < due:
            idle_ns = await self._pacing.until(due)
        else:
            # However late we are, what else the loop has to do gets its turn.
            await asyncio.sleep(0)
        now, processor_ns = self._now_ns(), stopwatch.processor_ns()
        if blocked:
            tick_ns = finished_ns - self._began_ns
        else:
            tick_ns = finished_processor_ns - self._began_processor_ns
        tick_ns = max(tick_ns - (finished_stalled_ns - self._began_stalled_ns), 0)
        stalled_ns = stopwatch.stalled_ns(now)
        between_ns = (processor_ns if idle_ns is None else idle_ns) - finished_processor_ns
        between_ns = max(between_ns - (stalled_ns - finished_stalled_ns), 0)
        # What the loop did between the ticks may all have been after the due time: that counts
        # against us, and no more than we are late. The processor's clock runs on while a hypervisor
        # keeps a thread that waits awake from running.
        late_ns = max(self._own_late_ns + tick_ns - self.period_ns, 0) + between_ns
        self._own_late_ns = min(late_ns, max(now - due, 0))
        self.skipped = max(int((now - due) // self.period_ns), 0)
        if self.skipped:
            own = min(self._own_late_ns // self.period_ns, self.skipped)
            self._own_late_ns -= own * self.period_ns
            self.misses.own += own
            self.misses.host += self.skipped - own
            wanted += self.skipped
            due = self.due_ns(wanted)
        self._tick = wanted
        self.wakeup_ns = now - due
        self._began_ns, self._began_processor_ns = now, processor_ns
        self._began_stalled_ns = stalled_ns
        self._began_usage = stopwatch.usage()
        return wanted

    def close(self) -> None:
        self._pacing.close()

    def _disturbed(self, usage: Usage) -> bool:
        """Count what happened within the tick that has just ended; whether it waited by its own
        doing, for a disk or a lock."""
        before, found = self._began_usage, self.disturbances
        given = usage.ru_nvcsw - before.ru_nvcsw
        found.switches += given + usage.ru_nivcsw - before.ru_nivcsw
        found.page_faults += usage.ru_minflt - before.ru_minflt + usage.ru_majflt - before.ru_majflt
        return given > 0
