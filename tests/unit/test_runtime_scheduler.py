"""Ticks on an absolute schedule: exact in virtual time, skipped and not made up when missed, and
every miss laid at the right door."""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any

import pytest

from tonus.runtime.timing.clock import Stopwatch, Unused, now_ns, run
from tonus.runtime.timing.scheduler import (
    Disturbances,
    Pacing,
    Scheduler,
    TimerPacing,
    VirtualPacing,
)

PERIOD = 1_000_000
START = 5 * PERIOD


class LateBy:
    """A host that wakes us late at one chosen due time."""

    def __init__(self, due_ns: int, late_ns: int) -> None:
        self._due, self._late = due_ns, late_ns

    async def until(self, due_ns: int) -> int | None:
        late = self._late if due_ns == self._due else 0
        await asyncio.sleep((due_ns + late - now_ns()) * 1e-9)
        return None

    def steer(self, due_ns: int) -> int:
        return 0

    def close(self) -> None:
        pass


class Thread:
    """What the tick's thread has used of the processor, and how often it gave it away."""

    def __init__(self) -> None:
        self.processor_ns = 0
        self.usage = Unused()
        self.stopwatch = Stopwatch(running=False)
        self.stopwatch.running = True
        self.stopwatch.processor_ns = lambda: self.processor_ns
        self.stopwatch.usage = lambda: replace(self.usage)

    async def compute(self, seconds: float, *, share: float = 1.0) -> None:
        """Time passes, of which this thread has the processor for a ``share``."""
        await asyncio.sleep(seconds)
        self.processor_ns += round(seconds * share * 1e9)


Work = Callable[[Thread, int], Coroutine[Any, Any, None]]


def schedule(ticks: int, pacing: Pacing, work: Work) -> tuple[list[int], list[int], Scheduler]:
    """Numbers and lateness of the ticks handed out; ``work`` is what each does."""

    async def main() -> tuple[list[int], list[int], Scheduler]:
        thread = Thread()
        scheduler = Scheduler(PERIOD, START, pacing, thread.stopwatch)
        numbers, late = [], []
        for _ in range(ticks):
            number = await scheduler.next()
            numbers.append(number)
            late.append(scheduler.wakeup_ns)
            assert now_ns() == scheduler.due_ns(number) + scheduler.wakeup_ns
            await work(thread, number)
        scheduler.close()
        return numbers, late, scheduler

    return run(main(), virtual=True)


def computing(tick: int, seconds: float, *, share: float = 1.0) -> Work:
    """One long tick among short ones."""

    async def work(thread: Thread, number: int) -> None:
        if number == tick:
            await thread.compute(seconds, share=share)
        else:
            await thread.compute(0.0001)

    return work


def misses(scheduler: Scheduler) -> tuple[int, int]:
    return scheduler.misses.own, scheduler.misses.host


@pytest.mark.parametrize("start_ns", [0, 36_000_000_000_007])
@pytest.mark.parametrize("period_ns", [1_000_000, 333_333])
def test_virtual_ticks_are_exact_to_the_nanosecond(start_ns: int, period_ns: int) -> None:
    async def main() -> Scheduler:
        scheduler = Scheduler(period_ns, start_ns, VirtualPacing(), Stopwatch(running=False))
        for expected in range(2000):
            assert await scheduler.next() == expected
            assert scheduler.wakeup_ns == 0
            assert now_ns() == start_ns + expected * period_ns
        return scheduler

    assert misses(run(main(), virtual=True)) == (0, 0)


def test_virtual_ticks_give_each_its_turn_at_its_own_time() -> None:
    """Also where they do not go through the loop."""

    async def main() -> list[tuple[str, int]]:
        loop, seen = asyncio.get_running_loop(), list[tuple[str, int]]()
        scheduler = Scheduler(PERIOD, PERIOD, VirtualPacing(), Stopwatch(running=False))

        async def other() -> None:
            for _ in range(3):
                await asyncio.sleep(1.5 * PERIOD * 1e-9)
                seen.append(("other", now_ns()))
            loop.call_soon(lambda: seen.append(("soon", now_ns())))

        task = loop.create_task(other())
        for _ in range(6):
            tick = await scheduler.next()
            seen.append((f"tick {tick}", now_ns()))
        await task
        return seen

    seen = run(main(), virtual=True)
    half = PERIOD // 2
    assert [at for _, at in seen] == sorted(at for _, at in seen)
    assert [at for name, at in seen if name == "other"] == [3 * half, 6 * half, 9 * half]
    assert [at for name, at in seen if name.startswith("tick")] == [k * PERIOD for k in range(1, 7)]
    assert ("soon", 9 * half) in seen


def test_a_tick_longer_than_its_period_skips_and_is_ours() -> None:
    numbers, late, scheduler = schedule(5, VirtualPacing(), computing(1, 0.0033))
    assert numbers == [0, 1, 4, 5, 6]
    assert late == [0, 0, 300_000, 0, 0]
    assert misses(scheduler) == (2, 0)


def test_an_overrun_within_the_next_period_costs_lateness_but_no_tick() -> None:
    numbers, late, scheduler = schedule(4, VirtualPacing(), computing(0, 0.0017))
    assert numbers == [0, 1, 2, 3]
    assert late == [0, 700_000, 0, 0]
    assert misses(scheduler) == (0, 0)


def test_processor_time_taken_within_a_tick_is_the_hosts() -> None:
    numbers, _, scheduler = schedule(3, VirtualPacing(), computing(0, 0.0033, share=0.1))
    assert numbers == [0, 3, 4]
    assert misses(scheduler) == (0, 2)


def test_ours_is_what_we_would_have_missed_on_a_perfect_host() -> None:
    """4 ms on the wall cost three ticks. Of these 2.4 ms ours, it would have cost one all the same;
    1.6 ms, and the next tick would only have been late."""
    assert misses(schedule(3, VirtualPacing(), computing(0, 0.004, share=0.6))[2]) == (1, 2)
    assert misses(schedule(3, VirtualPacing(), computing(0, 0.004, share=0.4))[2]) == (0, 3)


def test_lateness_left_by_the_host_does_not_make_the_next_miss_ours() -> None:
    """Woken 0.9 ms late, then 1.2 ms of computing: a tick is missed that we alone had only begun
    0.2 ms late. Tick after tick of 1.2 ms, though, adds up to one that is ours."""

    async def long(thread: Thread, number: int) -> None:
        await thread.compute(0.0012)

    pacing = LateBy(START, 900_000)
    assert misses(schedule(2, pacing, long)[2]) == (0, 1)
    numbers, _, scheduler = schedule(7, VirtualPacing(), long)
    assert numbers == [0, 1, 2, 3, 4, 6, 7]
    assert misses(scheduler) == (1, 0)


def test_a_tick_that_waits_by_its_own_doing_is_ours() -> None:
    """It used hardly any processor, but it gave it away itself: a disk, a lock."""

    async def work(thread: Thread, number: int) -> None:
        await thread.compute(0.0033 if number == 1 else 0.0001, share=0.1)
        thread.usage.ru_nvcsw += number == 1

    numbers, _, scheduler = schedule(3, VirtualPacing(), work)
    assert numbers == [0, 1, 4]
    assert misses(scheduler) == (2, 0)


def test_what_else_the_loop_does_between_ticks_is_ours() -> None:
    class Chatty(LateBy):
        async def until(self, due_ns: int) -> int | None:
            late = due_ns == self._due
            await super().until(due_ns)
            thread.processor_ns += self._late * late
            return None

    thread = Thread()
    pacing = Chatty(START + 2 * PERIOD, 4_400_000)

    async def main() -> Scheduler:
        scheduler = Scheduler(PERIOD, START, pacing, thread.stopwatch)
        for _ in range(5):
            await scheduler.next()
        return scheduler

    assert misses(run(main(), virtual=True)) == (4, 0)


def test_a_stall_while_we_wait_awake_is_the_hosts() -> None:
    """The processor's clock of a thread that spins runs on while the hypervisor has the processor;
    what the loop did before is ours all the same."""

    class Spinning(LateBy):
        def __init__(self, loop_s: float) -> None:
            super().__init__(START + 2 * PERIOD, 4_400_000)
            self.thread, self._loop_ns = Thread(), round(loop_s * 1e9)

        async def until(self, due_ns: int) -> int:
            late = due_ns == self._due
            self.thread.processor_ns += self._loop_ns * late
            idle_ns = self.thread.processor_ns
            await super().until(due_ns)
            self.thread.processor_ns += (self._late - self._loop_ns) * late
            return idle_ns

    def found(pacing: Spinning) -> tuple[int, int]:
        async def main() -> Scheduler:
            scheduler = Scheduler(PERIOD, START, pacing, pacing.thread.stopwatch)
            for _ in range(5):
                await scheduler.next()
            return scheduler

        return misses(run(main(), virtual=True))

    assert found(Spinning(0.0)) == (0, 4)
    assert found(Spinning(0.0022)) == (2, 2)


def test_a_stall_of_the_whole_host_is_the_hosts() -> None:
    """The clock of a thread that computes runs on through it. Of 4.4 ms 3.2 were one: without it
    the tick would have been late, and none missed. A stall that was over before it began, or that
    comes while nobody computes, takes nothing off."""

    def found(stall_ns: int, tick: int) -> tuple[int, int]:
        async def work(thread: Thread, number: int) -> None:
            if number == tick:
                stalled["ns"] += stall_ns
            await thread.compute(0.0044 if number == 1 else 0.0001)

        stalled = {"ns": 0}
        thread = Thread()
        thread.stopwatch.stalled_ns = lambda _: stalled["ns"]

        async def main() -> Scheduler:
            scheduler = Scheduler(PERIOD, START, VirtualPacing(), thread.stopwatch)
            for _ in range(3):
                await work(thread, await scheduler.next())
            await scheduler.next()
            return scheduler

        return misses(run(main(), virtual=True))

    assert found(0, 1) == (3, 0)
    assert found(3_200_000, 1) == (0, 3)
    assert found(1_200_000, 1) == (2, 1)
    assert found(9_000_000, 1) == (0, 3)
    assert found(3_200_000, 0) == (3, 0)


def test_a_stall_between_ticks_is_the_hosts() -> None:
    stalled = 0
    thread = Thread()
    thread.stopwatch.stalled_ns = lambda _: stalled

    class Stopped(LateBy):
        """Something else of the loop computes for 4.4 ms, of which 3.3 were a stall."""

        async def until(self, due_ns: int) -> int | None:
            nonlocal stalled
            late = due_ns == self._due
            await super().until(due_ns)
            thread.processor_ns += self._late * late
            stalled += 3_300_000 * late
            return None

    async def main() -> Scheduler:
        pacing = Stopped(START + 2 * PERIOD, 4_400_000)
        scheduler = Scheduler(PERIOD, START, pacing, thread.stopwatch)
        for _ in range(5):
            await scheduler.next()
        return scheduler

    assert misses(run(main(), virtual=True)) == (1, 3)


def test_what_the_clock_shows_of_a_wait_is_the_hosts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some kernels let a thread's clock run from the event on that wakes it, while another task
    keeps the processor."""
    usual = selectors.EpollSelector.select
    waits = 0

    def late(self: selectors.EpollSelector, timeout: float | None = None) -> Any:
        nonlocal waits
        found = usual(self, timeout)
        waits += timeout is None or timeout > 0.0
        if waits == 5:
            end = thread_time_ns() + 5 * PERIOD
            while thread_time_ns() < end:
                pass
            waits += 1
        return found

    async def main() -> Scheduler:
        start_ns = now_ns() + PERIOD
        pacing = TimerPacing(early_ns=100_000)
        scheduler = Scheduler(PERIOD, start_ns, pacing, Stopwatch(running=True))
        for _ in range(10):
            await scheduler.next()
        scheduler.close()
        return scheduler

    thread_time_ns = Stopwatch(running=True).processor_ns
    monkeypatch.setattr(selectors.EpollSelector, "select", late)
    scheduler = run(main(), virtual=False)
    assert scheduler.misses.host >= 4
    assert scheduler.misses.own == 0


def test_a_late_wakeup_is_the_hosts_and_makes_no_burst() -> None:
    pacing = LateBy(START + 2 * PERIOD, 4_400_000)
    numbers, late, scheduler = schedule(5, pacing, computing(0, 0.0001))
    assert numbers == [0, 1, 6, 7, 8]
    assert late == [0, 0, 400_000, 0, 0]
    assert misses(scheduler) == (0, 4)


def test_faults_and_switches_within_ticks_are_counted() -> None:
    async def work(thread: Thread, number: int) -> None:
        thread.usage.ru_minflt += 3
        thread.usage.ru_majflt += number == 2
        thread.usage.ru_nivcsw += number % 2

    _, _, scheduler = schedule(5, VirtualPacing(), work)
    assert scheduler.disturbances == Disturbances(page_faults=3 * 4 + 1, switches=2)


def test_a_loop_that_is_always_late_still_gives_others_their_turn() -> None:
    turns = 0

    async def other() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    async def main() -> None:
        others = asyncio.get_running_loop().create_task(other())
        for _ in range(10):
            # Each is behind its schedule from the start, as after an overrun.
            late = Scheduler(PERIOD, -100 * PERIOD, VirtualPacing(), Stopwatch(running=False))
            await late.next()
        others.cancel()

    run(main(), virtual=True)
    assert turns >= 10


@pytest.mark.parametrize(("early_ns", "spin_ns"), [(0, 0), (300_000, 0), (300_000, 100_000)])
def test_real_ticks_come_in_order_and_every_number_is_accounted_for(
    early_ns: int, spin_ns: int
) -> None:
    async def main() -> None:
        period_ns = 2_000_000
        start_ns = now_ns() + period_ns
        scheduler = Scheduler(
            period_ns, start_ns, TimerPacing(early_ns, spin_ns), Stopwatch(running=True)
        )
        numbers = []
        for _ in range(50):
            numbers.append(await scheduler.next())
            assert 0 <= scheduler.wakeup_ns < period_ns
            assert now_ns() >= scheduler.due_ns(numbers[-1])
        scheduler.close()
        assert numbers == sorted(set(numbers))
        skipped = numbers[-1] + 1 - len(numbers)
        assert scheduler.misses.own + scheduler.misses.host == skipped

    run(main(), virtual=False)
