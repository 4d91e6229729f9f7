"""A long run in virtual time: memory flat, every tick counted, the log whole and readable.

python -m tests.soak [--minutes 30]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import threading
from pathlib import Path
from typing import Self

import numpy as np

from tonus.config import load
from tonus.runtime.states import Fault, State
from tonus.tools.log import open as open_log
from tonus.tools.run.composer import Order, Result, run

SAMPLE_S = 1.0
WARM = 0.25
"""share of the run after which memory may no longer grow"""
ALLOWED_KB_PER_MTICK = 4096
"""of growth, in a million ticks: less than 5 bytes a tick, which no leak of a Python object is"""


class Memory:
    """Memory of this process alone (kB), sampled beside a run; the rings are files and stay out."""

    def __init__(self) -> None:
        self.samples: list[int] = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _sample(self) -> None:
        while not self._over.wait(SAMPLE_S):
            status = Path("/proc/self/status").read_text(encoding="ascii")
            self.samples.append(int(status.split("RssAnon:")[1].split()[0]))

    def growth_kb(self) -> float:
        """Trend of the second and later quarters, over their length."""
        kept = np.array(self.samples[int(WARM * len(self.samples)) :], dtype=float)
        if len(kept) < 8:
            return float("nan")
        slope, _ = np.polyfit(np.arange(len(kept)), kept, 1)
        return float(slope * len(kept))


def judge(result: Result, memory: Memory, seconds: float) -> list[tuple[str, bool, str]]:
    """What was asked for, whether it holds, and the figure."""
    outcome = result.outcome
    log = open_log(result.log)
    ticks = np.concatenate(
        [batch["/tonus/timing"].messages["tick"] for batch in log.batches(["/tonus/timing"])]
    ).astype(np.int64)
    active = sum(
        int((batch["/tonus/state"].messages["state"] == State.ACTIVE).sum())
        for batch in log.batches(["/tonus/state"])
    )
    growth = memory.growth_kb()
    allowed = ALLOWED_KB_PER_MTICK * (1.0 - WARM) * outcome.ticks / 1e6 + 1024
    last = len(memory.samples) - 1
    tenths = [memory.samples[round(share * last / 10)] >> 10 for share in range(11)] if last else []
    expected = round(seconds * 1000)
    return [
        ("ends well", outcome.fault is Fault.NONE, outcome.reason),
        ("ticks missed", outcome.misses.own == outcome.misses.host == 0, str(outcome.misses)),
        (
            "ticks in the log",
            np.array_equal(ticks, np.arange(outcome.ticks)),
            f"{len(ticks)} of {outcome.ticks}, in order",
        ),
        ("ticks in ACTIVE", abs(active - expected) <= 1, f"{active} of {expected}"),
        ("log", log.damage is None, log.damage or f"whole, {result.log.stat().st_size >> 20} MiB"),
        (
            "memory",
            growth <= allowed,
            f"{' '.join(map(str, tenths))} MiB, tenth by tenth; trend after a quarter "
            f"{growth:.0f} kB, {allowed:.0f} allowed",
        ),
    ]


def main() -> int:
    """Returns 1 when something did not hold."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=float, default=30.0)
    seconds = parser.parse_args().minutes * 60.0
    config, scenario = load("config/direct.yaml", "sine_x")
    scenario = scenario.model_copy(update={"duration": seconds})
    print(f"{seconds:.0f} s of {scenario.name} in virtual time")
    with tempfile.TemporaryDirectory() as folder:
        order = Order(config, scenario, Path(folder), 1, True, lambda _: None, live=True)
        with Memory() as memory:
            result = run(order)
        period = config.control.rates.period
        print(f"{result.seconds:.0f} s, {result.realtime_factor(period):.2f} x real time")
        findings = judge(result, memory, seconds)
    for name, ok, text in findings:
        print(f"  {'ok    ' if ok else 'FAILED'} {name:<17} {text}")
    return 0 if all(ok for _, ok, _ in findings) else 1


if __name__ == "__main__":
    sys.exit(main())
