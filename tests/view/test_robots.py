"""Every kind of robot in the view: on EtherCAT, with six cables and with twelve."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from viewer_bench import ROOT, TONUS, Page, Served, Viewer, opened, recorded
from websockets.sync.client import connect

from tonus.runtime.states import State
from tonus.runtime.timing import clock
from tonus.tools.log import open as open_log

pytestmark = pytest.mark.wide

TOKEN = "a-token-for-robots"  # noqa: S105
ROBOTS = [("ethercat", 8), ("six", 6), ("twelve", 12)]


@pytest.mark.parametrize(("config", "cables"), ROBOTS)
def test_each_moment_of_a_log_is_what_it_holds(tmp_path: Path, config: str, cables: int) -> None:
    file = recorded(tmp_path, config=f"config/{config}.yaml", scenario="hold", seconds=0.3)
    log = open_log(file)
    ticks, states = log["/tonus/timing"]["tick"], log["/tonus/state"]["state"]
    viewer = Viewer(tmp_path, str(file))
    try:
        with opened(viewer) as page:
            page.send(do="pause")
            page.until(lambda now: not now["playing"])
            assert page.hello["cables"] == cables
            assert page.hello["plots"][0]["series"] == [str(number) for number in range(cables)]
            for state in (State.PRETENSION, State.ACTIVE, State.SAFE_STOP):
                first = np.flatnonzero(states == state)[0]
                time_s = round((log.times("/tonus/state")[first + 100] - log.span_ns[0]) * 1e-9, 3)
                page.send(do="seek", value=time_s)
                now = page.until(lambda now, time_s=time_s: now["t"] == time_s)["runs"][0]
                row = int(np.flatnonzero(ticks == now["tick"])[0])
                assert 0 <= first + 100 - row <= 21, "the newest sample before that time"
                _is_row(now, log, row, state)
            page.send(do="choose", signals=[f"drives.rate[{cables - 1}]", "drives.rate[12]"])
            run = page.next("points")["runs"][0]
            while not run["chosen"]:
                run = page.next("points")["runs"][0]
            assert len(run["chosen"]) == 1, "there is no thirteenth cable"
            assert len(run["plots"][0]) == cables
            wanted = log["/tonus/tension"]["measured"][np.isin(ticks, _ticks(log, run["t"]))]
            assert np.transpose(run["plots"][0]) == pytest.approx(wanted, abs=1e-5)
    finally:
        viewer.close()


def _is_row(now: dict[str, Any], log: Any, row: int, state: State) -> None:
    """What the page shows is this row of the log."""
    pose, tension = log["/tonus/pose"][row], log["/tonus/tension"]["measured"][row]
    assert now["state"] == state.name
    assert now["tension"] == [round(float(each), 1) for each in tension]
    assert now["position"] == [round(1e3 * float(each), 1) for each in pose["position"]]
    assert now["k_eq"] == round(float(log["/tonus/stiffness"]["k_eq"][row]), 0)
    assert now["fault"] is None


def _ticks(log: Any, times: list[float]) -> list[int]:
    """Of the plots' times in s since the log's first message."""
    stamps = (log.times("/tonus/timing") - log.span_ns[0]) * 1e-9
    return [int(log["/tonus/timing"]["tick"][np.abs(stamps - each).argmin()]) for each in times]


def test_a_robot_on_ethercat_is_operated_and_loses_a_drive(tmp_path: Path) -> None:
    daemon = Served(tmp_path, "config/ethercat.yaml", "--virtual")
    viewer = Viewer(tmp_path, "--operate", token=TOKEN)
    try:
        with opened(viewer) as page:
            page.arm()
            now = page.until(lambda now: now["status"]["state"] == "HOLD")
            assert len(now["runs"][0]["tension"]) == 8
            assert now["runs"][0]["tension"] == pytest.approx(now["status"]["tension_n"], abs=3.0)
            slaves = page.ask(do="lab", request={"op": "get"})["slaves"]
            assert len(slaves) == 10
            fault = {"kind": "unplug", "channel": slaves[2]["channel"], "node": 3}
            assert page.ask(do="lab", request={"op": "inject", "fault": fault})["ok"]
            now = page.until(lambda now: now["runs"][0]["fault"] is not None)
            assert slaves[2]["channel"] in now["runs"][0]["fault"]["text"]
            assert now["runs"][0]["fault"]["remedy"]
            page.state("FAULT")
    finally:
        viewer.close()
        daemon.close()


def test_a_run_on_ethercat_starts_its_viewer_beside_it(tmp_path: Path) -> None:
    """`tonus run --view`: the address is printed, and the page there shows this run."""
    environment = {**os.environ, "TONUS_RUNTIME_DIR": str(tmp_path / "runtime")}
    text = tmp_path / "run.txt"
    command = [*TONUS, "run", "config/ethercat.yaml", "--virtual", "--view", "--scenario", "hold"]
    run = subprocess.Popen(
        [*command, "--duration", "600", "--out", str(tmp_path / "out")],
        cwd=ROOT,
        env=environment,
        stdout=text.open("w"),
        stderr=subprocess.STDOUT,
    )
    try:
        for _ in range(1200):
            if "open http" in text.read_text() or run.poll() is not None:
                break
            clock.pause(0.05)
        address = text.read_text().split("open http://")[1].split("/")[0]
        origin: Any = f"http://{address}"
        with connect(f"ws://{address}/channel", origin=origin, max_size=None) as connection:
            page = Page(connection)
            assert page.hello["live"]
            first = page.state("ACTIVE")["runs"][0]["tick"]
            assert len(page.until(lambda now: now["runs"][0]["tick"] > first)["runs"]) == 1
    finally:
        run.send_signal(signal.SIGINT)
        run.wait(60)
