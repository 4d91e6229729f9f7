"""A scenario's script reaches the tracker: what the daemon sees of it is in the log."""

from __future__ import annotations

import numpy as np
import pytest

from tests.loop import QUICK
from tests.scripted import scripted
from tonus.tools.testing.player import Player


@pytest.mark.tonus(config="config/direct.yaml", overrides=QUICK)
@pytest.mark.tonus_expect("tracker_*", "pose_*")
def test_the_tracker_is_hidden_and_knocked_when_the_scenario_says(tonus_run: Player) -> None:
    begin, gap, shift = 2.4, 0.2, 0.004
    script = {
        "occlusions": [{"at": begin, "duration": gap}],
        "tracker_shifts": [{"at": 0.0, "duration": begin, "position": [0.0, shift, 0.0]}],
    }
    run = tonus_run(scripted(lab=script), duration=0.5)
    assert run.state == "STANDBY", run.reason
    log = run.log
    seen = log["/tonus/tracker"]
    fresh = np.flatnonzero(seen["fresh"])
    silences = np.diff(fresh)
    longest = int(np.argmax(silences))
    assert silences[longest] * 1e-3 == pytest.approx(gap, abs=0.02)
    assert np.max(np.delete(silences, longest)) < 15
    truth = log["/tonus/truth"]["position"]
    off = {}
    for side, ticks in ("before", fresh[:longest][-100:]), ("after", fresh[longest + 1 :][:100]):
        exposed = ticks - np.rint(seen["delay"][ticks] * 1e3).astype(int)
        off[side] = np.mean(seen["position"][ticks] - truth[exposed], axis=0)
    assert off["before"] == pytest.approx([0.0, shift, 0.0], abs=5e-4)
    assert off["after"] == pytest.approx([0.0, 0.0, 0.0], abs=5e-4)
