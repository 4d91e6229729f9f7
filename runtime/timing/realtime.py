"""Real-time settings of a process: each is granted or refused, and reported."""

from __future__ import annotations

import ctypes
import gc
import os
import struct
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tonus.config.schema.realtime import Processor, Processors, RealTime
from tonus.runtime.errors import DaemonError
from tonus.runtime.timing import kernel_workers
from tonus.runtime.timing.awake import Choice, Comparison, Undo, compare

_MCL_CURRENT_AND_FUTURE = 1 | 2
_PR_SET_TIMERSLACK = 29
_LEAST_SLACK_NS, _USUAL_SLACK = 1, 0
_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4
_NEVER = 2**31 - 1
_USUAL_TRIM, _USUAL_MMAPS = 128 * 1024, 65536
_DMA_LATENCY = Path("/dev/cpu_dma_latency")
_PROCESSORS = Path("/sys/devices/system/cpu")
_INTERRUPTS = Path("/proc/interrupts")
_RESUME_LATENCY = "power/pm_qos_resume_latency_us"
_ANY, _NONE = "0", "n/a"
"""What the kernel calls no limit, and a limit of 0 (Documentation/ABI sysfs-devices-power)."""
_STACK_DEPTH = 400
"""nested calls through C, about 300 bytes of stack each"""
_MIB = 1 << 20


class RefusedError(DaemonError):
    """The host does not grant what the configuration requires; a line for each item."""


@dataclass(frozen=True)
class Grant:
    """One thing asked of the host."""

    item: str
    granted: bool
    detail: str

    def __str__(self) -> str:
        return f"{self.item}: {'granted' if self.granted else 'REFUSED'} ({self.detail})"


class Hygiene:
    """All that a daemon asks of the host, held until `release`.

    The caller warms compiled code itself, before: the code is its own.
    """

    def __init__(self, settings: RealTime) -> None:
        self.grants: list[Grant] = []
        self._undo: list[Undo] = []
        if settings.policy == "off":
            self._take(_freeze())
            return
        self._take(_reserve(settings.prefault_mib))
        if settings.lock_memory:
            self._take(_lock())
        self._take(_slack())
        if settings.cpu_dma_latency_us is not None:
            processor = None if settings.awake == "all" else settings.daemon_cpu
            self._take(_stay_awake(settings.cpu_dma_latency_us, processor))
        if settings.daemon_cpu is not None:
            self._take(_pin({_number(settings.daemon_cpu)}))
            if settings.kernel_workers == "others":
                self._take(_keep_workers_off(_number(settings.daemon_cpu)))
        if settings.daemon_priority:
            self._take(_fifo(settings.daemon_priority))
        self._take(_freeze())

    def release(self) -> None:
        """Give everything back; more than once does no harm."""
        while self._undo:
            self._undo.pop()()

    @property
    def refused(self) -> list[Grant]:
        return [grant for grant in self.grants if not grant.granted]

    def _take(self, asked: tuple[Grant, Undo | None]) -> None:
        grant, undo = asked
        self.grants.append(grant)
        if undo is not None:
            self._undo.append(undo)


def settled(settings: RealTime) -> RealTime:
    """The same with every processor by its number: asked once, so that all processes of a run go
    by the same answer."""
    if settings.daemon_cpu is None:
        return settings
    usable = os.sched_getaffinity(0)
    daemon = _number(settings.daemon_cpu)
    others = tuple(sorted(usable - {daemon} or usable))
    beside = {
        key: others for key in ("lab_cpu", "recorder_cpu") if getattr(settings, key) == "others"
    }
    return settings.model_copy(update={"daemon_cpu": daemon, **beside})


def compared(settings: RealTime) -> Comparison | None:
    """What speaks for which processors to be kept awake; None where nobody has to know, or none
    can be. The settings are `settled`."""
    daemon, latency_us = settings.daemon_cpu, settings.cpu_dma_latency_us
    usable = os.sched_getaffinity(0)
    if settings.policy == "off" or settings.awake != "measured" or latency_us is None:
        return None
    if not isinstance(daemon, int) or daemon not in usable or len(usable) == 1:
        return None
    if not os.access(_DMA_LATENCY, os.W_OK):
        return None

    def hold(choice: Choice) -> Undo | None:
        return _stay_awake(latency_us, daemon if choice == "own" else None)[1]

    return compare(daemon, max(usable - {daemon}), hold)


def demand(settings: RealTime) -> None:
    """With the policy ``require``, ask for everything and give it back, before anything is started.

    Raises `RefusedError` with a line for each item that the host refuses.
    """
    if settings.policy != "require":
        return
    hygiene = Hygiene(settings)
    hygiene.release()
    if hygiene.refused:
        lines = "".join(f"\n  {grant}" for grant in hygiene.refused)
        raise RefusedError(
            "realtime.policy is require, and this host refuses (details: tonus doctor):" + lines
        )


def prepare(*, priority: int, processors: Processors | None, lock_memory: bool) -> list[Grant]:
    """What a process beside the daemon asks for, for good: SCHED_FIFO (0 for none; children start
    without it), processors, locked memory."""
    grants = []
    if priority:
        grants.append(_fifo(priority)[0])
    if processors is not None:
        grants.append(_pin(_numbers(processors))[0])
    if lock_memory:
        grants.append(_lock()[0])
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


def _freeze() -> tuple[Grant, Undo]:
    freeze_collector()
    return Grant("collector", True, "frozen and off"), thaw_collector


def _fifo(priority: int) -> tuple[Grant, Undo | None]:
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    item = f"SCHED_FIFO {priority}"
    before, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except OSError as error:
        detail = f"{error.strerror}; run as root or raise the rtprio limit"
        return Grant(item, False, detail), None
    return Grant(item, True, "reset on fork"), partial(os.sched_setscheduler, 0, before, parameter)


def _number(processor: Processor) -> int:
    return _quietest(os.sched_getaffinity(0)) if processor == "quietest" else processor


def _numbers(processors: Processors) -> set[int]:
    if processors == "others":
        usable = os.sched_getaffinity(0)
        return usable - {_quietest(usable)} or usable
    return {processors} if isinstance(processors, int) else set(processors)


def _quietest(usable: set[int]) -> int:
    """Disk and network interrupts, and what follows them, are booked to whom they interrupt, for
    milliseconds now and then. Of equals it is the last."""
    try:
        lines = _INTERRUPTS.read_text(encoding="ascii").splitlines()
    except OSError:
        return max(usable)
    columns = [int(name.removeprefix("CPU")) for name in lines[0].split()]
    served = dict.fromkeys(columns, 0)
    for line in lines[1:]:
        label, *fields = line.split()
        if label.rstrip(":").isdigit():  # a device's, not the kernel's own
            for column, count in zip(columns, fields, strict=False):
                served[column] += int(count)
    return min(usable, key=lambda processor: (served.get(processor, 0), -processor))


def _pin(wanted: set[int]) -> tuple[Grant, Undo | None]:
    before = os.sched_getaffinity(0)
    item = f"processor {', '.join(map(str, sorted(wanted)))}"
    try:
        os.sched_setaffinity(0, wanted)
    except OSError as error:
        known = f"this host has 0 to {(os.cpu_count() or 1) - 1}"
        return Grant(item, False, f"{error.strerror}; {known}"), None
    return Grant(item, True, "pinned"), partial(os.sched_setaffinity, 0, before)


def _keep_workers_off(processor: int) -> tuple[Grant, Undo | None]:
    item = "kernel workers"
    try:
        undo = kernel_workers.keep_off(processor)
    except OSError as error:
        return Grant(item, False, f"{kernel_workers.MASK}: {error.strerror}; run as root"), None
    return Grant(item, True, "kept off the daemon's processor"), undo


def _lock() -> tuple[Grant, Undo | None]:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT_AND_FUTURE):
        reason = os.strerror(ctypes.get_errno())
        return Grant("mlockall", False, f"{reason}; raise the memlock limit"), None
    return Grant("mlockall", True, "present and future pages"), libc.munlockall


def _slack() -> tuple[Grant, Undo | None]:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_TIMERSLACK, _LEAST_SLACK_NS, 0, 0, 0):
        return Grant("timer slack", False, os.strerror(ctypes.get_errno())), None
    undo = partial(libc.prctl, _PR_SET_TIMERSLACK, _USUAL_SLACK, 0, 0, 0)
    return Grant("timer slack", True, f"{_LEAST_SLACK_NS} ns"), undo


def _stay_awake(microseconds: int, processor: Processor | None) -> tuple[Grant, Undo | None]:
    """A processor, or none for all, sleeps no deeper than it wakes up from in this time."""
    item = f"CPU DMA latency {microseconds} us"
    alone = ""
    if processor is not None:
        wanted = str(microseconds or _NONE)
        file = _PROCESSORS / f"cpu{_number(processor)}" / _RESUME_LATENCY
        try:
            before = file.read_text(encoding="ascii").strip()
            file.write_text(wanted, encoding="ascii")
        except OSError as error:
            alone = f", not on its own alone: {file}: {error.strerror}"
        else:
            # What a killed daemon has left there is nobody's wish.
            usual = _ANY if before == wanted else before
            undo = partial(file.write_text, usual, encoding="ascii")
            return Grant(item, True, "on the daemon's processor while it runs"), undo
    try:
        # Holds as long as it is open.
        descriptor = os.open(_DMA_LATENCY, os.O_WRONLY | os.O_CLOEXEC)
    except OSError as error:
        detail = f"{_DMA_LATENCY}: {error.strerror}; run as root or let the group write to it"
        return Grant(item, False, detail), None
    os.write(descriptor, struct.pack("i", microseconds))
    detail = f"on every processor while the daemon runs{alone}"
    return Grant(item, True, detail), partial(os.close, descriptor)


def _reserve(mebibytes: int) -> tuple[Grant, Undo | None]:
    """Touch stack and heap, and let the heap keep what it has had: no page fault is left for a
    tick. What is mapped later, such as rings, `_lock` brings in at once."""
    _touch_stack(_STACK_DEPTH)
    item = f"heap of {mebibytes} MiB"
    if not mebibytes:
        return Grant("stack", True, "touched"), None
    libc = ctypes.CDLL(None)
    # 1 is success. Without mapped blocks the heap grows in one piece, and is never trimmed.
    if not (libc.mallopt(_M_TRIM_THRESHOLD, _NEVER) and libc.mallopt(_M_MMAP_MAX, 0)):
        return Grant(item, False, "this C library has no mallopt; it is glibc that has"), None
    block = bytearray(mebibytes * _MIB)
    block[::4096] = b"\1" * len(block[::4096])

    def undo() -> None:
        libc.mallopt(_M_TRIM_THRESHOLD, _USUAL_TRIM)
        libc.mallopt(_M_MMAP_MAX, _USUAL_MMAPS)

    return Grant(item, True, "touched and kept, and the stack"), undo


def _touch_stack(depth: int) -> None:
    if depth:
        list(map(_touch_stack, (depth - 1,)))
