"""A log of a controller that is not ours is replayed as any other, also from its middle."""

from __future__ import annotations

import numpy as np
import pytest
from loop import QUICK

from tonus.runtime.control.controllers import CONTROLLERS
from tonus.runtime.control.controllers.base import Motion
from tonus.runtime.control.controllers.impedance import Pd
from tonus.tools.log.replay import replay
from tonus.tools.testing.player import Player


class Memory:
    """Of a class of somebody else's, with an array and a count."""

    def __init__(self) -> None:
        self.latest = np.zeros(3)
        self.calls = 0


class Foreign(Pd):
    """Softens a little with each call, so that a replay needs its memory."""

    def __init__(self, robot, control) -> None:
        super().__init__(robot, control)
        self.memory = Memory()

    def stiffness(self, motion: Motion) -> float:
        memory = self.memory
        memory.calls += 1
        memory.latest += 1e-3
        return self.resting_stiffness - 0.01 * memory.calls - float(memory.latest[0])


@pytest.mark.tonus(config="config/direct.yaml", overrides=QUICK)
@pytest.mark.wide
def test_a_foreign_controller_is_replayed_from_a_keyframe(
    tonus_run: Player, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(CONTROLLERS, "pd", Foreign)
    often = {"recording.keyframe_s": 0.5}
    log = tonus_run("hold", controller="pd", overrides=often, duration=1.5).log
    ticks = log["/tonus/timing"]["tick"]
    whole = replay(log)
    assert whole.ticks == len(ticks)
    assert whole.first is None
    part = replay(log, first=int(ticks[-1]) - 300)
    assert part.keyframes
    assert part.first is None
