"""The main job over pysoem: daemon, lab and recorder as processes, a veth pair between them.

Skipped, with the reason, where pysoem is missing or the host allows no such pair.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import yaml
from loop import QUICK

from tonus.config import load
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.run.lab_door import ask

pytest.importorskip("pysoem", reason="pysoem is not installed: the extra ethercat")

SECONDS = 4.0
LOST = 5


def _obstacle() -> str:
    """Why there can be no pair of interfaces here; empty: there can."""
    if shutil.which("ip") is None:
        return "there is no ip command"
    return "" if os.geteuid() == 0 else "a pair of network interfaces needs root"


OBSTACLE = _obstacle()
pytestmark = [pytest.mark.realtime, pytest.mark.skipif(bool(OBSTACLE), reason=OBSTACLE)]


def _configuration(folder: Path) -> Path:
    """The shipped one with interfaces of this test's own and a quicker sequence."""
    number = os.getpid() % 10000
    overrides = QUICK | {
        "fieldbus.interface": f"te{number}",
        "lab.ethercat.interface": f"tf{number}",
        "tracker.port": 47831,
    }
    config, _ = load("config/ethercat.yaml", scenario="hold", overrides=overrides)
    path = folder / "segment.yaml"
    path.write_text(yaml.safe_dump(config.model_dump(mode="json")))
    return path


def _run(path: Path, folder: Path, runtime: Path) -> str:
    """What the run said. Some frames are lost in it, one at a time."""
    command = [sys.executable, "-m", "tonus.tools.cli", "run", str(path), "--scenario", "hold"]
    command += ["--duration", str(SECONDS), "--out", str(folder)]
    over = threading.Event()

    def lose() -> None:
        """Once the daemon ticks; a lab that is not there yet or any more is no matter."""
        for _ in range(LOST):
            if over.wait(1.0):
                return
            try:
                ask({"op": "fault", "f": {"drop": 1}}, runtime / "lab.sock")
            except ToolError:
                continue

    environment = {**os.environ, "TONUS_RUNTIME_DIR": str(runtime)}
    thread = threading.Timer(6.0, lose)
    thread.start()
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=120, check=False
        )
    finally:
        over.set()
        thread.cancel()
        thread.join()
    return done.stdout + done.stderr


@pytest.mark.wide
def test_the_main_job_is_done_over_pysoem(tmp_path: Path) -> None:
    """One run for all: one that is tried again needs another run."""
    said = _run(_configuration(tmp_path), tmp_path / "out", tmp_path / "runtime")
    assert (tmp_path / "out" / "summary.json").exists(), said
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    log = open_log(tmp_path / "out" / "run.mcap")
    assert log.metadata["pacing"] == "distributed clock on timer"
    assert summary["state"] == "STANDBY", said
    assert not summary["faults"]
    # The goal is 0, and `make bench` counts them. A tick waits for the lab's frame, so where the
    # host takes the lab's processor, the miss looks like ours: only a pacing that fails shows here.
    assert summary["missed_ticks"] <= summary["ticks"] // 100
    names = {event.name for event in log.events()}
    assert not names & {"wrong_working_counter", "stale_frame", "slave_left_op", "slave_silent"}
    _frames_cost_their_timeout_and_no_tick(log)
    assert not Path(f"/sys/class/net/te{os.getpid() % 10000}").exists()


def _frames_cost_their_timeout_and_no_tick(log: Log) -> None:
    """SOEM by itself holds the tick for 4 ms and more."""
    lost = [event for event in log.events() if event.name == "frame_lost"]
    assert lost
    waited = [float(re.findall(r"within (\d+) us", event.text)[0]) for event in lost]
    assert sorted(waited)[len(waited) // 2] < 1000.0
