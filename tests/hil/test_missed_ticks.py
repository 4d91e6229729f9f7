"""A host that takes ticks makes torque and motion of different times."""

from __future__ import annotations

from tests.loop import QUICK, ClosedLoop, configured
from tonus.runtime.states import Fault, State


def test_ticks_that_are_missed_are_blamed_on_no_drum() -> None:
    """Two of seven, while the platform moves."""
    loop = ClosedLoop(*configured("sine_x", QUICK))
    loop.until(State.ACTIVE)
    for _ in range(300):
        for missed in (0, 0, 1, 0, 1):
            loop.number += missed
            loop.tick()
    assert loop.cycle.sequence.fault is Fault.NONE
