"""What a tick measures about itself: into its record, and into histograms of the run so far."""

from __future__ import annotations

from typing import NamedTuple

from tonus.runtime.signals import CycleRecord
from tonus.runtime.timing.histogram import Histogram
from tonus.runtime.timing.scheduler import Scheduler


class Marks(NamedTuple):
    """ns of the stopwatch at the borders between a tick's stages."""

    began: int
    collected: int
    computed: int
    published: int


class Latencies:
    """Histograms of a run so far; empty in virtual time, where the host is not to be seen."""

    def __init__(self) -> None:
        self.wakeup, self.compute, self.cycle, self.slack = (Histogram() for _ in range(4))

    def write(
        self,
        record: CycleRecord,
        scheduler: Scheduler,
        marks: Marks,
        due_ns: int,
        *,
        measured: bool,
    ) -> None:
        """The record's timing, and, where times are ``measured``, the histograms."""
        timing, misses, found = record.timing, scheduler.misses, scheduler.disturbances
        began, collected, computed, published = marks
        timing.due_ns[...] = due_ns
        timing.missed_own[...] = misses.own
        timing.missed_host[...] = misses.host
        timing.page_faults[...] = found.page_faults
        timing.switches[...] = found.switches
        timing.wakeup_us[...] = scheduler.wakeup_ns * 1e-3
        timing.collect_us[...] = (collected - began) * 1e-3
        timing.compute_us[...] = (computed - collected) * 1e-3
        timing.publish_us[...] = (published - computed) * 1e-3
        if measured:
            slack = due_ns + scheduler.period_ns - published
            timing.slack_us[...] = slack * 1e-3
            self.wakeup.add(scheduler.wakeup_ns)
            self.compute.add(computed - collected)
            self.cycle.add(published - began)
            self.slack.add(slack)
