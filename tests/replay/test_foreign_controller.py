"""A log of a controller that is not ours is replayed as any other, also from its middle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hil.runs import configured, virtual

from tonus.runtime.control.controllers import CONTROLLERS
from tonus.runtime.control.controllers.base import Motion
from tonus.runtime.control.controllers.impedance import Pd
from tonus.tools.log.replay import replay


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


@pytest.mark.wide
def test_a_foreign_controller_is_replayed_from_a_keyframe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path / "runtime"))
    monkeypatch.setitem(CONTROLLERS, "pd", Foreign)
    config, scenario = configured(
        "config/direct.yaml",
        duration=1.5,
        overrides={"control.controller": "pd", "recording.keyframe_s": 0.5},
    )
    _, log = virtual(config, scenario, tmp_path / "out")
    ticks = log["/tonus/timing"]["tick"]
    whole = replay(log)
    assert whole.ticks == len(ticks)
    assert whole.first is None
    part = replay(log, first=int(ticks[-1]) - 300)
    assert part.keyframes
    assert part.first is None
