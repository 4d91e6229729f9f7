"""The trapezoid keeps its limits from any start to any target, and ends exactly there."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tonus.sim.devices.cia402.profile import Trapezoid

DT = 4e-4
ramps = st.floats(5e4, 1e7)


@given(
    target=st.floats(-1e4, 1e4),
    speed=st.floats(-2e4, 2e4),
    top=st.floats(5e3, 5e4),
    up=ramps,
    down=ramps,
)
@settings(max_examples=50, derandomize=True, deadline=None)
def test_a_move_keeps_its_limits_and_arrives(
    target: float, speed: float, top: float, up: float, down: float
) -> None:
    profile = Trapezoid()
    profile.place(0.0, speed)
    # Stopping, going back and the way itself, each with its ramps; then some.
    seconds = 2.0 * (abs(target) + speed**2 / down) / top + 6.0 * (top + abs(speed)) / min(up, down)
    for _ in range(round(seconds / DT) + 50):
        before = profile.speed
        arrived = profile.to_position(target, top, up, down, DT)
        if arrived:
            break
        change = abs(profile.speed - before)
        assert change <= max(up, down) * DT * (1.0 + 1e-9)
        assert abs(profile.speed) <= max(top, abs(before)) * (1.0 + 1e-9)
    else:
        pytest.fail(f"not there: {profile}")
    assert profile.position == target
    assert profile.speed == 0.0


@given(target=st.floats(-1e4, 1e4), top=st.floats(5e3, 5e4), up=ramps, down=ramps)
@settings(max_examples=30, derandomize=True, deadline=None)
def test_from_rest_a_move_never_passes_its_target(
    target: float, top: float, up: float, down: float
) -> None:
    profile = Trapezoid()
    # What one step can add to a stop: the demand is in steps, its target is not.
    slack = top * DT * 1e-6 + 1e-6
    for _ in range(20_000):
        if profile.to_position(target, top, up, down, DT):
            return
        assert min(0.0, target) - slack <= profile.position <= max(0.0, target) + slack
