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
from typing import Any

import pytest
import yaml
from hil.processes import attempts
from loop import QUICK

from tonus.config import load
from tonus.runtime.timing.realtime import stolen_jiffies
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.run.lab_door import ask

pytest.importorskip("pysoem", reason="pysoem is not installed: the extra ethercat")
pytestmark = pytest.mark.realtime

Finished = tuple[dict[str, Any], Log, str]
SECONDS = 4.0
LOST = 5
STOLEN_TICKS = 5
"""A host that takes more than this from a run is no place for it."""
STOLEN_SHARE = 0.005
"""of all processor time: with less of it stolen a bring-up has no excuse"""


def _obstacle() -> str:
    """Why there can be no pair of interfaces here; empty: there can."""
    if shutil.which("ip") is None:
        return "there is no ip command"
    return "" if os.geteuid() == 0 else "a pair of network interfaces needs root"


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


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """A run that came up, and what it said."""
    reason = _obstacle()
    if reason:
        pytest.skip(reason)
    base = tmp_path_factory.mktemp("segment")
    path = _configuration(base)
    for folder in attempts(base):
        before = stolen_jiffies()
        said = _run(path, folder, base / "runtime")
        stolen, total = (now - then for now, then in zip(stolen_jiffies(), before, strict=True))
        # Frames are lost in a bring-up, too, while the host stops the lab.
        if (folder / "summary.json").exists() or stolen < STOLEN_SHARE * total:
            break
    assert (folder / "summary.json").exists(), said
    summary = json.loads((folder / "summary.json").read_text())
    return summary, open_log(folder / "run.mcap"), said


@pytest.fixture
def undisturbed(finished: Finished) -> Finished:
    """The same, if the host has let it."""
    taken = finished[0]["missed_by_host"]
    if taken > STOLEN_TICKS:
        pytest.skip(f"the host took {taken} ticks from the run")
    return finished


def test_the_run_is_paced_by_the_distributed_clock(finished: Finished) -> None:
    assert finished[1].metadata["pacing"] == "distributed clock on timer"


def test_the_main_job_is_done_over_pysoem(undisturbed: Finished) -> None:
    summary, _, said = undisturbed
    assert summary["state"] == "STANDBY", said
    assert not summary["faults"]
    # The goal is 0, and `make bench` counts them. A tick waits for the lab's frame, so where the
    # host takes the lab's processor, the miss looks like ours: only a pacing that fails shows here.
    assert summary["missed_ticks"] <= summary["ticks"] // 100


def test_no_working_counter_was_wrong(undisturbed: Finished) -> None:
    names = {event.name for event in undisturbed[1].events()}
    assert not names & {"wrong_working_counter", "stale_frame", "slave_left_op", "slave_silent"}


def test_a_lost_frame_costs_its_timeout_and_no_tick(undisturbed: Finished) -> None:
    """SOEM by itself holds the tick for 4 ms and more."""
    lost = [event for event in undisturbed[1].events() if event.name == "frame_lost"]
    assert lost
    waited = [float(re.findall(r"within (\d+) us", event.text)[0]) for event in lost]
    assert sorted(waited)[len(waited) // 2] < 1000.0


@pytest.mark.usefixtures("finished")
def test_the_pair_of_interfaces_is_gone_afterwards() -> None:
    assert not Path(f"/sys/class/net/te{os.getpid() % 10000}").exists()
