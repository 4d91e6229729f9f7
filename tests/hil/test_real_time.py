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

from config.loader import HERE
from runtime.ring import RingReader
from tools.log import open as open_log

pytestmark = pytest.mark.realtime

TONUS = [sys.executable, "-m", "tools.cli"]
ROOT = HERE.parent


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Sockets and rings of this test in a folder of its own."""
    return {**os.environ, "TONUS_RUNTIME_DIR": str(tmp_path / "runtime")}


def _quick_configuration(folder: Path, *, lab: bool = True, port: int = 47811) -> Path:
    """The shipped CAN configuration with a quicker sequence, as files of its own."""
    control = yaml.safe_load((HERE / "control.yaml").read_text())
    for key, value in QUICK.items():
        control["sequence"][key.rsplit(".", 1)[1]] = value
    tracker = yaml.safe_load((HERE / "tracker.yaml").read_text()) | {"port": port}
    (folder / "control.yaml").write_text(yaml.safe_dump(control))
    (folder / "tracker.yaml").write_text(yaml.safe_dump(tracker))
    lines = []
    for line in (HERE / "can.yaml").read_text().splitlines():
        if line.startswith("lab:") and not lab:
            continue
        name = line.rsplit("!include ", 1)[-1]
        if "!include" in line and name not in ("control.yaml", "tracker.yaml"):
            lines.append(line.replace(name, str(HERE / name)))
        else:
            lines.append(line)
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


def _spared_by_the_host(
    environment: dict[str, str], out: Path, *arguments: str
) -> subprocess.CompletedProcess[str]:
    """A run; again, up to five times, if it ended in a fault and the host took ticks from it:
    no controller is to blame for a robot that was left alone. Skips on a host that always does."""
    for _ in range(5):
        result = _run(environment, "run", *arguments, "--out", str(out))
        if result.returncode != 1:
            return result
        summary = json.loads((out / "summary.json").read_text())
        assert summary["missed_by_host"] > 0, result.stdout + result.stderr
        assert summary["state"] != "FAULT" or "tonus doctor tells" in result.stdout
    pytest.skip(f"the host took ticks from each of five runs, {summary['missed_by_host']} at last")


def test_a_run_leaves_log_summary_and_picture(tmp_path: Path, environment: dict[str, str]) -> None:
    config, out = _quick_configuration(tmp_path), tmp_path / "out"
    result = _spared_by_the_host(
        environment, out, str(config), "--scenario", "hold", "--duration", "1"
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert result.stdout.rstrip().splitlines()[-1].startswith("STANDBY: ")
    assert "ACTIVE" in result.stdout
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
    assert not list((tmp_path / "runtime").glob("run-*"))


def test_a_killed_daemon_leaves_every_published_cycle(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    config, out = _quick_configuration(tmp_path, port=47812), tmp_path / "out"
    command = ["run", str(config), "--scenario", "hold", "--duration", "30", "--out", str(out)]
    daemon = subprocess.Popen(
        [*TONUS, *command], cwd=ROOT, env=environment, stdout=subprocess.DEVNULL
    )
    rings = tmp_path / "runtime" / f"run-{daemon.pid}"
    _wait_for((rings / "cycle.ring").exists)
    reader = RingReader.open(rings / "cycle.ring")
    _wait_for(lambda: reader.published > 1500)
    daemon.kill()
    daemon.wait()
    published = reader.published
    log_path = out / "run.mcap"
    _wait_for(lambda: log_path.exists() and open_log(log_path).damage is None)
    log = open_log(log_path)
    ticks = log["/tonus/timing"]["tick"]
    assert len(ticks) == published
    assert np.all(np.diff(ticks.astype(np.int64)) > 0)
    assert any(event.name == "daemon_lost" for event in log.events())


def test_a_silent_node_ends_the_run_with_its_name(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    config, out = _quick_configuration(tmp_path, port=47813), tmp_path / "out"
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
    result = _run(environment, "run", str(config), "--scenario", str(path), "--out", str(out))
    assert result.returncode == 1, result.stdout + result.stderr
    last = result.stdout.rstrip().splitlines()[-1]
    assert "can2/6" in last
    assert "stopped answering" in last
    summary = json.loads((out / "summary.json").read_text())
    assert [fault["name"] for fault in summary["faults"]] == ["drive_lost"]


def test_drives_outlive_a_killed_daemon_only_as_long_as_their_watchdog(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    """The lab alone in one process, a daemon without a lab in another, killed while it holds."""
    shared = _quick_configuration(tmp_path, port=47814)
    robot = _quick_configuration(tmp_path, lab=False, port=47814)
    lab = subprocess.Popen(
        [*TONUS, "lab", str(shared)], cwd=ROOT, env=environment, stdout=subprocess.DEVNULL
    )
    try:
        _wait_for((tmp_path / "runtime" / "can0.sock").exists)
        command = ["run", str(robot), "--scenario", "hold", "--duration", "30"]
        daemon = subprocess.Popen(
            [*TONUS, *command, "--out", str(tmp_path / "out")],
            cwd=ROOT,
            env=environment,
            stdout=subprocess.DEVNULL,
        )
        rings = tmp_path / "runtime" / f"run-{daemon.pid}"
        _wait_for((rings / "cycle.ring").exists)
        reader = RingReader.open(rings / "cycle.ring")
        _wait_for(lambda: reader.published > 1500)
        daemon.kill()
        daemon.wait()
        time.sleep(0.3)
        word = _statusword(environment)
        assert word & 0x6F != 0x27, f"statusword 0x{word:04X}: still in Operation Enabled"
        assert word & 0x4F == 0x08
    finally:
        lab.send_signal(signal.SIGINT)
        assert lab.wait(10) == 0


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
