"""How soon the viewer shows a picture, and whether it keeps its pace.

    python -m tests.bench.view_pace [--minutes M] [--starts N] [--config FILE] [--set KEY=VALUE]

A run in real time, beside which a viewer is started N times; then so many minutes of it with one
viewer and one page that reads all it is sent. Then
the log of that run is opened, by that page and by a browser, where there is one: it draws in
software, which is too much beside a run (`tests.bench.drawn`). A start is told in steps: the page
is answered, the scene is sent, the first picture is told, and all that stands round it. The first
picture is there when the page has got the first moment with a state of the robot, and the scene.
Worth something on an idle host only.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import viser
import zstandard
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from tests.bench.drawn import browser
from tonus.runtime.timing import clock
from tonus.tools.view.live import Live
from tonus.tools.view.settings import settings

_TONUS = [sys.executable, "-m", "tonus.tools.cli"]
_PORT = 18095
_PATIENCE_S = 60.0
_START_S = 20.0
"""for each start, while the run goes on"""
_LONGER_S = 60.0
"""by which the run lasts longer than it is watched; it is ended before"""


@dataclass(frozen=True)
class Shown:
    """What a page has seen."""

    answered_s: float
    """from the start of the viewer's process until it answers for its page"""
    scene_s: float
    """until the scene has been sent, as the browser's client gets it"""
    first_s: float
    """until the first picture: scene and state"""
    complete_s: float
    """until all that stands round it"""
    processor_s: float
    """of the viewer's own until the first picture"""
    waited_s: float
    """until then, in which its main thread could have gone on and had no processor"""
    arrivals: np.ndarray
    """s, when each picture came"""
    times: np.ndarray
    """s of the robot's time in each"""

    @property
    def rate(self) -> float:
        """Pictures a second."""
        return (len(self.arrivals) - 1) / float(np.ptp(self.arrivals))

    def lag(self) -> np.ndarray:
        """s that each picture is later than the promptest one."""
        late = self.arrivals - self.times
        return np.asarray(late - late.min())


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--starts", type=int, default=7)
    parser.add_argument("--config", default="config/can.yaml")
    parser.add_argument("--set", action="append", default=[])
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        seconds = 60.0 * given.minutes
        patience = _START_S * given.starts
        with _run(folder, given.config, seconds + patience, given.set) as run:
            _start(folder, run, given.starts)
            live = _watch(folder, ["--run", str(run)], seconds)
        _tell("live", live)
        if np.ptp(live.arrivals) < seconds:
            last = (folder / "run.txt").read_text().replace("\r", "\n").splitlines()[-20:]
            print("  the run has ended before its time:", *last, sep="\n    ")
        print(f"  wanted: {settings().rate_hz:.0f} a second")
        log = folder / "out" / "run.mcap"
        what = f"log of {given.minutes:g} min, {log.stat().st_size / 1e6:.0f} MB"
        _draw(what, folder, [str(log)])
        _tell_start(what, _watch(folder, [str(log)], 1.0))


def _start(folder: Path, run: int, starts: int) -> None:
    """Several times, each with the page's all; the median, because the host is not the same from
    one to the next."""
    found = []
    for number in range(starts):
        found.append(_watch(folder, ["--run", str(run)], 0.0))
        _tell_start(f"start {number + 1}", found[-1])
    if found:
        first, processor, waited = (
            float(np.median([getattr(each, name) for each in found]))
            for name in ("first_s", "processor_s", "waited_s")
        )
        print(
            f"{starts} starts beside daemon and lab: first picture after {first:.2f} s in the "
            f"median, {processor:.2f} s of processor time and {waited:.2f} s of waiting for it",
            flush=True,
        )


def _draw(what: str, folder: Path, arguments: list[str]) -> None:
    """With a viewer and a browser, where there is one."""
    with browser() as opened:
        if opened is None:
            print(f"{what}: no Chromium, or no Playwright, to draw it")
            return
        began = clock.wall_seconds()
        with _viewer(folder, arguments):
            steps = opened(f"http://127.0.0.1:{_PORT}/")
        told = ", ".join(f"{name} {at - began:.2f}" for name, at in steps.items())
        print(f"{what}, in a browser, after s: {told}", flush=True)


def _tell_start(what: str, shown: Shown) -> None:
    print(
        f"{what}: first picture after {shown.first_s:.2f} s (page answered {shown.answered_s:.2f}, "
        f"scene sent {shown.scene_s:.2f}; until it {shown.processor_s:.2f} s of processor time and "
        f"{shown.waited_s:.2f} s of waiting for a processor; plots and events "
        f"{shown.complete_s:.2f})",
        flush=True,
    )


def _tell(what: str, shown: Shown) -> None:
    lag = 1e3 * shown.lag()
    gaps = 1e3 * np.diff(shown.arrivals)
    third = max(len(lag) // 3, 1)
    _tell_start(what, shown)
    print(
        f"  {len(lag)} pictures in "
        f"{np.ptp(shown.arrivals):.1f} s, {shown.rate:.2f} a second\n"
        f"  between two: median {np.median(gaps):.1f}, p99 {np.percentile(gaps, 99):.1f}, "
        f"most {gaps.max():.1f} ms\n"
        f"  behind the promptest: median of the first third {np.median(lag[:third]):.1f}, of the "
        f"last {np.median(lag[-third:]):.1f}, p99 {np.percentile(lag, 99):.1f} ms",
        flush=True,
    )


@contextmanager
def _run(folder: Path, config: str, seconds: float, changes: list[str]) -> Iterator[int]:
    """A daemon in real time, from its first record on, to its end; gives its process number."""
    out = folder / "out"
    command = [*_TONUS, "run", config, "--out", str(out)]
    command += ["--duration", str(seconds + _LONGER_S), *(f"--set={each}" for each in changes)]
    environment = _environment(folder)
    with (folder / "run.txt").open("w") as text:
        run = subprocess.Popen(command, stdout=text, stderr=subprocess.STDOUT, env=environment)
        try:
            rings = folder / "runtime" / f"run-{run.pid}"
            _until((rings / "run.json").exists, run, folder)
            live = Live(rings)
            _until(lambda: bool(len(live.advance().newest)), run, folder)
            live.close()
            yield run.pid
        finally:
            run.terminate()
            run.wait()


def _until(condition: Callable[[], bool], run: subprocess.Popen[bytes], folder: Path) -> None:
    for _ in range(int(_PATIENCE_S / 0.05)):
        if condition():
            return
        if run.poll() is not None:
            break
        clock.pause(0.05)
    sys.exit(f"the run does not tick: {(folder / 'run.txt').read_text()}")


@contextmanager
def _viewer(folder: Path, arguments: list[str]) -> Iterator[subprocess.Popen[str]]:
    """From its start on, to be asked as soon as it has told its address."""
    viewer = subprocess.Popen(
        [*_TONUS, "view", *arguments, "--port", str(_PORT)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=_environment(folder),
        text=True,
    )
    assert viewer.stdout is not None
    try:
        line = viewer.stdout.readline()
        if "open http" not in line:
            sys.exit(line)
        yield viewer
    finally:
        viewer.terminate()
        viewer.wait()


def _watch(folder: Path, arguments: list[str], seconds: float) -> Shown:
    """With a viewer and a page, from the viewer's start on."""
    began = clock.wall_seconds()
    origin = f"http://127.0.0.1:{_PORT}"
    with _viewer(folder, arguments) as viewer:
        with urlopen(origin, timeout=_PATIENCE_S) as page:  # on this host
            page.read()
        answered = clock.wall_seconds() - began
        sent: list[float] = []
        scene = threading.Thread(target=lambda: sent.append(_scene_sent() - began))
        scene.start()
        address = f"ws://127.0.0.1:{_PORT}/channel"
        with connect(address, origin=origin, max_size=None) as page:  # type: ignore[arg-type]
            first, complete, spent, arrivals, times = _read(page, seconds, viewer.pid)
        scene.join()
    begun = (answered, sent[0], max(sent[0], first - began), complete - began, *spent)
    return Shown(*begun, np.array(arrivals), np.array(times))


def _scene_sent() -> float:
    """When the last message of the scene as it stands has come: viser marks it."""
    address, origin = f"ws://127.0.0.1:{_PORT}/scene", f"http://127.0.0.1:{_PORT}"
    version = Subprotocol(f"viser-v{viser.__version__}")
    with connect(address, origin=origin, max_size=None, subprotocols=[version]) as scene:  # type: ignore[arg-type]
        while True:
            message = scene.recv(_PATIENCE_S)
            assert isinstance(message, bytes)
            length = int.from_bytes(message[8:16], "little")
            if b"ReplayDone" in zstandard.decompress(message[16 : 16 + length]):
                return clock.wall_seconds()


def _read(
    page: ClientConnection, seconds: float, viewer: int
) -> tuple[float, float, tuple[float, float], list[float], list[float]]:
    """When the first picture came, and what stands round it; until the first, the viewer's
    processor time and its wait for a processor; when each picture came, and its own time."""
    arrivals: list[float] = []
    times: list[float] = []
    complete = 0.0
    spent = (0.0, 0.0)
    while not arrivals or not complete or arrivals[-1] - arrivals[0] < seconds:
        message = json.loads(page.recv(_PATIENCE_S))
        if message["kind"] == "ended":
            break
        if message["kind"] == "hello":
            complete = clock.wall_seconds()
        if message["kind"] == "now" and message["runs"][0]["state"]:
            if not arrivals:
                spent = _processor_s(viewer), _waited_s(viewer)
            arrivals.append(clock.wall_seconds())
            times.append(message["t"])
    if not arrivals:
        sys.exit("the run has ended before the first picture of it")
    return arrivals[0], complete, spent, arrivals, times


def _processor_s(process: int) -> float:
    """User's and system's."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _waited_s(process: int) -> float:
    """Of the main thread, ready to run (Linux, Documentation/scheduler/sched-stats)."""
    return 1e-9 * float(Path(f"/proc/{process}/schedstat").read_text().split()[1])


def _environment(folder: Path) -> dict[str, str]:
    return {**os.environ, "TONUS_RUNTIME_DIR": str(folder / "runtime")}


if __name__ == "__main__":
    main()
