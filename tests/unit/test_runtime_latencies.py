"""Each time that a tick measures about itself is recorded under its own name."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from tonus.runtime.signals import CycleRecord
from tonus.runtime.timing.latencies import Latencies, Marks

US = 1000
EXPECTED = {
    "due_ns": 5_000_000,
    "missed_own": 2,
    "missed_host": 3,
    "page_faults": 5,
    "switches": 7,
    "wakeup_us": 11.0,
    "bus_us": 13.0,
    "collect_us": 17.0,
    "compute_us": 19.0,
    "publish_us": 23.0,
    "processor_us": 29.0,
    "after_us": 31.0,
}


@pytest.mark.parametrize(("measured", "slack"), [(True, 1000.0 - 70.0), (False, 0.0)])
def test_each_time_has_its_place(measured: bool, slack: float) -> None:
    record, latencies = CycleRecord(8), Latencies()
    scheduler: Any = SimpleNamespace(
        misses=SimpleNamespace(own=2, host=3),
        disturbances=SimpleNamespace(page_faults=5, switches=7),
        wakeup_ns=11 * US,
        period_ns=1_000_000,
    )
    due = EXPECTED["due_ns"]
    began = int(due) + 11 * US
    marks = Marks(began, began + 17 * US, began + 36 * US, began + 59 * US)
    others = (13 * US, 29 * US, 31 * US)
    latencies.write(record, scheduler, marks, int(due), others, measured=measured)
    for name, value in EXPECTED.items():
        assert getattr(record.timing, name) == value, name
    assert record.timing.slack_us == slack
    assert latencies.cycle.count == int(measured)
