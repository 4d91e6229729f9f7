"""Ticks on an absolute schedule: exact in virtual time, skipped and not made up when missed, and
every miss laid at the right door."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from runtime.clock import Stopwatch, now_ns, run
from runtime.scheduler import Scheduler, TimerPacing, VirtualPacing

PERIOD = 1_000_000
START = 5 * PERIOD


class LateBy:
    """A host that wakes us late at one chosen due time."""

    def __init__(self, due_ns: int, late_ns: int) -> None:
        self._due, self._late = due_ns, late_ns

    async def until(self, due_ns: int) -> None:
        late = self._late if due_ns == self._due else 0
        await asyncio.sleep((due_ns + late - now_ns()) * 1e-9)

    def steer(self, due_ns: int) -> int:
        return 0

    def close(self) -> None:
        pass


def stopwatch(processor_ns: Callable[[], int]) -> Stopwatch:
    watch = Stopwatch(running=False)
    watch.processor_ns = processor_ns
    return watch


def busy() -> int:
    """All wall time was spent computing."""
    return now_ns()


def starved() -> int:
    """None of it was."""
    return 0


def schedule(
    ticks: int, pacing: object, watch: Stopwatch, work: Callable[[int], float]
) -> tuple[list[int], list[int], Scheduler]:
    """Numbers and lateness of the ticks handed out; ``work`` gives s that each computes."""

    async def main() -> tuple[list[int], list[int], Scheduler]:
        scheduler = Scheduler(PERIOD, START, pacing, watch)  # type: ignore[arg-type]
        numbers, late = [], []
        for _ in range(ticks):
            number = await scheduler.next()
            numbers.append(number)
            late.append(scheduler.wakeup_ns)
            assert now_ns() == scheduler.due_ns(number) + scheduler.wakeup_ns
            await asyncio.sleep(work(number))
        scheduler.close()
        return numbers, late, scheduler

    return run(main(), virtual=True)


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

    misses = run(main(), virtual=True).misses
    assert (misses.own, misses.host) == (0, 0)


def test_a_tick_longer_than_its_period_skips_and_is_ours() -> None:
    numbers, late, scheduler = schedule(
        5, VirtualPacing(), stopwatch(busy), lambda n: 0.0033 if n == 1 else 0.0001
    )
    assert numbers == [0, 1, 4, 5, 6]
    assert late == [0, 0, 300_000, 0, 0]
    assert (scheduler.misses.own, scheduler.misses.host) == (2, 0)


def test_an_overrun_within_the_next_period_costs_lateness_but_no_tick() -> None:
    numbers, late, scheduler = schedule(
        4, VirtualPacing(), stopwatch(busy), lambda n: 0.0017 if n == 0 else 0.0001
    )
    assert numbers == [0, 1, 2, 3]
    assert late == [0, 700_000, 0, 0]
    assert (scheduler.misses.own, scheduler.misses.host) == (0, 0)


def test_processor_time_stolen_within_a_tick_is_the_hosts() -> None:
    numbers, _, scheduler = schedule(
        3, VirtualPacing(), stopwatch(starved), lambda n: 0.0033 if n == 0 else 0.0001
    )
    assert numbers == [0, 3, 4]
    assert (scheduler.misses.own, scheduler.misses.host) == (0, 2)


def test_a_late_wakeup_is_the_hosts_and_makes_no_burst() -> None:
    pacing = LateBy(START + 2 * PERIOD, 4_400_000)
    numbers, late, scheduler = schedule(5, pacing, stopwatch(busy), lambda n: 0.0001)
    assert numbers == [0, 1, 6, 7, 8]
    assert late == [0, 0, 400_000, 0, 0]
    assert (scheduler.misses.own, scheduler.misses.host) == (0, 4)


def test_real_ticks_come_in_order_and_every_number_is_accounted_for() -> None:
    async def main() -> None:
        period_ns = 2_000_000
        start_ns = now_ns() + period_ns
        scheduler = Scheduler(period_ns, start_ns, TimerPacing(), Stopwatch(running=True))
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
