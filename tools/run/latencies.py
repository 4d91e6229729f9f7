"""A run's timing for people and for scripts: rows of text, and histograms as plain lists."""

from __future__ import annotations

from typing import Any

from tonus.runtime.timing.latencies import Latencies
from tonus.tools.run.summary import Summary


def buckets(latencies: Latencies) -> dict[str, list[list[float]]]:
    """[upper end in us, count] of every filled bin, by name."""
    return {
        name: [[round(upper * 1e-3, 3), count] for upper, count in histogram.filled()]
        for name, histogram in vars(latencies).items()
    }


def rows(summary: Summary) -> list[tuple[str, str]]:
    """Title and text of what a run in real time says about its timing."""
    found = []
    for title, key in (("wake-up", "wakeup_us"), ("cycle", "cycle_us"), ("after it", "after_us")):
        if summary.get(key) is not None:
            found.append((title, _percentiles(summary[key])))
    slack: dict[str, Any] | None = summary.get("slack_us")
    if slack is not None:
        text = f"p50 {slack['p50']:.0f}  p1 {slack['p1']:.0f}  least {slack['min']:.0f} us"
        found.append(("slack", text))
    faults, switches = summary.get("active_page_faults"), summary.get("active_switches")
    if faults is not None:
        text = f"{faults} page faults, {switches} context switches within ticks of ACTIVE"
        found.append(("disturbed by", text))
    return found


def _percentiles(values: dict[str, float]) -> str:
    return "  ".join(
        f"{name.replace('_', '.')} {values[name]:.0f}" for name in ("p50", "p99", "p99_9", "max")
    ) + " us"  # fmt: skip
