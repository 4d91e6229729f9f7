"""The bring-up in full time of drawn robots whose cables are far from their data sheet: each of
these ended in `LENGTH_DRIFT` in PRETENSION once."""

from __future__ import annotations

import pytest

from tests.drawn import drawn, play
from tonus.runtime.states import State


@pytest.mark.parametrize(
    "seed",
    [
        # Tracker poses refused, and what was learnt of them was ten times too much.
        1008,
        # The elongation of one cable, whose compliance was not known yet, taken for a drift.
        1040,
        pytest.param(1017, marks=pytest.mark.wide),
    ],
)
def test_a_sound_robot_is_brought_up_without_a_doubt(seed: int) -> None:
    config, scenario = drawn("hold", {}, 0.1)
    run = play(config, scenario, seed, until=State.HOLD)
    assert run.alarm == ""
    assert not run.doubted
    assert run.learnt == 0
