"""What viewers cost the ticks: runs in real time with none, one and five, in alternation.

    python -m tests.bench.viewers [--rounds N] [--seconds S]

Of the five one is stopped by SIGSTOP and one has a page that floods it. Each row is one run; the
last lines are medians over the rounds, and how far the runs without a viewer lie apart. Worth
something on an idle host only.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import connect

from tonus.runtime.timing import clock
from tonus.tools.view.settings import settings

_TONUS = [sys.executable, "-m", "tonus.tools.cli"]
_CASES = (0, 1, 5)
_FIRST_PORT = 18090
_START_S = 60.0


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--config", default="config/can.yaml")
    given = parser.parse_args()
    found: dict[int, list[tuple[float, float]]] = {case: [] for case in _CASES}
    print("viewers  wake-up p99.9  cycle p99.9, us")
    for _ in range(given.rounds):
        for case in _CASES:
            wakeup, cycle = _run(given.config, given.seconds, case)
            found[case].append((wakeup, cycle))
            print(f"{case:7}  {wakeup:13.0f}  {cycle:11.0f}", flush=True)
    without = np.array(found[0])
    print(f"without: apart by {np.ptp(without[:, 0]):.0f} and {np.ptp(without[:, 1]):.0f} us")
    for case in _CASES:
        wakeup, cycle = np.median(np.array(found[case]), axis=0)
        print(f"median with {case}: {wakeup:.0f} and {cycle:.0f} us")


def _run(config: str, seconds: float, viewers: int) -> tuple[float, float]:
    """p99.9 of wake-up and cycle in us of one run."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as cleanup:
        folder = Path(name)
        environment = {**os.environ, "TONUS_RUNTIME_DIR": str(folder / "runtime")}
        out = folder / "out"
        command = [*_TONUS, "run", config, "--duration", str(seconds), "--out", str(out)]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
        run = subprocess.Popen([*command, "--json"], **quiet)  # type: ignore[call-overload]
        for number in range(viewers):
            cleanup.enter_context(_viewer(run.pid, number, environment))
        run.wait()
        summary = json.loads((out / "summary.json").read_text())
        return float(summary["wakeup_us"]["p99_9"]), float(summary["cycle_us"]["p99_9"])


@contextmanager
def _viewer(run: int, number: int, environment: dict[str, str]) -> Iterator[None]:
    """The second is stopped, the third flooded; each has a page that reads."""
    port = _FIRST_PORT + number
    viewer = subprocess.Popen(
        [*_TONUS, "view", "--run", str(run), "--port", str(port)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
        text=True,
    )
    assert viewer.stdout is not None
    page = None
    try:
        if "open http" in viewer.stdout.readline():
            page = _Page(port, flood=number == 2)
            if number == 1:
                os.kill(viewer.pid, signal.SIGSTOP)
        yield
    finally:
        if page is not None:
            page.close()
        viewer.kill()
        viewer.wait()


class _Page:
    """A process that reads a viewer's channel as a page does, or floods it."""

    def __init__(self, port: int, *, flood: bool) -> None:
        arguments = [sys.executable, "-m", "tests.bench.viewers_page", str(port)]
        # A library that is thrown out in mid-message prints a traceback of its own.
        self._process = subprocess.Popen(
            [*arguments, "flood"] if flood else arguments, stderr=subprocess.DEVNULL
        )

    def close(self) -> None:
        self._process.kill()
        self._process.wait()


def read(port: int, *, flood: bool) -> None:
    """Until killed."""
    origin = f"http://127.0.0.1:{port}"
    burst = settings().message_burst
    while True:
        try:
            with connect(f"ws://127.0.0.1:{port}/channel", origin=origin, max_size=None) as page:  # type: ignore[arg-type]
                while True:
                    for _ in range(burst if flood else 0):
                        page.send('{"do": "alive"}')
                    page.recv(_START_S)
        except (ConnectionClosed, WebSocketException, OSError, EOFError):
            clock.pause(0.05)


if __name__ == "__main__":
    main()
