"""The robot operated from a page, as a browser would: lab in virtual time, daemon by itself."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from viewer_bench import ROOT, Served, Viewer, opened
from websockets.exceptions import InvalidStatus

from tonus.tools.view.live import Live, newest_run

pytestmark = pytest.mark.wide

TOKEN = "a-token-for-operation"  # noqa: S105


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("operated")


@pytest.fixture(scope="module")
def daemon(folder: Path) -> Iterator[Served]:
    made = Served(folder, "config/direct.yaml", "--virtual")
    yield made
    made.close()


@pytest.fixture
def viewer(daemon: Served, folder: Path) -> Iterator[Viewer]:
    made = Viewer(folder, "--operate", token=TOKEN)
    yield made
    made.close()


def test_operate_needs_a_token_and_makes_one(daemon: Served, folder: Path) -> None:
    made = Viewer(folder, "--operate")
    try:
        assert "?token=" in made.text.read_text()
        with pytest.raises(InvalidStatus):
            made.connect()
    finally:
        made.close()


def test_who_only_looks_commands_nothing(daemon: Served, folder: Path) -> None:
    made = Viewer(folder)
    try:
        with opened(made) as page:
            assert page.state("STANDBY")
            reply = page.command("arm")
            assert not reply["ok"]
            assert "--operate" in reply["next"]
            assert page.until(lambda now: "status" in now)["status"]["state"] == "STANDBY"
    finally:
        made.close()
    assert "arm" not in daemon.text.read_text()


def test_the_path_ahead_of_a_live_run_is_where_it_goes(
    daemon: Served, viewer: Viewer, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a scenario that was chosen on the way, too."""
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(folder / "runtime"))
    live = Live(newest_run())
    live.read_on()
    with opened(viewer) as page:
        page.state("STANDBY")
        live.advance()
        assert not len(live.ahead(1.0))
        page.arm()
        assert page.command("scenario", name="sine_z")["ok"]
        assert page.command("start")["ok"]
        page.until(lambda now: abs(now["runs"][0]["position"][2]) > 5.0)
        began = live.advance().newest["state"]["scenario_time"][0]
        ahead = live.ahead(1.0)
        page.until(lambda now: now["runs"][0]["elapsed"] > began + 1.5)
        rows = live.advance().samples.rows
        assert page.command("stop")["ok"]
        page.state("STANDBY")
        assert page.command("scenario", name="hold")["ok"]
    live.close()
    elapsed = rows["state"]["scenario_time"] - began
    followed = (elapsed > 0.0) & (elapsed < 0.9)
    rows, elapsed = rows[followed], elapsed[followed]
    told = [np.interp(elapsed, np.arange(len(ahead)) * 0.02, ahead[:, axis]) for axis in range(3)]
    assert len(rows) > 10
    assert np.ptp(ahead[:, 2]) > 0.005
    assert np.abs(np.transpose(told) - rows["pose"]["desired_position"]).max() < 1e-4


def test_the_hang_up_of_a_terminal_is_an_event_of_a_daemon_that_serves(
    daemon: Served, viewer: Viewer
) -> None:
    with opened(viewer) as page:
        page.state("STANDBY")
        daemon.process.send_signal(signal.SIGHUP)
        page.until(lambda now: any(each["name"] == "signal" for each in page.events))
        assert page.state("STANDBY")


@pytest.mark.parametrize("lost", ["closed", "silent", "killed"])
def test_a_lost_page_holds_the_robot(
    daemon: Served, folder: Path, viewer: Viewer, lost: str
) -> None:
    watcher = Viewer(folder, "--operate", token=TOKEN)
    with opened(viewer) as witness:
        witness.arm()
        with opened(watcher) as page:
            assert page.command("start", watch=True)["ok"]
            for _ in range(20):
                page.send(do="alive")
                page.next("now")
            witness.state("ACTIVE")
            if lost == "killed":
                os.kill(watcher.process.pid, signal.SIGKILL)
                watcher.process.wait()
            if lost != "closed":
                witness.state("HOLD")
        witness.state("HOLD")
        assert witness.command("stop")["ok"]
        witness.state("STANDBY")
    if lost != "killed":
        watcher.close()


def test_an_emergency_stop_acts_in_the_tick_it_arrives(daemon: Served, viewer: Viewer) -> None:
    with opened(viewer) as page:
        page.arm()
        for _ in range(40):  # whatever waits before it
            page.send(do="command", verb="status", id=0)
        reply = page.command("estop")
        assert reply["ok"]
        assert reply["state"] == "FAULT"
        page.until(lambda now: now["status"]["state"] == "FAULT")
        assert page.command("reset")["ok"]
        page.state("STANDBY")


def test_a_session_from_arming_to_a_pulled_node_and_back(tmp_path: Path) -> None:
    daemon = Served(tmp_path, "config/can.yaml", "--virtual")
    viewer = Viewer(tmp_path, "--operate", token=TOKEN)
    with opened(viewer) as page:
        page.arm()
        refused = page.command("reset")
        assert not refused["ok"]
        assert refused["error"]
        assert page.command("scenario", name="sine_z")["ok"]
        assert page.command("start")["ok"]
        now = page.state("ACTIVE")
        assert not {each["verb"]: each["why"] for each in now["choices"]}["hold"]
        moved = page.until(lambda now: abs(now["runs"][0]["position"][2]) > 5.0)
        assert moved["runs"][0]["k_eq"] > 0
        unplug = {"op": "inject", "fault": {"kind": "unplug", "channel": "can1", "node": 3}}
        assert page.ask(do="lab", request=unplug)["ok"]
        fault = page.until(lambda now: now["runs"][0]["fault"] is not None)["runs"][0]["fault"]
        assert "can1" in fault["text"]
        assert "power" in fault["remedy"]
        page.state("FAULT")
        assert any(each["name"] == "drive_lost" and each["remedy"] for each in page.events)
        assert any(each["name"] == "operator" and "uid" in each["text"] for each in page.events)
        replug = {"op": "inject", "fault": {"kind": "replug", "channel": "can1", "node": 3}}
        assert page.ask(do="lab", request=replug)["ok"]
        assert page.ask(do="lab", request={"op": "get"})["ok"]
        for _ in range(20):
            if page.command("reset")["ok"]:
                break
        page.state("STANDBY")
    viewer.close()
    daemon.close()


def test_a_gain_is_tuned_from_the_page(daemon: Served, viewer: Viewer) -> None:
    key = "control.stiffness.velocity_gain"
    with opened(viewer) as page:
        page.state("STANDBY")
        assert page.command("set", key=key, value=0.3)["ok"]
        page.until(lambda now: now["status"]["tunable"][0]["value"] == 0.3)
        for value, why in ((5.0, "outside"), ("0.3", "no number"), ("", "no number")):
            refused = page.command("set", key=key, value=value)
            assert not refused["ok"]
            assert why in refused["error"]
        assert any(each["name"] == "tuned" and "uid" in each["text"] for each in page.events)


def test_the_page_names_the_files_of_its_own_only() -> None:
    """Nothing is loaded from another host."""
    for file in (ROOT / "tools" / "view" / "page").glob("*.*"):
        text = file.read_text()
        assert "http://" not in text
        assert "https://" not in text
        assert "innerHTML" not in text
