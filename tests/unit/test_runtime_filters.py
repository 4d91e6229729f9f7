"""The Butterworth bank against scipy's own filter, and its stated delay against its phase."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from tonus.runtime.control.filters import ButterworthBank, butterworth

RATE, CUTOFF = 1000.0, 50.0


def run(bank: ButterworthBank, samples: np.ndarray) -> np.ndarray:
    return np.array([bank.step(row).copy() for row in samples])


def test_every_channel_is_scipys_second_order_low_pass() -> None:
    samples = np.random.default_rng(0).normal(0.0, 10.0, (500, 9))
    b, a = signal.butter(2, CUTOFF, fs=RATE)
    expected = signal.lfilter(b, a, samples, axis=0)
    np.testing.assert_allclose(run(ButterworthBank(9, CUTOFF, RATE), samples), expected, atol=1e-9)


@given(st.floats(0.1, 1e5), st.floats(1e-4, 0.4999))
def test_coefficients_are_scipys_to_the_last_bit(rate_hz: float, share: float) -> None:
    """Logs do not depend on whose they are."""
    expected = np.array(signal.butter(2, share * rate_hz, fs=rate_hz))
    np.testing.assert_array_equal(butterworth(share * rate_hz, rate_hz), expected)


def test_a_run_does_not_wait_for_scipys_signals() -> None:
    """A second or more, at every start of a daemon."""
    code = (
        "import sys\n"
        "import tonus.tools.cli.run, tonus.tools.report.overview\n"
        "from tonus.runtime.control.filters import ButterworthBank\n"
        "ButterworthBank(1, 50.0, 1000.0)\n"
        "assert 'scipy.signal' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_stated_delay_is_the_group_delay_at_low_frequency() -> None:
    bank = ButterworthBank(1, CUTOFF, RATE)
    b, a = signal.butter(2, CUTOFF, fs=RATE)
    _, delay = signal.group_delay((b, a), w=[1.0], fs=RATE)
    assert bank.delay == pytest.approx(delay[0] / RATE, rel=0.01)
    ramp = np.arange(400.0)[:, None]
    lag = ramp[-1, 0] - run(bank, ramp)[-1, 0]
    assert bank.delay == pytest.approx(lag / RATE, rel=0.01)


def test_reset_settles_as_if_the_value_had_always_been_there() -> None:
    bank = ButterworthBank(3, CUTOFF, RATE)
    run(bank, np.random.default_rng(1).normal(size=(50, 3)))
    level = np.array([12.0, 0.0, -180.0])
    bank.reset(level)
    np.testing.assert_array_equal(bank.value, level)
    settled = run(bank, np.tile(level, (200, 1)))
    np.testing.assert_allclose(settled, np.tile(level, (200, 1)), atol=1e-9)


def test_the_cutoff_is_three_decibels_down() -> None:
    bank = ButterworthBank(1, CUTOFF, RATE)
    wave = np.sin(2.0 * np.pi * CUTOFF * np.arange(2000) / RATE)[:, None]
    assert np.abs(run(bank, wave)[1000:]).max() == pytest.approx(1 / np.sqrt(2), rel=0.01)
