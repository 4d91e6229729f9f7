"""Virtual time: same seed, same bytes; and nothing of the machine reaches them."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from tests.loop import QUICK
from tonus.config import load
from tonus.tools.testing.player import Player

pytestmark = [pytest.mark.tonus(overrides=QUICK), pytest.mark.wide]

SECONDS = "0.2"


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _start(out: Path, bus: str) -> subprocess.Popen[bytes]:
    config, _ = load(f"config/{bus}.yaml", "hold", QUICK)
    path = out / "quick.yaml"
    path.write_text(yaml.safe_dump(config.model_dump(mode="json")))
    command = [sys.executable, "-m", "tonus.tools.cli", "run", str(path), "--virtual", "--json"]
    arguments = ["--duration", SECONDS, "--seed", "3", "--out", str(out)]
    environment = {**os.environ, "TONUS_RUNTIME_DIR": str(out)}
    return subprocess.Popen([*command, *arguments], env=environment, stdout=subprocess.DEVNULL)


def _undisturbed(out: Path, bus: str) -> str:
    out.mkdir()
    assert _start(out, bus).wait() == 0
    return _digest(out / "run.mcap")


@pytest.mark.parametrize("bus", ["direct", pytest.param("can", marks=pytest.mark.long)])
def test_in_one_process_the_same_seed_is_the_same_run_and_another_is_not(
    bus: str, tonus_run: Player
) -> None:
    first, same, other = (
        _digest(tonus_run("hold", config=f"config/{bus}.yaml", duration=0.2, seed=seed).path)
        for seed in (3, 3, 4)
    )
    assert first == same != other


def test_a_stopped_and_continued_process_writes_the_same_bytes(tmp_path: Path) -> None:
    process = _start(tmp_path, "direct")
    stops = 0
    while process.poll() is None:
        time.sleep(0.3)
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.1)
        process.send_signal(signal.SIGCONT)
        stops += 1
    assert process.returncode == 0
    assert stops > 2
    assert _digest(tmp_path / "run.mcap") == _undisturbed(tmp_path / "undisturbed", "direct")


@pytest.mark.long
def test_beside_a_busy_machine_the_bytes_are_the_same(tmp_path: Path) -> None:
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(3)]
    try:
        assert _start(tmp_path, "can").wait() == 0
    finally:
        for process in busy:
            process.kill()
            process.wait()
    assert _digest(tmp_path / "run.mcap") == _undisturbed(tmp_path / "undisturbed", "can")
