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

from runtime.clock import Stopwatch, loop_clock
from runtime.errors import SchedulingError

_CLOCK_MONOTONIC = 1
_TFD_TIMER_ABSTIME = 1


@dataclass
class Misses:
    """Missed ticks by cause.

    ``host``: the wake-up itself, or the processor within the tick, came more than half a period
    late though we asked in time. ``own``: our computation overran.
    """

    own: int = 0
    host: int = 0


class Pacing(Protocol):
    """What a tick waits for."""

    async def until(self, due_ns: int) -> None: ...

    def steer(self, due_ns: int) -> int:
        """ns by which the tick that is due then, and all after it, are moved."""

    def close(self) -> None: ...


class VirtualPacing:
    """The next tick is when virtual time says so."""

    async def until(self, due_ns: int) -> None:
        loop = asyncio.get_running_loop()
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

    asyncio's own timers are rounded up to the millisecond by epoll.
    """

    def __init__(self) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        flags = os.O_NONBLOCK | os.O_CLOEXEC
        self._descriptor = self._libc.timerfd_create(_CLOCK_MONOTONIC, flags)
        if self._descriptor < 0:
            raise SchedulingError(f"timerfd_create: {os.strerror(ctypes.get_errno())}")
        self._waiting: asyncio.Future[None] | None = None
        self._spec = ctypes.create_string_buffer(32)
        asyncio.get_running_loop().add_reader(self._descriptor, self._expired)

    async def until(self, due_ns: int) -> None:
        self._waiting = asyncio.get_running_loop().create_future()
        struct.pack_into("qqqq", self._spec, 0, 0, 0, *divmod(due_ns, 1_000_000_000))
        if self._libc.timerfd_settime(self._descriptor, _TFD_TIMER_ABSTIME, self._spec, None):
            raise SchedulingError(f"timerfd_settime: {os.strerror(ctypes.get_errno())}")
        await self._waiting

    def steer(self, due_ns: int) -> int:
        del due_ns
        return 0

    def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self._descriptor)
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
        self.wakeup_ns = 0
        """how late the present tick started"""
        self._start_ns = start_ns
        self._pacing = pacing
        self._stopwatch = stopwatch
        self._now_ns = loop_clock()
        self._tick = -1
        self._began_ns = start_ns
        self._began_processor_ns = 0

    def due_ns(self, tick: int) -> int:
        return self._start_ns + tick * self.period_ns

    async def next(self) -> int:
        """Wait for the next tick, count those that went by, and return the one to run."""
        finished_ns = self._now_ns()
        processor_ns = self._stopwatch.processor_ns() - self._began_processor_ns
        wanted = self._tick + 1
        due = self.due_ns(wanted)
        moved = self._pacing.steer(due)
        if moved:
            self._start_ns += moved
            due += moved
        if finished_ns < due:
            await self._pacing.until(due)
        now = self._now_ns()
        missed = (now - due) // self.period_ns
        if missed > 0:
            self._count(int(missed), now, due, finished_ns, processor_ns)
            wanted += int(missed)
            due = self.due_ns(wanted)
        self._tick = wanted
        self.wakeup_ns = now - due
        self._began_ns = now
        self._began_processor_ns = self._stopwatch.processor_ns()
        return wanted

    def close(self) -> None:
        self._pacing.close()

    def _count(self, missed: int, now: int, due: int, finished_ns: int, processor_ns: int) -> None:
        """Late wake-up: asked in time, woken late. Stolen: the tick took long on the wall's clock
        but not on the processor's. Anything else is ours."""
        half = self.period_ns // 2
        woken_late = now - max(due, finished_ns) > half
        stolen = (finished_ns - self._began_ns) - processor_ns > half
        if woken_late or stolen:
            self.misses.host += missed
        else:
            self.misses.own += missed
