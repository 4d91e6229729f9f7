"""What the watch for stalls of the host counts, and what the daemon reads of it meanwhile."""

from __future__ import annotations

import mmap
import os
import signal
import struct
from collections.abc import Iterator
from typing import Any

import pytest

from tonus.config import load
from tonus.runtime.timing.clock import Stopwatch, pause
from tonus.runtime.timing.realtime import settled
from tonus.runtime.timing.stalls import BYTES, Stalls, StallWatch
from tonus.tools.run import stall_watch_process
from tonus.tools.run.stall_watch_process import stall_watch

MS = 1_000_000
now_ns = Stopwatch(running=True).wall_ns


def shared(due_ns: int, stalled_ns: int) -> mmap.mmap:
    memory = mmap.mmap(-1, BYTES)
    memory[:BYTES] = struct.pack("qq", due_ns, stalled_ns)
    return memory


def test_a_stall_counts_while_it_lasts() -> None:
    stalls = Stalls(shared(1000 * MS, 7 * MS))
    assert stalls.until(990 * MS) == 7 * MS
    assert stalls.until(1000 * MS + 200_000) == 7 * MS, "it may only have been kept waiting"
    assert stalls.until(1003 * MS) == 10 * MS
    assert stalls.until(1100 * MS) == 107 * MS
    assert stalls.until(5000 * MS) == 107 * MS, "a watch that has ended is no witness"


def test_the_watch_counts_what_it_was_late_by(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, lateness = [0], [50_000, 3 * MS, 0, 200_000, 250 * MS, 0]
    memory = mmap.mmap(-1, BYTES)
    watch = StallWatch(memory, MS // 2)
    monkeypatch.setattr(watch, "_now_ns", lambda: clock[0])
    stalls, seen = Stalls(memory), []
    for late in lateness:
        clock[0] = struct.unpack("qq", memory[:])[0] + late
        watch.wait()
        seen.append(stalls.until(clock[0]))
        assert struct.unpack("qq", memory[:])[0] == clock[0] + MS // 2
    assert seen == [0, 3 * MS, 3 * MS, 3 * MS, 103 * MS, 103 * MS]


@pytest.fixture(autouse=True)
def every_processor() -> Iterator[None]:
    """Whatever other tests have left of them to this process."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    yield
    os.sched_setaffinity(0, before)


def settings(**changes: Any) -> Any:
    asked = load("config/can.yaml")[0].realtime.model_copy(update=changes)
    return settled(asked)


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs two processors")
def test_the_watch_of_a_run_sees_a_stall_and_ends_with_the_daemon() -> None:
    told: list[str] = []
    watched = stall_watch(settings(daemon_priority=0), told.append)
    assert watched is not None, told
    process, stalls = watched.process.process, watched.stalls
    before = stalls.until(now_ns())
    os.kill(process.pid, signal.SIGSTOP)
    pause(0.03)
    during = stalls.until(now_ns())
    os.kill(process.pid, signal.SIGCONT)
    pause(0.03)
    after = stalls.until(now_ns())
    assert during - before >= 25 * MS
    assert after >= during
    assert watched.at_work
    watched.process.stop()
    assert not watched.at_work
    assert process.returncode == 0
    assert told == []


def test_without_a_second_processor_or_a_wish_there_is_no_watch(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told: list[str] = []
    for changes in ({"policy": "off"}, {"stall_watch_us": None}, {"daemon_cpu": None}):
        assert stall_watch(settings(**changes), told.append) is None
    own = settings()
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {own.daemon_cpu})
    assert stall_watch(own, told.append) is None
    assert told == []


def test_a_run_goes_on_without_a_watch_that_does_not_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told: list[str] = []
    own = settings(daemon_cpu=0)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(stall_watch_process, "_COMMAND", ("/bin/echo",))
    assert stall_watch(own, told.append) is None
    assert len(told) == 1
    assert told[0].startswith("without a watch for stalls of the host: the stall watch did not")
