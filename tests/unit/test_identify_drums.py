"""Drums: parameters from made-up signals, intervals that hold, friction that is not as modelled."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from tonus.tools.identify.drums import Drum, fit_drum

Array = NDArray[np.float64]
RADIUS = 0.02
TRUE = np.array([0.0042, 0.012, 1.5, 0.03, 0.8, 0.75])
"""J, b, F_c, μ, η driving, η driven back"""
TIME = np.arange(10_000) * 1e-3
SLOWEST = 0.5  # rad/s


def torque(rate: Array, acceleration: Array, tension: Array, stribeck: float) -> Array:
    """The balance of torques, written out direction by direction."""
    inertia, viscous, coulomb, load, driving, driven = TRUE
    dry = RADIUS * (coulomb + load * tension)
    dry = dry * (1.0 + stribeck * np.exp(-((rate * RADIUS / 0.01) ** 2)))
    result = np.empty_like(rate)
    for k, w in enumerate(rate):
        cable = RADIUS * tension[k] + inertia * acceleration[k] + viscous * w
        result[k] = (cable + dry[k]) / driving if w > 0.0 else (cable - dry[k]) * driven
    return result


def swing(time: Array, phase: float) -> tuple[Array, Array, Array]:
    """Rate of 0.4 and 1 Hz, and its two derivatives."""
    w1, w2 = 2.0 * np.pi * 0.4, 2.0 * np.pi
    a, b = w1 * time, w2 * time + phase
    return (
        4.0 * np.cos(a) + 2.5 * np.cos(b),
        -4.0 * w1 * np.sin(a) - 2.5 * w2 * np.sin(b),
        -4.0 * w1**2 * np.cos(a) - 2.5 * w2**2 * np.cos(b),
    )


def drum(seed: int, stribeck: float = 0.0, *, late: float = 0.0) -> Drum:
    """A drum that swings while its tension changes by 15 N either way; its encoder is ``late``
    s."""
    random = np.random.default_rng(seed)
    phase = random.uniform(0.0, 6.28)
    rate, acceleration, _ = swing(TIME, phase)
    told, growing, jerk = swing(TIME - late, phase)
    tension = 45.0 + 15.0 * np.sin(0.63 * TIME + random.uniform(0.0, 6.28))
    noise = lfilter([0.06], [1.0, -0.94], random.standard_normal(len(TIME)))
    turning = np.abs(rate) > SLOWEST
    signals = (
        jerk,
        growing,
        told,
        torque(rate, acceleration, tension, stribeck) + 0.01 * noise,
        tension,
        np.gradient(tension, 1e-3),
    )
    blocks = (TIME[turning] / 0.25).astype(np.int64)
    return Drum(RADIUS, blocks, *(signal[turning] for signal in signals))


def test_the_intervals_hold_for_every_parameter() -> None:
    held = []
    for seed in range(15):
        found = fit_drum(drum(seed))
        assert found is not None
        held.append(np.abs(found.value - TRUE) <= found.half_width)
        assert (found.half_width[[0, 4, 5]] < 0.05 * TRUE[[0, 4, 5]]).all(), "and say something"
    assert (np.mean(held, axis=0) >= 0.8).all()


def test_friction_that_is_not_as_modelled_widens_the_intervals() -> None:
    """With a Stribeck rise of half the friction the model is wrong; its inertia still is not."""
    plain, other = fit_drum(drum(1)), fit_drum(drum(1, stribeck=0.5))
    assert plain is not None
    assert other is not None
    assert other.half_width[2] > plain.half_width[2]
    assert other.value[0] == pytest.approx(TRUE[0], rel=0.02)


def test_an_encoder_that_is_late_is_set_right() -> None:
    true, delay = drum(3), 5e-3
    late = drum(3, late=delay)
    right = late.corrected(encoder=delay)
    for name in ("rate", "acceleration"):
        wrong = np.abs(getattr(late, name) - getattr(true, name)).max()
        assert np.abs(getattr(right, name) - getattr(true, name)).max() < 0.05 * wrong
    found = fit_drum(right)
    assert found is not None
    assert found.value[1] == pytest.approx(TRUE[1], rel=0.05)


def test_a_drum_that_only_winds_says_nothing() -> None:
    whole = drum(1)
    winding = whole.rate > 0.0
    columns = ("jerk", "acceleration", "rate", "torque", "tension", "tension_rate")
    half = Drum(RADIUS, whole.block[winding], *(getattr(whole, name)[winding] for name in columns))
    assert fit_drum(half) is None
