"""A served run in virtual time: as fast as may be while armed, at a walk while disarmed."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from tests.composed import configured
from tonus.config import load
from tonus.runtime.states import State
from tonus.runtime.timing import clock
from tonus.runtime.timing.scheduler import VirtualPacing
from tonus.tools.run.composer import Order, run
from tonus.tools.run.idle_pacing import IdlePacing

PERIOD_NS = 1_000_000
TICKS = 500
"""after which a served run is ended, whether it waits or not"""


class Wall:
    """A wall clock that only pauses move."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        monkeypatch.setattr(clock, "wall_seconds", lambda: self.now)
        monkeypatch.setattr(clock, "pause", self.pause)

    def pause(self, seconds: float) -> None:
        self.now += seconds


@pytest.mark.parametrize(("speed", "seconds"), [(1.0, 1.0), (4.0, 0.25)])
def test_idle_time_passes_as_configured_and_other_time_costs_nothing(
    monkeypatch: pytest.MonkeyPatch, speed: float, seconds: float
) -> None:
    wall, idle = Wall(monkeypatch), True

    async def tick() -> None:
        nonlocal idle
        pacing = IdlePacing(lambda: idle, speed)
        for number in range(1, 1002):
            await pacing.until(number * PERIOD_NS)
        waited = wall.now
        assert waited == pytest.approx(100.0 + seconds)
        idle = False
        for number in range(1002, 5000):
            await pacing.until(number * PERIOD_NS)
        assert wall.now == waited

    clock.run(tick(), virtual=True)


def test_lost_time_is_not_made_up_after_work(monkeypatch: pytest.MonkeyPatch) -> None:
    wall, idle = Wall(monkeypatch), True

    async def tick() -> None:
        nonlocal idle
        pacing = IdlePacing(lambda: idle, 1.0)
        await pacing.until(PERIOD_NS)
        idle = False
        await pacing.until(2 * PERIOD_NS)
        wall.now += 50.0
        idle = True
        for number in range(3, 104):
            await pacing.until(number * PERIOD_NS)
        assert wall.now == pytest.approx(150.1)

    clock.run(tick(), virtual=True)


def test_the_shipped_robot_walks_in_real_time() -> None:
    config, _ = load("config/can.yaml")
    assert config.operation.virtual_idle_speed == 1.0


def test_a_served_run_in_virtual_time_waits_while_the_robot_is_disarmed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path / "runtime"))
    wall, usual, ticks = Wall(monkeypatch), VirtualPacing.until, 0

    async def until(pacing: VirtualPacing, due_ns: int) -> None:
        nonlocal ticks
        ticks += 1
        if ticks == TICKS:
            os.kill(os.getpid(), signal.SIGTERM)
        await usual(pacing, due_ns)

    monkeypatch.setattr(VirtualPacing, "until", until)
    config, scenario = configured("config/direct.yaml")
    order = Order(
        config, scenario, tmp_path / "out", 1, True, lambda _: None, live=False, serve=True
    )
    began = wall.now
    result = run(order)
    assert result.outcome.state in (State.OFF, State.STANDBY)
    assert wall.now - began >= 0.9 * TICKS * PERIOD_NS * 1e-9, "as long as a robot stands still"
