"""The supervisor's process, in real time: a daemon that stands still, and a supervisor that is
killed, each stop the drives. The limits are the lab's, whose host may stall."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import can
import pytest
from hil.processes import Running, wait_for

from tests import stalls
from tonus.config import load
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import State
from tonus.runtime.timing import clock
from tonus.tools.log import open as open_log

PROCESSORS = len(os.sched_getaffinity(0))
pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(PROCESSORS < 3, reason=f"needs three processors, there are {PROCESSORS}"),
]

CONFIG, _ = load("config/can.yaml")
PORT = 47825
DRIVES = range(1, 9)
SUPERVISED = {
    "supervisor.policy": "use",
    "control.sequence.tare_s": CONFIG.control.sequence.tare_s,
}
_LOST = 0x8130
_STARTS = count()
_ALLOWED_MS = 30.0
"""beyond what the configuration states: the grids of supervisor and lab, and this process's turn"""


@pytest.fixture
def running(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Running]:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path / "runtime"))
    supervised = [f"--set={key}={value}" for key, value in SUPERVISED.items()]
    out = tmp_path / f"run-{next(_STARTS)}"
    made = Running(tmp_path, out, PORT, "--scenario", "hold", "--duration", "30", *supervised)
    reader = made.reader()
    dtype = cycle_dtype(CONFIG.robot.cables)

    def holds() -> bool:
        newest = reader.newest()
        if newest is None:
            return False
        state = int.from_bytes(newest[1][_place(dtype) : _place(dtype) + 1], "little")
        return state == State.ACTIVE

    wait_for(lambda: holds() or made.process.poll() is not None)
    assert made.process.poll() is None, made.text.read_text()
    yield made
    if made.process.poll() is None:
        made.kill()


def _place(dtype: object) -> int:
    fields = dtype.fields  # type: ignore[attr-defined]
    topic, offset = fields["state"]
    return int(offset + topic.fields["state"][1])


def stopped_after_ms(buses: list[can.BusABC], from_ns: int) -> float:
    """Until the last drive says that a heartbeat has ended."""
    found: dict[int, int] = {}
    end = clock.wall_seconds() + 2.0
    while len(found) < len(DRIVES) and clock.wall_seconds() < end:
        for bus in buses:
            while (frame := bus.recv(timeout=0)) is not None:
                node = frame.arbitration_id - 0x080
                if node in DRIVES and int.from_bytes(frame.data[:2], "little") == _LOST:
                    found.setdefault(node, round(frame.timestamp * 1e9))
        clock.pause(0.001)
    assert sorted(found) == list(DRIVES)
    return (max(found.values()) - from_ns) * 1e-6


@pytest.fixture
def buses(running: Running) -> list[can.BusABC]:
    return [can.Bus(interface="tonus", channel=f"can{k}") for k in range(4)]


def test_a_daemon_that_stands_still_loses_its_drives(
    running: Running, buses: list[can.BusABC]
) -> None:
    settings = CONFIG.supervisor
    assert settings is not None
    before = stalls.now_ns()
    os.kill(running.process.pid, signal.SIGSTOP)
    try:
        took = stopped_after_ms(buses, before)
    finally:
        os.kill(running.process.pid, signal.SIGCONT)
        for bus in buses:
            bus.shutdown()
    assert took <= settings.patience_ms + settings.timeout_ms + _ALLOWED_MS
    assert running.process.wait(60) == 1
    told = {event.name: event.text for event in open_log(running.log).events()}
    assert "SUP-1" in told["supervisor_stopped"]


def test_a_supervisor_that_is_killed_takes_the_drives_with_it(
    running: Running, buses: list[can.BusABC]
) -> None:
    settings = CONFIG.supervisor
    assert settings is not None
    before = stalls.now_ns()
    assert running.kill_part("tonus.tools.run.supervisor_process")
    took = stopped_after_ms(buses, before)
    for bus in buses:
        bus.shutdown()
    assert took <= settings.timeout_ms + _ALLOWED_MS
    assert running.process.wait(60) == 1
    assert "supervisor_lost" in {event.name for event in open_log(running.log).events()}
