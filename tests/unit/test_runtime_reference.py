"""Trajectories: their values by hand, their derivatives by finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from tonus.config.schema.scenario import Component, Hold, Multisine, Path, Reference, Sine, Waypoint
from tonus.runtime.control.reference import Move, minimum_jerk, trajectory

SINE = Sine(kind="sine", direction=(0.0, 3.0, 4.0), amplitude=0.03, frequency=0.5, fade=2.0)
PATH = Path(
    kind="path",
    waypoints=(
        Waypoint(position=(-0.15, 0.0, 0.0), duration=2.0, pause=0.5),
        Waypoint(position=(0.2, 0.1, 0.0), duration=4.0, pause=3.0),
    ),
)
MULTISINE = Multisine(
    kind="multisine",
    components=(
        Component(direction=(0.0, 3.0, 4.0), amplitude=0.03, frequency=0.5),
        Component(direction=(1.0, 0.0, 0.0), amplitude=0.01, frequency=0.8),
    ),
    fade=2.0,
)
REFERENCES: dict[str, Hold | Sine | Multisine | Path] = {
    "hold": Hold(kind="hold"),
    "sine": SINE,
    "multisine": MULTISINE,
    "path": PATH,
}


@pytest.mark.parametrize("name", REFERENCES)
def test_velocity_and_acceleration_are_the_derivatives(name: str) -> None:
    follow, h = trajectory(REFERENCES[name]), 1e-5
    for t in np.linspace(0.05, 11.0, 300):
        position, velocity, acceleration = follow(float(t))
        behind, ahead = follow(float(t) - h), follow(float(t) + h)
        np.testing.assert_allclose(velocity, (ahead[0] - behind[0]) / (2 * h), atol=1e-8)
        np.testing.assert_allclose(acceleration, (ahead[1] - behind[1]) / (2 * h), atol=2e-5)
        assert position.shape == velocity.shape == acceleration.shape == (3,)


@pytest.mark.parametrize("reference", REFERENCES.values(), ids=REFERENCES)
def test_every_trajectory_starts_at_rest_at_home(reference: Reference) -> None:
    for part in trajectory(reference)(0.0):
        np.testing.assert_array_equal(part, 0.0)


def test_the_sine_has_its_amplitude_frequency_and_direction() -> None:
    follow = trajectory(SINE)
    crest = follow(4.5)[0]
    np.testing.assert_allclose(crest, 0.03 * np.array([0.0, 0.6, 0.8]), rtol=1e-12)
    np.testing.assert_allclose(follow(5.5)[0], -crest, rtol=1e-12)
    np.testing.assert_allclose(follow(6.5)[0], crest, rtol=1e-12)
    assert np.linalg.norm(follow(0.5)[0]) < 0.2 * 0.03


def test_the_multisine_is_the_sum_of_its_sines() -> None:
    follow, one = trajectory(MULTISINE), trajectory(SINE)
    for t in (0.7, 3.1):
        rest = follow(t)[0] - one(t)[0]
        np.testing.assert_allclose(rest[1:], 0.0, atol=1e-15)
    assert rest[0] == pytest.approx(0.01 * np.sin(2.0 * np.pi * 0.8 * 3.1))


def test_a_sine_without_fade_starts_in_full() -> None:
    follow = trajectory(SINE.model_copy(update={"fade": 0.0}))
    speed = np.linalg.norm(follow(0.0)[1])
    assert speed == pytest.approx(0.03 * np.pi)


def test_the_path_stands_at_its_points_for_their_pauses() -> None:
    follow = trajectory(PATH)
    for t, point in ((2.0, (-0.15, 0.0, 0.0)), (2.4, (-0.15, 0.0, 0.0)), (6.5, (0.2, 0.1, 0.0))):
        np.testing.assert_allclose(follow(t)[0], point, atol=1e-15)
        np.testing.assert_array_equal(follow(t)[1], 0.0)
    np.testing.assert_allclose(follow(100.0)[0], (0.2, 0.1, 0.0))


def test_a_minimum_jerk_move_is_symmetric_and_stands_at_both_ends() -> None:
    move = Move(np.zeros(3), np.array([0.1, 0.0, 0.0]), 2.0)
    assert move(1.0)[0][0] == pytest.approx(0.05)
    assert move(1.0)[1][0] == pytest.approx(1.875 * 0.1 / 2.0)
    assert move(0.7)[0][0] == pytest.approx(0.1 - move(1.3)[0][0])
    for t in (-1.0, 0.0, 2.0, 9.0):
        assert not move(t)[1].any()
        assert not move(t)[2].any()
    values = [minimum_jerk(s)[0] for s in np.linspace(0.0, 1.0, 101)]
    assert values == sorted(values)
