"""The service manager's side: the unit file, and what the daemon tells it."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
from io import StringIO
from pathlib import Path

import pytest
from operated import Operated

from tonus import tools
from tonus.runtime.operation.notify import Notifier
from tonus.runtime.recording.taps import EventRing, Level
from tonus.runtime.states import State
from tonus.tools.event_lines import EventLines, for_journal

UNIT = Path(tools.__file__).parent / "service" / "tonus.service"


def settings() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for line in UNIT.read_text().splitlines():
        key, equals, value = line.partition("=")
        if equals and not line.startswith("#"):
            found.setdefault(key, []).append(value)
    return found


def test_the_unit_asks_for_what_the_daemon_needs_and_offers() -> None:
    unit = settings()
    assert unit["Type"] == ["notify"]
    assert "--serve" in unit["ExecStart"][0]
    assert int(unit["LimitRTPRIO"][0]) >= 80, "config/realtime.yaml asks for 80"
    assert unit["LimitMEMLOCK"] == ["infinity"]
    assert unit["NoNewPrivileges"] == ["yes"]
    assert unit["RestartPreventExitStatus"] == ["2"]
    assert unit["KillMode"] == ["mixed"], "else the recorder is stopped before the daemon"
    assert "TONUS_RUNTIME_DIR=/run/tonus" in unit["Environment"]
    assert "AF_CAN" in unit["RestrictAddressFamilies"][0]


ANALYZE = shutil.which("systemd-analyze")


@pytest.mark.skipif(ANALYZE is None, reason="no systemd here")
def test_systemd_finds_nothing_wrong_with_it(tmp_path: Path) -> None:
    unit = tmp_path / "tonus.service"
    # Paths and a user of this machine: the rest is what is judged.
    text = UNIT.read_text().replace("/opt/tonus/bin/tonus", sys.executable)
    unit.write_text(text.replace("User=tonus\nGroup=tonus", "User=root\nGroup=root"))
    result = subprocess.run(
        [str(ANALYZE), "verify", "--man=no", str(unit)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "tonus.service" not in result.stderr, result.stderr


@pytest.fixture
def manager(tmp_path: Path) -> socket.socket:
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listening.bind(str(tmp_path / "notify"))
    listening.setblocking(False)
    return listening


def heard(manager: socket.socket) -> list[str]:
    lines = []
    while True:
        try:
            lines += manager.recv(4096).decode().split("\n")
        except BlockingIOError:
            return lines


def test_the_watchdog_is_fed_from_the_tick(tmp_path: Path, manager: socket.socket) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "20000"})
    robot = Operated(tmp_path)
    robot.daemon.serve("service", lambda due_ns: notifier.beat(due_ns, robot.state))
    notifier.ready()
    robot.until(State.STANDBY)
    lines = heard(manager)
    for _ in range(10):  # a manager reads; who does not, has its queue filled
        robot.advance(10)
        lines += heard(manager)
    assert lines[0] == "READY=1"
    assert [line.split(":")[0] for line in lines if line.startswith("STATUS=")] == [
        *("STATUS=OFF", "STATUS=STANDBY")
    ]
    assert 9 <= lines.count("WATCHDOG=1") <= 12, "twice in each interval"
    notifier.close()
    robot.close()
    manager.close()


def test_without_a_manager_nothing_is_sent_and_a_lost_one_holds_up_nobody(tmp_path: Path) -> None:
    for environment in ({}, {"NOTIFY_SOCKET": str(tmp_path / "gone"), "WATCHDOG_USEC": "1"}):
        notifier = Notifier(environment)
        notifier.ready()
        notifier.beat(1, State.HOLD)
        notifier.stopping()
        notifier.close()


def test_the_journal_gets_a_level_with_each_line(tmp_path: Path) -> None:
    ring = EventRing.open(tmp_path / "events.ring")
    ring.write(0, 7, Level.ERROR, "drive_lost", "can2/6", "can2/6 (axis 5): it stopped answering")
    ring.write(0, 8, Level.INFO, "state", "", "ACTIVE to SAFE_STOP")
    assert for_journal({"JOURNAL_STREAM": "8:1"})
    assert not for_journal({})
    for journal, first in ((True, "<3>ERROR drive_lost"), (False, "        7 ERROR drive_lost")):
        out = StringIO()
        lines = EventLines(tmp_path, journal=journal, stream=out)
        lines.tell()
        lines.tell()
        told = out.getvalue().splitlines()
        assert len(told) == 2
        assert told[0].startswith(first)
        assert told[1].endswith("state: ACTIVE to SAFE_STOP")
