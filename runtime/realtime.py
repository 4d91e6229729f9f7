"""Real-time hygiene of a process: each item granted or refused, and said so."""

from __future__ import annotations

import ctypes
import gc
import os
from dataclasses import dataclass
from pathlib import Path

_MCL_CURRENT_AND_FUTURE = 1 | 2


@dataclass(frozen=True)
class Grant:
    """One thing asked of the host."""

    item: str
    granted: bool
    detail: str

    def __str__(self) -> str:
        return f"{self.item}: {'granted' if self.granted else 'REFUSED'} ({self.detail})"


def prepare(*, priority: int, processor: int | None, lock_memory: bool) -> list[Grant]:
    """Ask for what a periodic process needs: SCHED_FIFO (0 for none; children start without it),
    one processor, memory that is never paged out."""
    grants = []
    if priority:
        grants.append(_fifo(priority))
    if processor is not None:
        grants.append(_pin(processor))
    if lock_memory:
        grants.append(_lock())
    return grants


def freeze_collector() -> None:
    """No garbage collection from here on: collect once, and keep what is alive out of it."""
    gc.collect()
    gc.freeze()
    gc.disable()


def thaw_collector() -> None:
    """The collector works again."""
    gc.enable()
    gc.unfreeze()


def stolen_jiffies() -> tuple[int, int]:
    """(stolen by the hypervisor, all) processor time of this host so far, in clock ticks."""
    first = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0]
    fields = [int(number) for number in first.split()[1:]]
    return fields[7], sum(fields[:8])


def _fifo(priority: int) -> Grant:
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except OSError as error:
        detail = f"{error.strerror}; run as root or raise the rtprio limit"
        return Grant(f"SCHED_FIFO {priority}", False, detail)
    return Grant(f"SCHED_FIFO {priority}", True, "reset on fork")


def _pin(processor: int) -> Grant:
    try:
        os.sched_setaffinity(0, {processor})
    except OSError as error:
        return Grant(f"processor {processor}", False, error.strerror or "refused")
    return Grant(f"processor {processor}", True, "this process alone is pinned")


def _lock() -> Grant:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT_AND_FUTURE):
        reason = os.strerror(ctypes.get_errno())
        return Grant("mlockall", False, f"{reason}; raise the memlock limit")
    return Grant("mlockall", True, "present and future pages")
