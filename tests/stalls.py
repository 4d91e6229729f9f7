"""Stalls of the host, measured beside tests in real time: why one of them may be tried again.

A watcher on every processor wakes each millisecond, above the priorities of the daemon and its
helpers. What delays it therefore is the host, not what a test computes. On a host that refuses
SCHED_FIFO no stall is told from other work, and none is reported.
"""

from __future__ import annotations

import atexit
import functools
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

_PERIOD_S = 0.001
_LEAST_NS = 2_000_000
"""A measurement is fresh for three ticks of 1 ms (config/control.yaml), so that a shorter stall
stops no robot; the watcher may sleep through one of them."""
_WATCHES, _REFUSED = b"+", b"-"
"""what a watcher answers"""
_KERNEL = Path("/proc/sys/kernel")
_THROTTLED_WITHIN = 0.1
"""of a pause: a watcher may sleep when it begins, and be one of several to go on"""


class Stall(NamedTuple):
    """A time, ns of CLOCK_MONOTONIC, in which a processor was not there."""

    begin_ns: int
    end_ns: int
    processor: int

    def __str__(self) -> str:
        return f"{1e-6 * (self.end_ns - self.begin_ns):.1f} ms on processor {self.processor}"


class Watch:
    """Watchers on processors until `close`; they write what they see into the file ``path``."""

    def __init__(self, processors: Iterable[int]) -> None:
        self._file = tempfile.NamedTemporaryFile("r", prefix="tonus-stalls-")  # noqa: SIM115
        self.path = Path(self._file.name)
        self.processes = [
            subprocess.Popen(
                [sys.executable, "-S", __file__, str(processor), str(self.path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            for processor in processors
        ]
        self.refused = self._answers().count(_REFUSED)
        """watchers without SCHED_FIFO, which measure nothing"""

    def since(self, begin_ns: int) -> list[Stall]:
        """Stalls that were not over at ``begin_ns``; see `now_ns`."""
        self._answers()
        lines = self.path.read_text(encoding="ascii").splitlines()
        stalls = (Stall(*map(int, line.split())) for line in lines)
        return [stall for stall in stalls if stall.end_ns > begin_ns and not throttled(stall)]

    def _answers(self) -> list[bytes]:
        """Of every watcher, once it has written what it has seen until now."""
        for process in self.processes:
            assert process.stdin is not None
            process.stdin.write(b"?")
            process.stdin.flush()
        return [process.stdout.read(1) for process in self.processes if process.stdout]

    def close(self) -> None:
        for process in self.processes:
            process.communicate()
        self._file.close()


def throttled(stall: Stall) -> bool:
    """Whether it is as long as the pause in which the kernel lets no real-time process run, when
    they have left nothing of a second to others: what a test runs may itself be to blame."""
    runtime_us, period_us = (
        int((_KERNEL / f"sched_rt_{name}_us").read_text(encoding="ascii"))
        for name in ("runtime", "period")
    )
    if runtime_us < 0:  # never
        return False
    pause_ns = 1000 * (period_us - runtime_us)
    return abs(stall.end_ns - stall.begin_ns - pause_ns) < pause_ns * _THROTTLED_WITHIN


def most_within(found: Iterable[Stall], window_ns: int) -> int:
    """The most ns of any ``window_ns`` in which a processor was not there; two at once count once,
    since a tick needs both."""
    spans: list[tuple[int, int]] = []
    for stall in sorted(found):
        begin_ns = max(stall.begin_ns, spans[-1][1] if spans else stall.begin_ns)
        if stall.end_ns > begin_ns:
            spans.append((begin_ns, stall.end_ns))
    return max(
        (
            sum(max(0, min(end, first + window_ns) - begin) for begin, end in spans[number:])
            for number, (first, _) in enumerate(spans)
        ),
        default=0,
    )


@functools.cache
def watching() -> Watch:
    """On every processor that this process may use, from the first call on."""
    watch = Watch(sorted(os.sched_getaffinity(0)))
    atexit.register(watch.close)
    return watch


def now_ns() -> int:
    """Of CLOCK_MONOTONIC."""
    return time.monotonic_ns()


def _watch(processor: int, path: str) -> None:
    """Write each stall in a line, and answer each byte on standard input, until that ends."""
    os.sched_setaffinity(0, {processor})
    answer = _WATCHES
    try:
        highest = os.sched_get_priority_max(os.SCHED_FIFO)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(highest))
    except PermissionError:
        answer = _REFUSED
    pause_s = _PERIOD_S if answer == _WATCHES else None
    with Path(path).open("a", encoding="ascii", buffering=1) as file:
        while True:
            due_ns = time.monotonic_ns() + round(1e9 * _PERIOD_S)
            asked = select.select([0], [], [], pause_s)[0]
            now = time.monotonic_ns()
            if answer == _WATCHES and now - due_ns >= _LEAST_NS:
                file.write(f"{due_ns} {now} {processor}\n")
            if asked:
                if not os.read(0, 1):
                    return
                os.write(1, answer)


if __name__ == "__main__":
    _watch(int(sys.argv[1]), sys.argv[2])
