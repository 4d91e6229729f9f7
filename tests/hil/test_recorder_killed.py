"""A recorder killed in mid-run is started again, and nothing that was published is missing."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from tonus.tools.log import open as open_log
from tonus.tools.log.several import segments

pytestmark = pytest.mark.realtime

RING_S = 40.0
"""for a recorder to come back in: on a host that is busy its start takes longer than the 8 s that a
ring usually lasts"""
KILLS_S = (3.0, 6.0)
"""after the first look at the process"""


def recorders(ring_dir_of: int) -> list[int]:
    """Process ids of the recorders, not their keepers, of the run with this process id."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            ours = any(re.search(rb"run-%d(/|$)" % ring_dir_of, word) for word in words)
            if ours and words[1:3] == [b"-m", b"tonus.tools.run.recorder_process"]:
                found.append(int(entry.name))
    return found


def run_and_kill(out: Path, runtime: Path) -> tuple[int, str]:
    """How many recorders were killed, and what the run said."""
    command = [sys.executable, "-m", "tonus.tools.cli", "run", "config/can.yaml", "--duration", "4"]
    command += ["--set", f"recording.ring_s={RING_S}"]
    environment = {**os.environ, "TONUS_RUNTIME_DIR": str(runtime)}
    with subprocess.Popen(
        [*command, "--out", str(out)],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        killed: list[int] = []

        def kill() -> None:
            for pid in recorders(process.pid):
                os.kill(pid, signal.SIGKILL)
                killed.append(pid)

        timers = []
        assert process.stdout is not None
        said = []
        for line in process.stdout:
            said.append(line)
            if not timers and "SCHED_FIFO" in line:
                timers = [threading.Timer(delay, kill) for delay in KILLS_S]
                for timer in timers:
                    timer.start()
    return len(killed), "".join(said)


@pytest.mark.wide
def test_nothing_is_missing(tmp_path: Path) -> None:
    out = tmp_path / "out"
    killed, said = run_and_kill(out, tmp_path / "run")
    assert killed == len(KILLS_S), said
    log = open_log(out / "run.mcap")
    ticks = log["/tonus/timing"]["tick"]
    assert sum(int(count) for count in log.recorded.values()) == 0
    missed = log["/tonus/timing"]["missed_own"][-1] + log["/tonus/timing"]["missed_host"][-1]
    assert int(ticks[-1]) + 1 == len(ticks) + int(missed)
    assert np.array_equal(np.unique(ticks), ticks), "each once"
    names = [event.name for event in log.events()]
    restarted = names.count("recorder_restarted")
    # One killed before its first chunk has left nothing to go on from, and its file is begun anew.
    assert 1 <= restarted <= len(KILLS_S)
    # One killed after its file was begun and before its first chunk leaves a file that tells of no
    # restart: there are as many files as restarts told, or one more for each such.
    assert 1 + restarted <= len(segments(out / "run.mcap")) <= 1 + len(KILLS_S)
