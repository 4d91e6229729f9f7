"""A served run in virtual time: as fast as may be while armed, at a walk while disarmed."""

from __future__ import annotations

import pytest

from tonus.config import load
from tonus.runtime.timing import clock
from tonus.tools.run.idle_pacing import IdlePacing

PERIOD_NS = 1_000_000


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
