"""kill -9 of daemon, recorder or lab at random moments: nothing that was published is missing, the
drives stop by themselves, and the next start works without anybody's cleaning.

`make kill` does it fifty times each; TONUS_KILLS is the number.
"""

from __future__ import annotations

import os
import random
import signal
from pathlib import Path

import pytest
from hil.processes import Running, nothing_missing, wait_for, whole

from runtime import clock
from tools.control_client import ControlClient
from tools.log import open as open_log

pytestmark = pytest.mark.realtime

KILLS = int(os.environ.get("TONUS_KILLS", "1"))
SEED = int(os.environ.get("TONUS_KILLS_SEED", "1"))
AT_MOST_S = 4.5
"""after the first cycle; by then it holds, and the scenario plays"""
PLAY = ("--scenario", "hold", "--duration", "30")


def moments(salt: int) -> list[float]:
    chance = random.Random(SEED + salt)
    return [chance.uniform(0.0, AT_MOST_S) for _ in range(KILLS)]


def test_a_killed_daemon_loses_no_cycle_and_the_next_start_works(tmp_path: Path) -> None:
    for number, moment in enumerate(moments(1)):
        running = Running(tmp_path, tmp_path / f"{number}", 47821, *PLAY)
        reader = running.reader()
        wait_for(lambda reader=reader: reader.published > 0)  # type: ignore[misc]
        clock.pause(moment)
        killed = running.kill()
        published = reader.published
        wait_for(lambda log=running.log: whole(log))  # type: ignore[misc]
        nothing_missing(published, running.log)
        told = any(event.name == "daemon_lost" for event in open_log(running.log).events())
        assert told is killed
    _the_next_start_works(tmp_path, 47821)


def test_a_killed_recorder_loses_no_cycle(tmp_path: Path) -> None:
    for number, moment in enumerate(moments(2)):
        running = Running(tmp_path, tmp_path / f"{number}", 47822, *PLAY)
        reader = running.reader()
        wait_for(lambda reader=reader: reader.published > 0)  # type: ignore[misc]
        clock.pause(moment)
        os.kill(running.part("tools.recorder_process"), signal.SIGKILL)
        clock.pause(0.2)
        assert running.end() in (0, 1), running.text.read_text()
        nothing_missing(reader.published, *running.out.glob("*.mcap"))


def test_what_a_killed_daemon_and_recorder_leave_is_recorded_at_the_next_start(
    tmp_path: Path,
) -> None:
    running = Running(tmp_path, tmp_path / "first", 47823, *PLAY)
    reader = running.reader()
    wait_for(lambda: reader.published > 1200)
    os.kill(running.part("tools.recorder_process"), signal.SIGKILL)
    running.kill()
    published = reader.published
    _the_next_start_works(tmp_path, 47823)
    nothing_missing(published, *running.out.glob("*.mcap"))
    assert not running.rings.exists()


def test_a_killed_lab_is_a_fault_and_the_next_start_works(tmp_path: Path) -> None:
    for number, moment in enumerate(moments(3)):
        running = Running(tmp_path, tmp_path / f"{number}", 47824, *PLAY)
        reader = running.reader()
        wait_for(lambda reader=reader: reader.published > 0)  # type: ignore[misc]
        clock.pause(moment)
        os.kill(running.part("tools.lab_process"), signal.SIGKILL)
        assert running.process.wait(60) == 1, running.text.read_text()
        said = running.text.read_text()
        assert "Traceback" not in said, said
        assert said.rstrip().splitlines()[-1].startswith("FAULT: "), said
        nothing_missing(reader.published, running.log)
    _the_next_start_works(tmp_path, 47824)


def _the_next_start_works(folder: Path, port: int) -> None:
    running = Running(folder, folder / "next", port, *PLAY)
    reader = running.reader()
    wait_for(lambda: reader.published > 100)
    with ControlClient(folder / "runtime" / "tonus.sock") as client:
        assert client.ask("status")["ok"]
        assert client.ask("stop")["op"] == "stop"
    assert running.end() in (0, 1), running.text.read_text()
    assert not list((folder / "runtime").glob("run-*"))
