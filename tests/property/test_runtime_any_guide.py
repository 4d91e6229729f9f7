"""The reference never jumps, however states and the envelope's pace change."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tonus.config import load
from tonus.config.schema.scenario import Path, Waypoint
from tonus.runtime.control.guide import Guide
from tonus.runtime.states import State

CONFIG, SCENARIO = load("config/can.yaml", scenario="sine_x")
SEQUENCE, PERIOD = CONFIG.control.sequence, CONFIG.control.rates.period
REST, HOME = np.array(CONFIG.robot.rest), np.array(CONFIG.robot.home)
FASTEST = 0.2
"""m/s, more than sine, lift and lowering ever ask for"""
STRONGEST = 2.0
"""m/s2: sine and moves with the bend of a slowing scenario on top"""
Array = NDArray[np.float64]
LIFTED_S = SEQUENCE.pretension_s + SEQUENCE.lift_s + 1.0 / SEQUENCE.reference_slew


@dataclass
class Follower:
    """Drives a guide and checks each step against the one before."""

    guide: Guide = field(
        default_factory=lambda: Guide(
            CONFIG.robot, SEQUENCE, CONFIG.control.envelope, SCENARIO.reference, PERIOD
        )
    )
    position: Array = field(default_factory=REST.copy)
    velocity: Array = field(default_factory=lambda: np.zeros(3))

    def during(self, state: State, seconds: float, progress: float = 1.0) -> None:
        for n in range(round(seconds / PERIOD)):
            self.tick(state, n * PERIOD, progress)

    def tick(self, state: State, elapsed: float, progress: float = 1.0) -> None:
        position, velocity, _ = self.guide(state, elapsed, progress)
        step = position - self.position
        assert np.abs(step).max() <= FASTEST * PERIOD, (state, elapsed, step)
        assert np.abs(step - PERIOD * velocity).max() <= STRONGEST * PERIOD**2, (state, elapsed)
        bend = np.abs(velocity - self.velocity).max()
        assert bend <= STRONGEST * PERIOD, (state, elapsed, bend)
        self.position, self.velocity = position.copy(), velocity.copy()

    def stop(self) -> None:
        self.during(State.SAFE_STOP, SEQUENCE.stop_s + self.guide.plan_stop() + 2.0 * PERIOD)


def lifted() -> Follower:
    follower = Follower()
    follower.guide.start(REST)
    follower.during(State.PRETENSION, LIFTED_S)
    np.testing.assert_allclose(follower.position, HOME, atol=1e-6)
    return follower


paces = st.lists(
    st.tuples(
        st.sampled_from([State.HOLD, State.ACTIVE]), st.floats(0.0, 1.0), st.integers(1, 700)
    ),
    min_size=1,
    max_size=5,
)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(paces)
def test_position_and_velocity_are_continuous_from_the_cradle_and_back(
    phases: list[tuple[State, float, int]],
) -> None:
    follower = lifted()
    for state, progress, ticks in phases:
        follower.during(state, ticks * PERIOD, progress)
    follower.stop()
    np.testing.assert_allclose(follower.position, REST, atol=1e-6)
    np.testing.assert_array_equal(follower.velocity, 0.0)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_stop_in_the_midst_of_lifting_is_smooth_too(share: float) -> None:
    follower = Follower()
    follower.guide.start(REST)
    follower.during(State.PRETENSION, SEQUENCE.pretension_s + share * SEQUENCE.lift_s)
    follower.stop()
    np.testing.assert_allclose(follower.position, REST, atol=1e-6)


def test_a_stop_that_waits_stands_and_then_lowers() -> None:
    """As the sequence counts its time under a load: the difference of two sums, whose rounding
    errors have either sign."""
    follower = lifted()
    lower_s = follower.guide.plan_stop()
    waited = 0.0
    for n in range(round((SEQUENCE.hold_s + SEQUENCE.stop_s + lower_s) / PERIOD) + 2):
        if n * PERIOD - waited >= SEQUENCE.stop_s and waited < SEQUENCE.hold_s:
            waited += PERIOD
        follower.tick(State.SAFE_STOP, n * PERIOD - waited)
        if waited < SEQUENCE.hold_s:
            np.testing.assert_allclose(follower.position, HOME, atol=1e-6)
    np.testing.assert_allclose(follower.position, REST, atol=1e-6)


def test_lowering_from_a_corner_keeps_the_speed_limit() -> None:
    corner = Waypoint(position=(0.2, 0.2, 0.15), duration=3.0)
    guide = Guide(
        CONFIG.robot,
        SEQUENCE,
        CONFIG.control.envelope,
        Path(kind="path", waypoints=(corner,)),
        PERIOD,
    )
    guide.start(HOME)
    for n in range(4000):
        guide(State.ACTIVE, n * PERIOD, 1.0)
    speeds = [
        np.linalg.norm(guide(State.SAFE_STOP, n * PERIOD, 1.0)[1])
        for n in range(round((SEQUENCE.stop_s + guide.plan_stop()) / PERIOD))
    ]
    assert max(speeds) <= CONFIG.control.envelope.speed_limit


def test_hold_stands_and_active_goes_on_where_it_stood() -> None:
    follower = lifted()
    follower.during(State.ACTIVE, 2.4)
    follower.during(State.HOLD, 1.0)
    standing, time = follower.position.copy(), follower.guide.time
    follower.during(State.HOLD, 0.5)
    np.testing.assert_array_equal(follower.position, standing)
    assert follower.guide.time == time
    follower.during(State.ACTIVE, 0.5)
    assert follower.guide.time > time


def test_a_second_run_starts_over() -> None:
    follower = lifted()
    follower.during(State.ACTIVE, 1.3)
    follower.stop()
    follower.guide.start(REST)
    follower.during(State.PRETENSION, LIFTED_S)
    np.testing.assert_allclose(follower.position, HOME, atol=1e-6)
    assert follower.guide.time == 0.0
