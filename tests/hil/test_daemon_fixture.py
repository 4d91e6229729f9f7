"""The fixture for real time: a fault in the lab of a daemon that obeys the test's commands."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.foreign import pytest_in

TEST = """\
import pytest

import tonus


@pytest.mark.tonus_expect("*")
def test_a_lost_drive(tonus_daemon):
    daemon = tonus_daemon("hold")
    daemon.arm()
    daemon.fault("unplug", channel="can3", node=2)
    daemon.wait_for("FAULT")
    daemon.fault("replug", channel="can3", node=2)
    daemon.command("reset")
    daemon.wait_for("STANDBY")
    daemon.command("estop")
    with pytest.raises(tonus.ToolError, match="the robot is in FAULT and not in HOLD"):
        daemon.wait_for("HOLD")
    run = daemon.end()
    assert [strike.kind for strike in run.faults] == ["unplug"]
    assert run.expect("drive_lost", where="axis 1", after=0.0).time > 1.0
    assert run.state == "FAULT"
    with pytest.raises(AssertionError):
        run.never("drive_lost")
"""


@pytest.mark.wide
@pytest.mark.realtime
def test_a_fault_in_the_lab_of_a_daemon(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(TEST)
    text, code = pytest_in(tmp_path)
    assert code == 0, text
