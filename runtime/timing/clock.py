"""The only file that reads a clock: two event loops, one in real time and one in virtual time.

Both offer `loop.time()` in seconds; `now_ns` gives the same instant as an integer. In virtual time
the loop never waits: with nothing ready it jumps to the next timer, so a run takes as long as its
computation and nothing in it can depend on how fast the machine is.
"""

from __future__ import annotations

import asyncio
import heapq
import os
import resource
import selectors
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

Result = TypeVar("Result")
Clock = Callable[[], int]
"""Returns nanoseconds."""


class _Waits(selectors.EpollSelector):
    """Counts what the thread's clock shows of its waits. Under some kernels that clock runs from
    the event on that ends a wait, while another task still has the processor."""

    def __init__(self) -> None:
        super().__init__()
        self.processor_ns = 0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if timeout is not None and timeout <= 0.0:
            return super().select(timeout)
        began = time.thread_time_ns()
        found = super().select(timeout)
        self.processor_ns += time.thread_time_ns() - began
        return found


class RealTimeLoop(asyncio.SelectorEventLoop):
    """An ordinary loop on CLOCK_MONOTONIC."""

    def __init__(self) -> None:
        self._waits = _Waits()
        super().__init__(self._waits)

    def now_ns(self) -> int:
        return time.monotonic_ns()

    @property
    def waited_ns(self) -> int:
        """Processor time (ns) of its thread so far that passed while it waited for an event."""
        return self._waits.processor_ns


class _NeverWaits(selectors.SelectSelector):
    """Reports what is ready and returns at once, whatever timeout is asked for."""

    def __init__(self) -> None:
        super().__init__()
        self.idle_for: float | None = 0.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        self.idle_for = timeout
        return []


class VirtualTimeLoop(asyncio.SelectorEventLoop):
    """A loop whose time starts at zero and jumps from timer to timer.

    File descriptors are not watched: input from outside would make a run depend on the outside.
    A loop that waits for something which can never come raises instead of hanging.
    """

    def __init__(self) -> None:
        self._virtual_ns = 0
        super().__init__(_NeverWaits())

    def now_ns(self) -> int:
        return self._virtual_ns

    def time(self) -> float:
        return self._virtual_ns * 1e-9

    def skip(self, to_ns: int) -> bool:
        """Let time jump at once where nobody else has anything to do until after it; False: there
        is somebody, and only waiting gives each its turn."""
        scheduled = self._scheduled  # type: ignore[attr-defined]
        others = self._ready or self._stopping  # type: ignore[attr-defined]
        if others or (scheduled and scheduled[0]._when <= to_ns * 1e-9):
            return False
        self._virtual_ns = max(self._virtual_ns, to_ns)
        return True

    def _run_once(self) -> None:
        if not self._ready:  # type: ignore[attr-defined]
            self._jump()
        super()._run_once()  # type: ignore[misc]

    def _jump(self) -> None:
        scheduled = self._scheduled  # type: ignore[attr-defined]
        while scheduled and scheduled[0]._cancelled:
            # As the base class does it, so that its count of cancelled timers stays right.
            handle = heapq.heappop(scheduled)
            handle._scheduled = False
            self._timer_cancelled_count -= 1  # type: ignore[attr-defined]
        if not scheduled:
            if not self._stopping:  # type: ignore[attr-defined]
                raise RuntimeError("virtual time cannot advance: no timer or event is pending")
            return
        due_ns = round(scheduled[0]._when * 1e9)
        self._virtual_ns = max(self._virtual_ns, due_ns)


Loop = RealTimeLoop | VirtualTimeLoop


def loop_clock() -> Clock:
    """The running loop's clock, for those who ask often."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, RealTimeLoop | VirtualTimeLoop), "the daemon runs on its own loops"
    return loop.now_ns


def now_ns() -> int:
    """Nanoseconds of the running loop's clock."""
    return loop_clock()()


def run(main: Coroutine[Any, Any, Result], *, virtual: bool) -> Result:
    """Run a coroutine to its end on a loop of the chosen kind."""
    with asyncio.Runner(loop_factory=VirtualTimeLoop if virtual else RealTimeLoop) as runner:
        return runner.run(main)


def fork() -> int:
    """`os.fork` under a running virtual loop, which goes on in both processes, each with a time of
    its own."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualTimeLoop), "a real loop shares its descriptors with a child"
    process = os.fork()
    if process == 0:
        # asyncio takes a loop for that of the process it was started in.
        asyncio._set_running_loop(loop)
    return process


class Usage(Protocol):
    """What a thread has been through so far; the fields of `resource.struct_rusage` used here."""

    @property
    def ru_minflt(self) -> int:
        """page faults mended without a disk"""
        ...

    @property
    def ru_majflt(self) -> int:
        """page faults that waited for a disk"""
        ...

    @property
    def ru_nvcsw(self) -> int:
        """times it gave the processor away"""
        ...

    @property
    def ru_nivcsw(self) -> int:
        """times the processor was taken from it"""
        ...


@dataclass
class Unused:
    """A `Usage` in which nothing happens but what a test writes."""

    ru_minflt: int = 0
    ru_majflt: int = 0
    ru_nvcsw: int = 0
    ru_nivcsw: int = 0


def no_stalls(_: int) -> int:
    """ns for which a host stood still that nobody watches."""
    return 0


class Stopwatch:
    """Measures how long our own code takes, and what happens to it meanwhile. In virtual time it
    always reads zero: what belongs to the host must not reach a virtual log."""

    def __init__(self, *, running: bool, stalled_ns: Callable[[int], int] = no_stalls) -> None:
        self.running = running
        self.stalled_ns = stalled_ns
        """ns for which the host as a whole stood still until then, in ns"""
        self.wall_ns: Clock = time.monotonic_ns if running else _zero
        self.processor_ns: Clock = time.thread_time_ns if running else _zero
        unused = Unused()
        self.usage: Callable[[], Usage] = _of_this_thread if running else lambda: unused


def utc_offset_ns() -> int:
    """UTC minus CLOCK_MONOTONIC, now."""
    return time.time_ns() - time.monotonic_ns()


def wall_seconds() -> float:
    """For telling a person how long something took."""
    return time.monotonic()


def wall_stamp() -> str:
    """Local date and time for the name of a folder; sorts by time."""
    return time.strftime("%Y%m%d-%H%M%S")


def pause(seconds: float) -> None:
    """For a command that looks again in a moment; nothing that ticks may call it."""
    time.sleep(seconds)


def _zero() -> int:
    return 0


def _of_this_thread() -> Usage:
    return resource.getrusage(resource.RUSAGE_THREAD)
