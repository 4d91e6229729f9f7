"""A stop of the robot of seven cables, which no six of them hold level: it comes down without being
toppled. In the closed loop without a bus."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.loop import QUICK, ClosedLoop
from tonus.config import load
from tonus.runtime.states import State, StopMode

pytestmark = pytest.mark.wide

Lose = Callable[[ClosedLoop, int], None]


def silent(loop: ClosedLoop, cable: int) -> None:
    loop.silent_axes.add(cable)


def slipped(loop: ClosedLoop, cable: int) -> None:
    loop.plant.defects.slip_encoder(cable, 0.5, 0.05)


def reversed_motor(loop: ClosedLoop, cable: int) -> None:
    loop.plant.defects.weaken_motor(cable, -0.5)


@pytest.mark.parametrize("lose", [silent, slipped, reversed_motor])
@pytest.mark.parametrize("cable", [0, 6])
def test_a_cable_that_is_lost_topples_no_platform(lose: Lose, cable: int) -> None:
    """One from above and one from below. By the stop of eight cables, 0.65 to 0.97 m/s and 7 to 16
    rad/s until 2026-11-29."""
    loop = ClosedLoop(*load("config/seven.yaml", scenario="hold", overrides=QUICK))
    loop.until(State.HOLD)
    loop.run(0.3)
    lose(loop, cable)
    speeds: list[tuple[float, float]] = []

    def note() -> None:
        speeds.append(
            (
                float(np.linalg.norm(loop.plant.velocity)),
                float(np.linalg.norm(loop.plant.angular_velocity)),
            )
        )

    loop.run(1.5, note)
    assert loop.cycle.sequence.stop_mode is StopMode.DESCENT
    speed, turning = np.max(speeds, axis=0)
    assert speed <= 0.5
    assert turning <= 3.0
    assert np.all(loop.trace.truth["tension"] <= 100.0)
