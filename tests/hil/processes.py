"""A daemon with its lab and its recorder as processes of their own, to be killed by tests."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml
from loop import QUICK

from tonus.config.loader import HERE
from tonus.runtime.recording.ring import RingReader
from tonus.runtime.timing import clock
from tonus.tools.log import Log
from tonus.tools.log import open as open_log

TONUS = [sys.executable, "-m", "tonus.tools.cli"]
RECORDING = ("tonus.tools.run.recorder_keeper", "tonus.tools.run.recorder_process")
_STEP_S = 0.02


def configuration(folder: Path, port: int) -> Path:
    """The shipped CAN configuration with a quicker sequence and a tracker port of its own."""
    tracker = yaml.safe_load((HERE / "tracker.yaml").read_text()) | {"port": port}
    (folder / "tracker.yaml").write_text(yaml.safe_dump(tracker))
    lines = []
    for line in (HERE / "can.yaml").read_text().splitlines():
        name = line.rsplit("!include ", 1)[-1]
        ours = "!include" in line and name != "tracker.yaml"
        lines.append(line.replace(name, str(HERE / name)) if ours else line)
    lines.append(f"set: {json.dumps(QUICK)}")
    path = folder / "can.yaml"
    path.write_text("\n".join(lines) + "\n")
    return path


def wait_for(condition: Callable[[], bool], seconds: float = 120.0) -> None:
    for _ in range(int(seconds / _STEP_S)):
        if condition():
            return
        clock.pause(_STEP_S)
    raise AssertionError("it did not happen in time")


class Running:
    """One `tonus run`; `part` finds its helpers."""

    def __init__(self, folder: Path, out: Path, port: int, *arguments: str) -> None:
        self.folder, self.out = folder, out
        config = configuration(folder, port)
        self.environment = {**os.environ, "TONUS_RUNTIME_DIR": str(folder / "runtime")}
        self.text = out.with_suffix(".txt")
        self.process = subprocess.Popen(
            [*TONUS, "run", str(config), "--out", str(out), *arguments],
            cwd=HERE.parent,
            env=self.environment,
            stdout=self.text.open("w"),
            stderr=subprocess.STDOUT,
        )
        self._reader: RingReader | None = None
        self.rings = folder / "runtime" / f"run-{self.process.pid}"

    @property
    def log(self) -> Path:
        return self.out / "run.mcap"

    def reader(self) -> RingReader:
        """Of the cycles; it goes on reading when the file is gone."""
        if self._reader is not None:
            return self._reader
        path = self.rings / "cycle.ring"
        wait_for(lambda: path.exists() or self.process.poll() is not None)
        assert path.exists(), self.text.read_text()
        self._reader = RingReader.open(path)
        return self._reader

    def kill_part(self, module: str) -> bool:
        """Whether a helper was killed: a stalled host may have ended the run in a fault before."""
        try:
            os.kill(self.part(module), signal.SIGKILL)
        except ProcessLookupError:
            assert self.process.wait(60) == 1, self.text.read_text()
            return False
        return True

    def part(self, module: str) -> int:
        """Process id of a helper. Raises `ProcessLookupError`."""
        for directory in Path("/proc").glob("[0-9]*"):
            try:
                words = (directory / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            ours = any(str(self.rings).encode() in word for word in words)
            if ours and words[1:3] == [b"-m", module.encode()]:
                return int(directory.name)
        raise ProcessLookupError(f"no {module} runs")

    def end(self, seconds: float = 60.0) -> int:
        """By a controlled stop; whoever still records has ended then, too."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        code = self.process.wait(seconds)
        wait_for(lambda: not any(map(self.runs, RECORDING)))
        return code

    def runs(self, module: str) -> bool:
        try:
            self.part(module)
        except ProcessLookupError:
            return False
        return True

    def kill(self) -> bool:
        """Whether it was killed: a stalled host may have ended the run in a fault before."""
        self.process.kill()
        return self.process.wait() == -signal.SIGKILL


def whole(path: Path) -> bool:
    return path.exists() and open_log(path).damage is None


def cycles_in(*paths: Path) -> list[int]:
    """Numbers of the ring's records that the files hold, those in two of them once."""
    numbers: set[int] = set()
    for path in paths:
        log: Log = open_log(path)
        if "/tonus/timing" in log:
            for batch in log.batches(["/tonus/timing"]):
                numbers |= set(batch["/tonus/timing"].sequence.tolist())
    return sorted(numbers)


def nothing_missing(published: int, *paths: Path) -> None:
    np.testing.assert_array_equal(cycles_in(*paths), np.arange(published))
