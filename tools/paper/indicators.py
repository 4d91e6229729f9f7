"""The formulas behind the tables, on plain arrays. docs/paper.md lists them with their origins.

Errors of a vector (n, k) are taken by their Euclidean norm, so one figure covers all axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import integrate, signal

Array = NDArray[np.float64]


def norms(values: Array) -> Array:
    """Euclidean norm of each row (n, k), or the magnitude of (n,)."""
    return np.abs(values) if values.ndim == 1 else np.sqrt((values * values).sum(axis=1))


def rms(values: Array) -> float:
    """sqrt(mean |v|^2) of (n,) or of the rows of (n, k), eq. (17)."""
    return float(np.sqrt((norms(values) ** 2).mean()))


def settling_time(time: Array, error: Array, band: float, origin: float) -> float | None:
    """s from ``origin`` until |error| (n,) or (n, k) is inside ``band`` for good.

    0 if it never left; None if it is still outside at the end.
    """
    outside = np.flatnonzero((norms(error) > band) & (time >= origin))
    if not len(outside):
        return 0.0
    if outside[-1] == len(time) - 1:
        return None
    return float(time[outside[-1] + 1] - origin)


def overshoot(travel: Array, step: float) -> float:
    """% of the step by which ``travel`` (n,), counted along the step, goes beyond it."""
    return max(100.0 * (float(travel.max()) - step) / step, 0.0)


def phasor(time: Array, values: Array, frequency: float) -> complex:
    """Complex amplitude of (n,) at ``frequency`` in Hz: one bin of a DFT over whole periods, as
    least squares on sine, cosine and mean, which forgives a period that is no whole number of
    ticks."""
    angle = 2.0 * np.pi * frequency * time
    base = np.column_stack([np.cos(angle), np.sin(angle), np.ones_like(angle)])
    cosine, sine, _ = np.linalg.lstsq(base, values, rcond=None)[0]
    return complex(cosine, -sine)


def phase_lag(time: Array, wanted: Array, got: Array, frequency: float) -> float:
    """Degrees in (-180, 180] by which ``got`` trails ``wanted`` at ``frequency``."""
    ratio = phasor(time, wanted, frequency) / phasor(time, got, frequency)
    return float(np.degrees(np.angle(ratio)))


def r_squared(measured: Array, model: Array) -> float | None:
    """1 - SSE/SST, SST about the mean of ``measured``, column by column added up; None if
    ``measured`` does not vary. Negative where the model is worse than that mean."""
    total = float(((measured - measured.mean(axis=0)) ** 2).sum())
    if total <= 0.0:
        return None
    return 1.0 - float(((measured - model) ** 2).sum()) / total


def rise_time(time: Array, values: Array, onset: float, plateau: float, share: float) -> float:
    """s from ``onset`` until (n,) first covers ``share`` of its way from where it was at ``onset``
    to ``plateau``, linearly between ticks; nan if it never does."""
    start = int(np.searchsorted(time, onset, side="right")) - 1
    begin = float(values[max(start, 0)])
    way = plateau - begin
    if way == 0.0:
        return float("nan")
    done = (values[max(start, 0) :] - begin) / way
    reached = np.flatnonzero(done >= share)
    if not len(reached):
        return float("nan")
    index = int(reached[0]) + max(start, 0)
    if index == 0:
        return float(time[0] - onset)
    before, after = (float(values[i] - begin) / way for i in (index - 1, index))
    part = (share - before) / (after - before)
    return float(time[index - 1] + part * (time[index] - time[index - 1]) - onset)


def longest_run(flags: NDArray[np.bool_]) -> int:
    """How many True follow each other at most."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return int((edges[1::2] - edges[::2]).max()) if len(edges) else 0


def slope(displacement: Array, force: Array) -> tuple[float, float]:
    """Least squares of force against displacement, eq. (8): N/m, and the straight line's R^2."""
    x, f = displacement - displacement.mean(), force - force.mean()
    rise = float(x @ f) / float(x @ x)
    fit = r_squared(force, force.mean() + rise * x)
    return rise, 1.0 if fit is None else fit


def band_rms(time: Array, values: Array, low: float, high: float) -> float:
    """RMS of what (n,) or (n, k) contains between two frequencies in Hz, by Parseval on the
    detrended whole stretch (Hann window, amplitude-corrected)."""
    values = values.reshape(len(time), -1)
    window = signal.get_window("hann", len(time))
    flat = signal.detrend(values, axis=0) * window[:, None]
    power = np.abs(np.fft.rfft(flat, axis=0)) ** 2
    hertz = np.fft.rfftfreq(len(time), float(time[1] - time[0]))
    inside = (hertz >= low) & (hertz <= high)
    # One-sided: every bin but the first and, for an even count, the last stands for two.
    twice = np.full(len(hertz), 2.0)
    twice[0] = 1.0
    if len(time) % 2 == 0:
        twice[-1] = 1.0
    total = float((power * twice[:, None])[inside].sum())
    return float(np.sqrt(total / (len(time) * float((window**2).sum()))))


def energy(time: Array, power: Array) -> float:
    """J: the positive part of ``power`` (n,) in W over time, no regeneration counted."""
    return float(integrate.trapezoid(np.maximum(power, 0.0), time))
