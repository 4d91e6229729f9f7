"""Second-order Butterworth low-pass on a bank of channels."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


# The rows of the filter's state.
_VALUE, _FIRST, _SECOND = range(3)


@njit(cache=True)
def _biquad(value: Array, coefficients: Array, state: Array) -> None:
    """One sample of every channel; transposed direct form II. ``coefficients``: b, then a."""
    b, a = coefficients[0], coefficients[1]
    out, first, second = state[_VALUE], state[_FIRST], state[_SECOND]
    for i in range(value.shape[0]):
        y = b[0] * value[i] + first[i]
        first[i] = b[1] * value[i] - a[1] * y + second[i]
        second[i] = b[2] * value[i] - a[2] * y
        out[i] = y


def butterworth(cutoff_hz: float, rate_hz: float) -> Array:
    """Coefficients b and a (2, 3) of the second-order low-pass, by the bilinear transform with its
    cutoff prewarped. Those of ``scipy.signal.butter(2, cutoff_hz, fs=rate_hz)`` to the last bit,
    for which every start of a daemon would wait a second until scipy.signal is loaded."""
    warped = 4.0 * np.tan(np.pi * (2.0 * cutoff_hz / rate_hz) / 2.0)
    analog = -warped * np.exp(1j * np.pi * np.array([-1, 1]) / 4)
    gain = warped**2 * np.real(1.0 / np.prod(4.0 - analog))
    poles = (4.0 + analog) / (4.0 - analog)
    return np.array([gain * np.poly([-1.0, -1.0]), np.poly(poles).real])


class ButterworthBank:
    """The paper's filter (section 3.4), causal, on ``channels`` signals at once.

    It delays: at low frequency sqrt(2)/(2 pi f_c), 4.5 ms at 50 Hz. That is why the
    inner tension loop and the estimator read the unfiltered cells, and only the law, the envelope
    and the contact channel read this; `delay` is what those account for.
    """

    def __init__(self, channels: int, cutoff_hz: float, rate_hz: float) -> None:
        self._coefficients = butterworth(cutoff_hz, rate_hz)
        self._state = np.zeros((3, channels))
        self.delay = float(np.sqrt(2.0) / (2.0 * np.pi * cutoff_hz))
        """s, group delay at low frequency"""
        self.value: Array = self._state[_VALUE]

    def reset(self, value: Array) -> None:
        """Settle at ``value``, as after a constant input."""
        b, a = self._coefficients
        self._state[_VALUE] = value
        self._state[_FIRST] = (1.0 - b[0]) * value
        self._state[_SECOND] = (b[2] - a[2]) * value

    def step(self, value: Array) -> Array:
        """One sample; the result stays in `value`."""
        _biquad(value, self._coefficients, self._state)
        return self.value
