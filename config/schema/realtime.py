"""What the processes of a run in real time ask of the host, and what a missed tick leads to."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from tonus.config.schema.base import Count, NonNegative, Positive, Section, Share, no_boolean

Policy = Literal["require", "prefer", "off"]
Overrun = Literal["skip", "hold", "stop"]


def _off(value: Any) -> Any:
    """YAML reads a bare off as false, and nothing else can be meant by it here."""
    return "off" if value is False else value


Priority = Annotated[int, BeforeValidator(no_boolean), Field(ge=0, le=99)]
WatchPeriod = Annotated[int, BeforeValidator(no_boolean), Field(ge=100, le=100_000)]
WholeNumber = Annotated[int, BeforeValidator(no_boolean), Field(ge=0)]
Processor = WholeNumber | Literal["quietest"]
"""By its number, or the one that has served the fewest interrupts of devices so far."""
Processors = WholeNumber | tuple[WholeNumber, ...] | Literal["others"]
"""By their numbers, or all but the daemon's (the same, where there is one only)."""


class HostLimits(Section):
    """Limits for the measured figures of a host."""

    wakeup_good_us: Positive = 100.0
    """p99.9 of a bare wake-up for a period of 1 ms, in proportion for others"""
    wakeup_bad_us: Positive = 500.0
    steal_good_percent: NonNegative = 0.1
    steal_bad_percent: Positive = 1.0
    disk_good_mib_s: Positive = 20.0
    """a log with every CAN frame takes 2 MiB a second"""
    disk_bad_mib_s: Positive = 4.0
    lab_good_factor: Positive = 2.8
    """of real time, at which a run with its lab is played in virtual time on one processor; in real
    time lab, daemon and recorder share two processors, and are late together"""
    lab_bad_factor: Positive = 1.5
    can_queue: Count = 32
    """frames; a tick of one channel sends 4"""


class RealTime(Section):
    """What the daemon asks of the host. A key that is left out asks for nothing."""

    policy: Annotated[Policy, BeforeValidator(_off)]
    """require: no run without all of it; prefer: each refusal is reported; off: nothing is asked.
    Like ``overrun`` and ``overrun_ticks`` left out it is what `tonus.config.schema.place` says"""
    daemon_priority: Priority
    """SCHED_FIFO, 0 for none"""
    lab_priority: Priority
    recorder_priority: Priority
    lock_memory: bool
    daemon_cpu: Processor | None = None
    """null: wherever the kernel puts it, which may change"""
    lab_cpu: Processors | None = None
    recorder_cpu: Processors | None = None
    cpu_dma_latency_us: WholeNumber | None = None
    """longest wake-up from idle that a processor may take while the daemon runs; null: not asked"""
    awake: Literal["own", "all", "measured"] = "own"
    """of which processors that is asked: the daemon's, if it has one of its own; all; or what is
    found to be better at the start of a run"""
    kernel_workers: Literal["others"] | None = None
    """others: while the daemon runs, the kernel's unbound workers, which write files back among
    other things, are kept off its processor, if it has one of its own; null: not asked"""
    prefault_mib: WholeNumber = 0
    """MiB of heap touched, and kept from going back to the kernel, before anything is armed"""
    stall_watch_us: WatchPeriod | None = None
    """how often a process on another processor wakes up beside the daemon, so that the time for
    which the whole host stood still counts for no tick of its own; null: none does"""
    early_wake_us: WholeNumber = 0
    """how long before a tick the event loop is woken; the rest is slept outside of it"""
    spin_us: WholeNumber = 0
    """of this, how long the processor is kept busy rather than asleep"""
    controller_share: Share = 0.2
    """of the period that a controller which is not ours may take, measured before a run in real
    time (`tonus.tools.check.controller_time`)"""
    overrun: Overrun
    """on missed ticks, whoever's making: skip counts them; hold keeps the platform where it is;
    stop is a controlled stop"""
    overrun_ticks: Count
    """ticks missed at once that make an overrun"""
    host: HostLimits = HostLimits()

    def of(self, priority: int) -> int:
        """A priority to be asked for under this policy."""
        return 0 if self.policy == "off" else priority

    def on(self, processors: Processors | None) -> Processors | None:
        """Processors to be asked for under this policy."""
        return None if self.policy == "off" else processors

    @model_validator(mode="after")
    def _spins_within_the_early_wake(self) -> RealTime:
        if self.spin_us > self.early_wake_us:
            raise ValueError("spin_us must not be longer than early_wake_us, which it is a part of")
        return self
