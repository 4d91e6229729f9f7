"""kill -9 of daemon, recorder or lab at random moments: nothing that was published is missing, the
drives stop by themselves, and the next start works without anybody's cleaning.

All of it happens in one folder, so that each start is also the next one after a kill. `make kill`
does it fifty times each; TONUS_KILLS is the number. Without it only what takes little time runs:
daemon and recorder killed together, and the lab.
"""

from __future__ import annotations

import os
import random
import signal
from itertools import count
from pathlib import Path

import pytest
from hil.processes import Running, nothing_missing, wait_for, whole

from tonus.runtime.timing import clock
from tonus.tools.control_client import ControlClient
from tonus.tools.log import open as open_log

pytestmark = pytest.mark.realtime

MANY = "TONUS_KILLS" in os.environ
KILLS = int(os.environ.get("TONUS_KILLS", "1"))
SEED = int(os.environ.get("TONUS_KILLS_SEED", "1"))
AT_MOST_S = 4.5 if MANY else 1.0
"""after the first cycle; by the longer one it holds, and the scenario plays"""
PLAY = ("--scenario", "hold", "--duration", "30")
PORT = 47821
_STARTS = count()
"""so that a test that is tried again has a folder of its own"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kills")


many = pytest.mark.skipif(not MANY, reason="make kill")


def moments(salt: int) -> list[float]:
    chance = random.Random(SEED + salt)
    return [chance.uniform(0.0, AT_MOST_S) for _ in range(KILLS)]


def started(folder: Path, name: str) -> Running:
    """It ticks."""
    running = Running(folder, folder / f"{name}-{next(_STARTS)}", PORT, *PLAY)
    reader = running.reader()
    wait_for(lambda: reader.published > 0)
    return running


@many
def test_a_killed_daemon_loses_no_cycle(folder: Path) -> None:
    for number, moment in enumerate(moments(1)):
        running = started(folder, f"daemon{number}")
        reader = running.reader()
        clock.pause(moment)
        killed = running.kill()
        wait_for(lambda log=running.log: whole(log))  # type: ignore[misc]
        nothing_missing(reader.published, running.log)
        events = list(open_log(running.log).events())
        told = any(event.name == "daemon_lost" for event in events)
        # On a starved host a run may have ended in a fault, and be drawn when it is killed.
        over = any(event.name == "state" and event.text.endswith("FAULT") for event in events)
        assert told is killed or (over and not told)


@many
def test_a_killed_recorder_loses_no_cycle(folder: Path) -> None:
    killed = sum(
        lose(folder, f"recorder{number}", "tonus.tools.run.recorder_process", moment)
        for number, moment in enumerate(moments(2))
    )
    assert killed, "the host ended every run in a fault before its recorder could be killed"


@pytest.mark.wide
def test_a_killed_keeper_of_the_recorder_ends_nothing(folder: Path) -> None:
    """The recorder is then nobody's, and goes on to the end all the same."""
    killed = lose(folder, "keeper", "tonus.tools.run.recorder_keeper", moments(4)[0])
    assert killed, "the run ended in a fault before its keeper could be killed"


def lose(folder: Path, name: str, helper: str, moment: float) -> bool:
    """Kill a helper that the daemon can do without; whether it was still there."""
    running = started(folder, name)
    reader = running.reader()
    clock.pause(moment)
    killed = running.kill_part(helper)
    clock.pause(0.2)
    ended = running.end()
    logs = list(running.out.glob("*.mcap"))
    # A run that the host ended in a fault may be at its picture, where a signal ends it at once.
    drawn = ended == -signal.SIGTERM and any(map(in_fault, logs))
    assert drawn or ended in (0, 1), running.text.read_text()
    nothing_missing(reader.published, *logs)
    return killed


def in_fault(log: Path) -> bool:
    events = open_log(log).events()
    return any(event.name == "state" and event.text.endswith("FAULT") for event in events)


@pytest.mark.wide
def test_a_killed_lab_is_a_fault(folder: Path) -> None:
    killed = 0
    for number, moment in enumerate(moments(3)):
        running = started(folder, f"lab{number}")
        reader = running.reader()
        clock.pause(moment)
        killed += running.kill_part("tonus.tools.run.lab_process")
        assert running.process.wait(60) == 1, running.text.read_text()
        said = running.text.read_text()
        assert "Traceback" not in said, said
        assert said.rstrip().splitlines()[-1].startswith("FAULT: "), said
        nothing_missing(reader.published, running.log)
    print(f"killed {killed} of {KILLS}; the others had ended in a fault before")
    assert killed, "every run ended in a fault before its lab could be killed"


@pytest.mark.long
def test_what_a_killed_daemon_and_recorder_leave_is_recorded_at_the_next_start(
    folder: Path,
) -> None:
    running = started(folder, "both")
    reader = running.reader()
    wait_for(lambda: reader.published > 500)
    os.kill(running.part("tonus.tools.run.recorder_process"), signal.SIGKILL)
    running.kill()
    last = started(folder, "last")
    nothing_missing(reader.published, *running.out.glob("*.mcap"))
    with ControlClient(folder / "runtime" / "tonus.sock") as client:
        assert client.ask("status")["ok"]
        client.ask("stop")
    assert last.end() in (0, 1), last.text.read_text()
    assert not list((folder / "runtime").glob("run-*"))
