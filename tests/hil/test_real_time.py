"""Daemon, lab and recorder as processes of their own, in real time, as a user starts them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from loop import QUICK

from tonus.config.document import dotted
from tonus.config.loader import HERE
from tonus.config.schema.place import DEFAULTS
from tonus.runtime.recording.ring import RingReader
from tonus.tools.log import open as open_log
from tonus.tools.log.replay import replay

pytestmark = pytest.mark.realtime

TONUS = [sys.executable, "-m", "tonus.tools.cli"]
ROOT = HERE.parent


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Sockets and rings of this test in a folder of its own."""
    return _environment(tmp_path)


def _environment(folder: Path) -> dict[str, str]:
    return {**os.environ, "TONUS_RUNTIME_DIR": str(folder / "runtime")}


def _quick_configuration(folder: Path, *, lab: bool = True, port: int = 47811) -> Path:
    """The shipped CAN configuration with a quicker sequence, as files of its own."""
    tracker = yaml.safe_load((HERE / "tracker.yaml").read_text()) | {"port": port}
    (folder / "tracker.yaml").write_text(yaml.safe_dump(tracker))
    lines = []
    for line in (HERE / "can.yaml").read_text().splitlines():
        if line.startswith("lab:") and not lab:
            continue
        name = line.rsplit("!include ", 1)[-1]
        if "!include" in line and name != "tracker.yaml":
            lines.append(line.replace(name, str(HERE / name)))
        else:
            lines.append(line)
    if not lab:  # another process has it: the same host, without real time
        lines.append(f"relaxed: [{', '.join(map(dotted, DEFAULTS))}]")
    lines.append(f"set: {json.dumps(QUICK)}")
    path = folder / ("robot.yaml" if not lab else "can.yaml")
    path.write_text("\n".join(lines) + "\n")
    return path


def _run(
    environment: dict[str, str], *arguments: str, seconds: float = 60.0
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*TONUS, *arguments],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=seconds,
        check=False,
    )


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path, Path]:
    """What a run over CAN said, its folder, and that of its sockets and rings."""
    folder = tmp_path_factory.mktemp("finished")
    config, environment = _quick_configuration(folder), _environment(folder)
    out = folder / "out"
    arguments = (str(config), "--scenario", "hold", "--duration", "1", "--out", str(out))
    result = _run(environment, "run", *arguments)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout, out, folder / "runtime"


def test_a_run_leaves_log_summary_and_picture(finished: tuple[str, Path, Path]) -> None:
    said, out, runtime = finished
    assert "watch for stalls" not in said, "it is told only if there is none, or not to the end"
    assert said.rstrip().splitlines()[-1].startswith("STANDBY: ")
    assert "ACTIVE" in said
    summary = json.loads((out / "summary.json").read_text())
    assert summary["state"] == "STANDBY"
    assert (out / "overview.png").read_bytes().startswith(b"\x89PNG")
    log = open_log(out / "run.mcap")
    assert log.damage is None
    assert len(log["/tonus/state"]) == summary["ticks"]
    assert sum(count for _, count in summary["histograms"]["wakeup"]) == summary["ticks"]
    assert summary["slack_us"]["min"] <= summary["slack_us"]["p50"] < 1000.0
    assert json.loads(log.attachments["doctor.json"])["verdict"] == log.metadata["doctor.verdict"]
    # How many ticks the host lets pass is its own affair; that each is accounted for is ours.
    ticks = log["/tonus/timing"]["tick"].astype(np.int64)
    missed = int(ticks[-1]) + 1 - len(ticks)
    assert missed == summary["missed_ticks"] + summary["missed_by_host"]
    assert not list(runtime.glob("run-*"))


def test_its_replay_makes_every_output_again(finished: tuple[str, Path, Path]) -> None:
    log = open_log(finished[1] / "run.mcap")
    again = replay(log)
    assert again.first is None, again.first
    assert again.ticks == len(log["/tonus/state"])


@pytest.mark.wide
def test_a_silent_node_ends_the_run_with_its_name(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    config = _quick_configuration(tmp_path, port=47813)
    fault = {"at": 1.5, "kind": "unplug", "channel": "can2", "node": 6}
    scenario = {
        "name": "pulled",
        "description": "A drive loses its plug.",
        "duration": 10.0,
        "reference": {"kind": "hold"},
        "lab": {"faults": [fault]},
    }
    path = tmp_path / "pulled.yaml"
    path.write_text(yaml.safe_dump(scenario))
    out = tmp_path / "out"
    result = _run(environment, "run", str(config), "--scenario", str(path), "--out", str(out))
    assert result.returncode == 1, result.stdout + result.stderr
    last = result.stdout.rstrip().splitlines()[-1]
    assert "can2/6" in last
    assert "stopped answering" in last
    summary = json.loads((out / "summary.json").read_text())
    assert [fault["name"] for fault in summary["faults"]] == ["drive_lost"]


def test_a_killed_daemon_leaves_stopped_drives_and_every_published_cycle(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    """Drives outlive it only as long as their watchdog. The lab alone in one process, a daemon
    without a lab in another, killed while it holds."""
    shared = _quick_configuration(tmp_path, port=47814)
    robot = _quick_configuration(tmp_path, lab=False, port=47814)
    lab = subprocess.Popen(
        [*TONUS, "lab", str(shared)], cwd=ROOT, env=environment, stdout=subprocess.DEVNULL
    )
    try:
        _wait_for((tmp_path / "runtime" / "can0.sock").exists)
        published, path = _killed_while_it_holds(robot, tmp_path, environment)
        time.sleep(0.3)
        word = _statusword(environment)
        assert word & 0x6F != 0x27, f"statusword 0x{word:04X}: still in Operation Enabled"
        # The fault reaction brakes first, and how long that takes is the robot's affair.
        _wait_for(lambda: _statusword(environment) & 0x4F == 0x08)
    finally:
        lab.send_signal(signal.SIGINT)
        assert lab.wait(10) == 0
    _wait_for(lambda: path.exists() and open_log(path).damage is None)
    log = open_log(path)
    ticks = log["/tonus/timing"]["tick"]
    assert len(ticks) == published
    assert np.all(np.diff(ticks.astype(np.int64)) > 0)
    assert any(event.name == "daemon_lost" for event in log.events())


def _killed_while_it_holds(
    config: Path, folder: Path, environment: dict[str, str]
) -> tuple[int, Path]:
    """A daemon; how many cycles it had published, and its log."""
    out = folder / "out"
    command = [*TONUS, "run", str(config), "--scenario", "hold", "--duration", "30"]
    daemon = subprocess.Popen(
        [*command, "--out", str(out)], cwd=ROOT, env=environment, stdout=subprocess.DEVNULL
    )
    rings = folder / "runtime" / f"run-{daemon.pid}"
    _wait_for((rings / "cycle.ring").exists)
    reader = RingReader.open(rings / "cycle.ring")
    _wait_for(lambda: reader.published > 1500 or daemon.poll() is not None)
    daemon.kill()
    assert daemon.wait() == -signal.SIGKILL
    return reader.published, out / "run.mcap"


def _statusword(environment: dict[str, str]) -> int:
    """0x6041 of node 1, read by python-canopen from another process."""
    code = (
        "import canopen\n"
        "network = canopen.Network()\n"
        "network.connect(interface='tonus', channel='can0')\n"
        "print(network.add_node(1, canopen.ObjectDictionary()).sdo.upload(0x6041, 0).hex())\n"
        "network.disconnect()\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        capture_output=True,
        text=True,
        timeout=20,
        check=True,
    )
    return int.from_bytes(bytes.fromhex(result.stdout.strip()), "little")


def _wait_for(condition: Callable[[], bool], seconds: float = 40.0) -> None:
    for _ in range(int(seconds / 0.05)):
        if condition():
            return
        time.sleep(0.05)
    raise AssertionError("it did not happen in time")
