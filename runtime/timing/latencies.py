"""What a tick measures about itself: into its record, and into histograms of the run so far."""

from __future__ import annotations

from typing import NamedTuple

from tonus.runtime.recording.record_writers import write_timing
from tonus.runtime.signals import CycleRecord
from tonus.runtime.timing.histogram import Histogram
from tonus.runtime.timing.scheduler import Scheduler


class Marks(NamedTuple):
    """ns of the stopwatch at the borders between a tick's stages."""

    began: int
    collected: int
    computed: int
    published: int


_TIMES = 14


class Latencies:
    """Histograms of a run so far; empty in virtual time, where the host is not to be seen."""

    def __init__(self) -> None:
        self.wakeup, self.compute, self.cycle, self.slack = (Histogram() for _ in range(4))

    @staticmethod
    def rehearse(record: CycleRecord) -> None:
        """So that nothing is left to compile in the first tick."""
        write_timing(record.data, *[0] * _TIMES)

    def write(
        self,
        record: CycleRecord,
        scheduler: Scheduler,
        marks: Marks,
        due_ns: int,
        others: tuple[int, int, int],
        *,
        measured: bool,
    ) -> None:
        """The record's timing, and, where times are ``measured``, the histograms. ``others``: ns of
        the bus, of the processor, and from the last tick's publish to its end."""
        misses, found = scheduler.misses, scheduler.disturbances
        began, collected, computed, published = marks
        slack = due_ns + scheduler.period_ns - published if measured else 0
        write_timing(
            record.data,
            due_ns,
            misses.own,
            misses.host,
            found.page_faults,
            found.switches,
            *marks,
            scheduler.wakeup_ns,
            *others,
            slack,
        )
        if measured:
            self.wakeup.add(scheduler.wakeup_ns)
            self.compute.add(computed - collected)
            self.cycle.add(published - began)
            self.slack.add(slack)
