"""How late a bare periodic thread wakes up here, as cyclictest has it; and cyclictest itself."""

from __future__ import annotations

import ctypes
import shutil
import struct
import subprocess
from collections.abc import Callable

from tonus.config.schema.realtime import HostLimits, RealTime
from tonus.runtime.timing.clock import Stopwatch
from tonus.runtime.timing.histogram import Histogram
from tonus.runtime.timing.realtime import Grant, Hygiene, stolen_jiffies
from tonus.tools.doctor.finding import Finding, Verdict, graded

_CLOCK_MONOTONIC, _TIMER_ABSTIME = 1, 1
_SECOND_NS = 1_000_000_000
_PERIOD_NS = 1_000_000
_US = 1e-3
_LIMITS_FOR_NS = 1_000_000
"""the period that the configured limits are meant for; a longer one bears more"""
_TIMESPEC = struct.Struct("qq")
_BINS_US = 20_000
"""cyclictest's histogram has bins of a microsecond"""
_REMEDY = "see preemption, isolation and privileges; no other heavy load beside the daemon"


def bare(
    seconds: float, action: Callable[[], object] = lambda: None, period_ns: int = _PERIOD_NS
) -> Histogram:
    """Wake-up latencies of clock_nanosleep with a period, by this thread as it is, which does
    ``action`` each time."""
    libc, now_ns = ctypes.CDLL(None), Stopwatch(running=True).wall_ns
    until, found = ctypes.create_string_buffer(_TIMESPEC.size), Histogram()
    due = now_ns() + 2 * period_ns
    for _ in range(max(round(seconds * _SECOND_NS / period_ns), 1)):
        _TIMESPEC.pack_into(until, 0, *divmod(due, _SECOND_NS))
        libc.clock_nanosleep(_CLOCK_MONOTONIC, _TIMER_ABSTIME, until, None)
        late = now_ns() - due
        found.add(late)
        action()
        due += period_ns * (1 + max(late, 0) // period_ns)
    return found


def cyclictest(seconds: float, priority: int = 80, period_ns: int = _PERIOD_NS) -> Histogram | None:
    """The same by ``cyclictest``; None where it is not installed or not permitted."""
    program = shutil.which("cyclictest")
    if program is None:
        return None
    command = [
        program,
        f"-p{priority}",
        f"-i{period_ns // 1000}",
        f"-D{max(round(seconds), 1)}",
        "-q",
    ]
    done = subprocess.run([*command, f"-h{_BINS_US}"], capture_output=True, text=True, check=False)
    return parse(done.stdout) if done.returncode == 0 else None


def parse(text: str) -> Histogram:
    """A histogram from what ``cyclictest -q -h`` prints."""
    found = Histogram()
    for line in text.splitlines():
        words = line.split()
        if len(words) == 2 and all(word.isdecimal() for word in words):
            for _ in range(int(words[1])):
                found.add(int(words[0]) * 1000)
        elif line.startswith("# Histogram Overflows:"):
            for _ in range(int(words[-1])):
                found.add(_BINS_US * 1000)
    return found


def examine(
    settings: RealTime, limits: HostLimits, seconds: float, period_ns: int = _PERIOD_NS
) -> tuple[list[Finding], list[Grant]]:
    """Latency with all that the daemon asks for, stolen time meanwhile, and the grants."""
    before = stolen_jiffies()
    hygiene = Hygiene(settings)
    try:
        ours = bare(seconds, period_ns=period_ns)
    finally:
        hygiene.release()
    peer = cyclictest(min(seconds, 2.0), period_ns=period_ns) if seconds >= 1.0 else None
    stolen, total = (now - then for now, then in zip(stolen_jiffies(), before, strict=True))
    text, figures = _told(ours)
    share = period_ns / _LIMITS_FOR_NS
    good, bad = share * limits.wakeup_good_us, share * limits.wakeup_bad_us
    verdict = graded(ours.at(0.999) * _US, good, bad)
    findings = [Finding("wake-up", text, verdict, _remedy(verdict), figures)]
    if peer is not None:
        text, figures = _told(peer)
        findings.append(Finding("wake-up, cyclictest", text, figures=figures))
    percent = 100.0 * stolen / total if total else 0.0
    verdict = graded(percent, limits.steal_good_percent, limits.steal_bad_percent)
    remedy = "" if verdict is Verdict.GOOD else "give the virtual machine processors of its own"
    stolen_text = f"{percent:.2f} % of the processors' time"
    findings.append(
        Finding("stolen time", stolen_text, verdict, remedy, {"steal_percent": round(percent, 3)})
    )
    return findings, hygiene.grants


def _remedy(verdict: Verdict) -> str:
    return "" if verdict is Verdict.GOOD else _REMEDY


def _told(found: Histogram) -> tuple[str, dict[str, float]]:
    figures = {
        "p50_us": found.at(0.5) * 1e-3,
        "p99_us": found.at(0.99) * 1e-3,
        "p99_9_us": found.at(0.999) * 1e-3,
        "max_us": found.largest * 1e-3,
    }
    numbers = " / ".join(f"{value:.0f}" for value in figures.values())
    text = f"{numbers} us (p50 / p99 / p99.9 / max of {found.count})"
    return text, {name: round(value, 1) for name, value in figures.items()}
