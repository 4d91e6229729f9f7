"""A run in real time as a user starts it, and what its log says about time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.tools.log import open as open_log

Array = NDArray[np.float64]

CONFIG = "config/can.yaml"
SCENARIO = "hold"
_IN_MEMORY = Path("/dev/shm")  # noqa: S108


@dataclass(frozen=True)
class Played:
    """Every tick of a run from the first on, us."""

    wakeup: Array
    """how late; with the ticks missed before it, as cyclictest has it"""
    act: Array
    cycle: Array
    """collect, act and publish"""
    response: Array
    """from when the tick was due to its outputs' being sent"""
    whole: Array
    """the cycle and what follows it: the record, events, people"""
    own: int
    host: int
    late: int
    """times, not ticks, that the host was more than a period late"""
    faults: tuple[str, ...]
    """why runs ended that did not come to their end"""

    @classmethod
    def of(cls, path: Path, period_us: float, faults: tuple[str, ...] = ()) -> Played:
        timing = open_log(path)["/tonus/timing"]
        steps = np.diff(timing["tick"].astype(np.int64), prepend=timing["tick"][:1].astype(int) - 1)
        wakeup = timing["wakeup_us"] + (steps - 1) * period_us
        cycle = timing["collect_us"] + timing["compute_us"] + timing["publish_us"]
        host = np.diff(timing["missed_host"].astype(np.int64), prepend=0)
        return cls(
            wakeup.astype(np.float64),
            timing["compute_us"].astype(np.float64),
            cycle.astype(np.float64),
            (wakeup + cycle).astype(np.float64),
            (cycle + np.append(timing["after_us"][1:], 0.0)).astype(np.float64),
            int(timing["missed_own"][-1]),
            int(timing["missed_host"][-1]),
            int((host > 0).sum()),
            faults,
        )


def together(runs: list[Played]) -> Played:
    """Several runs as one."""
    return Played(
        *(np.concatenate([getattr(run, name) for run in runs]) for name in _COLUMNS),
        *(sum(getattr(run, name) for run in runs) for name in ("own", "host", "late")),
        tuple(fault for run in runs for fault in run.faults),
    )


_COLUMNS = ("wakeup", "act", "cycle", "response", "whole")


def p99_9(values: Array) -> float:
    return float(np.percentile(values, 99.9))


Meanwhile = Callable[[subprocess.Popen[str], Path, Path], None]
"""Called with the daemon, its runtime folder and its output folder, while it runs."""


def play(
    seconds: float, *, period_us: float = 1000.0, meanwhile: Meanwhile | None = None
) -> Played:
    """``seconds`` of ACTIVE with lab and recorder, after a bring-up that counts as well.

    Raises RuntimeError with the daemon's words if it did not come to a run.
    """
    with _folders() as (runtime, out):
        command = [sys.executable, "-m", "tonus.tools.cli", "run", CONFIG, "--scenario", SCENARIO]
        command += ["--duration", str(seconds), "--out", str(out), "--json"]
        daemon = started(command, {"TONUS_RUNTIME_DIR": str(runtime)})
        try:
            if meanwhile is not None:
                meanwhile(daemon, runtime, out)
            summary = summary_of(daemon, seconds + 120.0)
        finally:
            daemon.kill()
            daemon.wait()
        faults = () if daemon.returncode == 0 else (str(summary["reason"]),)
        return Played.of(out / "run.mcap", period_us, faults)


def started(command: list[str], environment: dict[str, str]) -> subprocess.Popen[str]:
    """Standard error apart: with a cold cache it names what is compiled."""
    return subprocess.Popen(
        command,
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def summary_of(daemon: subprocess.Popen[str], timeout: float) -> dict[str, Any]:
    """What it prints within ``timeout`` s. Raises RuntimeError with the end of its standard error
    if that is no summary."""
    printed, told = daemon.communicate(timeout=timeout)
    try:
        summary: dict[str, Any] = json.loads(printed)
    except ValueError as error:
        raise RuntimeError(f"no run: {(told or printed).strip()[-400:]}") from error
    return summary


@contextmanager
def _folders() -> Iterator[tuple[Path, Path]]:
    """Sockets and rings in memory where there is such a place; the log on the disk."""
    memory = _IN_MEMORY if os.access(_IN_MEMORY, os.W_OK) else None
    with (
        tempfile.TemporaryDirectory(prefix="tonus-", dir=memory) as runtime,
        tempfile.TemporaryDirectory(prefix="tonus-", dir=".") as out,
    ):
        yield Path(runtime), Path(out)
