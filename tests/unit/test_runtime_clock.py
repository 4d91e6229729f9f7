"""Virtual time jumps, keeps order and never hangs; real time is the monotonic clock."""

from __future__ import annotations

import asyncio

import pytest

from tonus.runtime.timing.clock import Stopwatch, now_ns, run

HOUR = 3600.0


def test_virtual_time_starts_at_zero_and_jumps_to_each_timer() -> None:
    seen: list[tuple[str, int]] = []

    async def sleeper(name: str, seconds: float) -> None:
        await asyncio.sleep(seconds)
        seen.append((name, now_ns()))

    async def main() -> int:
        begun = now_ns()
        await asyncio.gather(
            sleeper("c", 5 * HOUR), sleeper("a", 0.001), sleeper("b", 2.5), sleeper("b2", 2.5)
        )
        return begun

    assert run(main(), virtual=True) == 0
    assert seen == [
        ("a", 1_000_000),
        ("b", 2_500_000_000),
        ("b2", 2_500_000_000),
        ("c", 18_000_000_000_000),
    ]


def test_work_takes_no_virtual_time() -> None:
    async def main() -> int:
        for _ in range(1000):
            await asyncio.sleep(0)
        return now_ns()

    assert run(main(), virtual=True) == 0


def test_a_timeout_fires_at_its_own_time_and_not_before() -> None:
    async def main() -> tuple[int, str]:
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(asyncio.Event().wait(), 1.5)
        at = now_ns()
        answer = await asyncio.wait_for(asyncio.sleep(0.25, "done"), 100.0)
        assert now_ns() == 1_750_000_000
        async with asyncio.timeout(5.0):
            await asyncio.sleep(1.0)
        return at, answer

    assert run(main(), virtual=True) == (1_500_000_000, "done")


def test_cancelled_timers_do_not_move_time() -> None:
    async def main() -> int:
        loop = asyncio.get_running_loop()
        for delay in range(1, 300):
            loop.call_later(delay * 0.001, pytest.fail, "a cancelled timer ran").cancel()
        await asyncio.sleep(0.5)
        return now_ns()

    assert run(main(), virtual=True) == 500_000_000


def test_a_cancelled_task_cleans_up_in_virtual_time() -> None:
    async def main() -> tuple[bool, int]:
        task = asyncio.create_task(asyncio.sleep(HOUR))
        await asyncio.sleep(1.0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        return task.cancelled(), now_ns()

    assert run(main(), virtual=True) == (True, 1_000_000_000)


def test_waiting_for_what_can_never_come_raises_instead_of_hanging() -> None:
    async def main() -> None:
        await asyncio.sleep(1.0)
        await asyncio.Event().wait()

    with pytest.raises(RuntimeError, match="cannot advance"):
        run(main(), virtual=True)


def test_an_exception_comes_through() -> None:
    async def main() -> None:
        await asyncio.sleep(1.0)
        raise LookupError("mine")

    with pytest.raises(LookupError, match="mine"):
        run(main(), virtual=True)


def test_real_time_is_the_loops_own_clock_and_runs_forward() -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        first = now_ns()
        between = round(loop.time() * 1e9)
        await asyncio.sleep(0.01)
        last = now_ns()
        assert first <= between + 1000 <= last + 1000
        assert last - first > 5_000_000

    run(main(), virtual=False)


def test_a_stopwatch_that_does_not_run_reads_zero() -> None:
    still, running = Stopwatch(running=False), Stopwatch(running=True)
    assert still.wall_ns() == still.processor_ns() == 0
    begun = running.wall_ns(), running.processor_ns()
    assert sum(range(200_000)) > 0
    assert running.wall_ns() > begun[0]
    assert running.processor_ns() > begun[1]
