"""Intervals that hold: coverage over seeds, shared noise, and verdicts."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from tonus.tools.identify.estimate import Estimate, Fit, fit, mean_of

Array = NDArray[np.float64]
TRUE = np.array([2.0, 0.3])
TIME = np.arange(10_000) * 1e-3
BLOCKS = (TIME / 0.25).astype(np.int64)
SINGLY = np.arange(len(TIME))


def lasting(seed: int) -> Array:
    """Noise whose neighbours are alike for some 50 ms."""
    white = np.random.default_rng(seed).standard_normal(len(TIME))
    return np.asarray(lfilter([0.02], [1.0, -0.98], white))


def line(noise: Array, blocks: NDArray[np.int64] = BLOCKS) -> Fit:
    seen = TRUE[0] + TRUE[1] * TIME + noise
    found = fit(lambda p: p[0] + p[1] * TIME - seen, np.zeros(2), blocks)
    assert found is not None
    return found


def covered(blocks: NDArray[np.int64], seeds: int = 40) -> Array:
    """Share of the seeds whose interval holds the truth, for both parameters."""
    fits = [line(lasting(seed), blocks) for seed in range(seeds)]
    return np.mean([np.abs(found.value - TRUE) <= found.half_width for found in fits], axis=0)


def test_intervals_hold_although_neighbouring_residuals_are_alike() -> None:
    assert covered(BLOCKS).min() >= 0.85


def test_without_blocks_they_would_not() -> None:
    assert covered(SINGLY, 20).max() < 0.6


def test_noise_that_fits_have_in_common_does_not_average_out() -> None:
    alone = line(lasting(1)).half_width[1]
    same = mean_of([line(lasting(1))] * 8, 1)[1]
    unlike = mean_of([line(lasting(seed)) for seed in range(8)], 1)[1]
    assert same == pytest.approx(alone)
    assert unlike == pytest.approx(alone / np.sqrt(8.0), rel=0.3)


def test_parameters_that_cannot_be_told_apart_are_not_fitted() -> None:
    assert fit(lambda p: (p[0] + p[1]) * TIME - TIME, np.zeros(2), BLOCKS) is None


def test_too_little_data_is_not_fitted() -> None:
    assert fit(lambda p: p[0] - TIME[:600], np.zeros(1), BLOCKS[:600] // 2) is None


@pytest.mark.parametrize(
    ("value", "half_width", "configured", "verdict"),
    [
        (1.05, 0.10, 1.0, "as configured"),
        (1.015, 0.001, 1.0, "as configured"),
        (1.30, 0.10, 1.0, "differs +30.0 %"),
        (1.30, 0.90, 1.0, "uncertain"),
        (0.30, 0.10, 0.0, "differs"),
        (0.05, 0.10, None, "none found"),
        (0.30, 0.10, None, ""),
    ],
)
def test_the_verdict_weighs_value_interval_and_configuration(
    value: float, half_width: float, configured: float | None, verdict: str
) -> None:
    assert Estimate("a", "a", "N", value, half_width, configured).verdict == verdict
