"""Frequency response: how a force moves the platform.

Eq. (16) of the paper in its own causality, X/F = 1/(M s² + C s + K), for two forces:

- *platform*, when the reference moves: F is the cables' force Σ T u, X the position. M is the moved
  mass; C and K are what holds on to it from outside, nothing in free air.
- *closed loop*, when the reference stands and something pushes: F is what pushes, which is
  M₀ (a + g) − Σ T u with the moved mass M₀, X the deviation. M, C and K are what it feels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal.windows import hann
from scipy.stats import t as student

from tonus.runtime.states import State
from tonus.tools.identify.estimate import Estimate, Fit, fit, numbered
from tonus.tools.identify.record import UNLIKE_DELAY_TICKS, Mask, Record, ways

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
_SEGMENT_S = 10.0
"""two periods of the slowest excitation, 0.2 Hz"""
_BAND_HZ = {"platform": (0.1, 1.5), "loop": (0.1, 2.5)}
"""of the paper's tests; above, the loop's delay makes it something else than M, C and K"""
_EXCITED = 0.003
"""of the strongest line's power, below which a line is not used"""
_MOVES_M = 1e-3
_YIELDS_M = 2e-4
"""RMS of reference and deviation, below which there is no motion"""
_FEWEST_SEGMENTS = 3


@dataclass(frozen=True)
class Line:
    """The response at one frequency (Hz): X/F in m/N and its interval, as shares and in rad."""

    frequency: float
    compliance: complex
    half_width: float
    """of |X/F|, as a share of it; of the phase in rad as well"""


@dataclass(frozen=True)
class Response:
    """A frequency response and M, C, K fitted to what it was computed from."""

    kind: str
    lines: tuple[Line, ...]
    fit: Fit
    """M in kg, C in N s/m, K in N/m"""
    quality: float
    """share of the force's power within the band that the fit explains"""

    def compliance(self, frequency: Array) -> Complex:
        """The fitted X/F (n,) at frequencies (n,) in Hz."""
        s = 2j * np.pi * frequency
        mass, damping, stiffness = self.fit.value
        return np.asarray(1.0 / (mass * s**2 + damping * s + stiffness))


@dataclass(frozen=True)
class _Spectra:
    """Force, displacement and its derivatives (segments, lines, 3) at the excited lines."""

    number: NDArray[np.int64]
    """(lines,) in the transform"""
    peaks: Mask
    """(lines,): those that stand out; between two of them a line is a mixture of both"""
    force: Complex
    force_rate: Complex
    displacement: Complex
    velocity: Complex
    acceleration: Complex


def moves(record: Record) -> bool:
    """Whether the reference moved in this record."""
    desired = record.desired[record.state == State.ACTIVE]
    return bool(len(desired) and _rms(desired) > _MOVES_M)


def yields(record: Record) -> bool:
    """Whether something pushed the platform off a standing reference."""
    active = record.state == State.ACTIVE
    off = (record.position - record.desired)[active]
    return not moves(record) and bool(len(off) and _rms(off) > _YIELDS_M)


def platform_response(records: Sequence[Record]) -> Response | None:
    """From records whose reference moves."""
    return response_between("platform", [(r, r.force, r.position) for r in records])


def loop_response(records: Sequence[Record], mass: float) -> Response | None:
    """From records whose reference stands; ``mass`` (kg) is what moves."""
    parts = []
    for record in records:
        velocity = np.gradient(record.position, record.period, axis=0)
        pushing = mass * np.gradient(velocity, record.period, axis=0) - record.force
        parts.append((record, pushing, record.position - record.desired))
    return response_between("loop", parts)


def weight(records: Sequence[Record], anchor_sigma: float) -> tuple[float, float]:
    """The mass (kg) that the cables carry on average and half the width of its interval, from
    records whose reference moves. What the cells' tare and the configured anchors, each coordinate
    by ``anchor_sigma`` (m), may be wrong by counts."""
    carried, blocks, tare = [], [], 0.0
    for record in records:
        active = record.during(State.ACTIVE)
        lift = np.gradient(np.gradient(record.position[:, 2], record.period), record.period)
        pull = record.config.robot.gravity + record.smooth(lift)
        carried.append((record.force[:, 2] / pull)[active])
        blocks.append(record.blocks[active])
        upright = record.direction[active, :, 2].mean(axis=0)
        tare += float(((upright * record.tare_error) ** 2).sum()) / record.config.robot.gravity**2
    masses = np.concatenate(carried)
    found = fit(lambda p: p[0] - masses, np.ones(1), numbered(blocks))
    if found is None:
        return float("nan"), float("inf")
    first = records[0]
    askew = _tilted(first, first.during(State.ACTIVE)) * anchor_sigma / first.config.robot.gravity
    systematic = found.quantile * math.hypot(math.sqrt(tare) / len(records), askew)
    return float(found.value[0]), math.hypot(float(found.half_width[0]), systematic)


def _tilted(record: Record, chosen: Mask) -> float:
    """N/m: standard error of the cables' vertical force for one of their anchors' coordinates."""
    pull, upright = record.tension[chosen].mean(axis=0), record.direction[chosen, :, 2].mean(axis=0)
    way = ways(record.config, record.position[chosen], record.rotation[chosen])
    length = np.linalg.norm(way, axis=2).mean(axis=0)
    return float(np.sqrt(((pull / length) ** 2 * (1.0 - upright**2)).sum()))


def estimates(response: Response, configured: tuple[float | None, ...]) -> list[Estimate]:
    """M, C and K."""
    texts = {
        "platform": (
            ("moved_mass", "platform mass, from inertia", "kg"),
            ("outer_damping", "damping from outside", "N s/m"),
            ("outer_stiffness", "stiffness from outside", "N/m"),
        ),
        "loop": (
            ("loop_mass", "closed loop M", "kg"),
            ("loop_damping", "closed loop C", "N s/m"),
            ("loop_stiffness", "closed loop K", "N/m"),
        ),
    }[response.kind]
    values, widths = response.fit.value.tolist(), response.fit.half_width.tolist()
    return [
        Estimate(*text, value, width, known)
        for text, value, width, known in zip(texts, values, widths, configured, strict=True)
    ]


def response_between(kind: str, parts: list[tuple[Record, Array, Array]]) -> Response | None:
    """From force (N) to displacement (m), both (n, 3), in records; None when their frequencies do
    not tell M, C and K apart."""
    spectra = [_spectra(kind, *part) for part in parts]
    usable = [part for part in spectra if part.force.size]
    found, late = (_fit(usable, delay) for delay in (0.0, UNLIKE_DELAY_TICKS * parts[0][0].period))
    if found is None or late is None:
        return None
    force = np.concatenate([part.force.reshape(-1) for part in usable])
    unexplained = float((found.residual**2).sum() / (np.abs(force) ** 2).sum())
    lines = sorted(
        (line for part in usable for line in _lines(part)), key=lambda line: line.frequency
    )
    half_width = np.hypot(found.half_width, late.value - found.value)
    return Response(kind, tuple(lines), replace(found, half_width=half_width), 1.0 - unexplained)


def _spectra(kind: str, record: Record, force: Array, displacement: Array) -> _Spectra:
    """The excited lines of half-overlapping windows over ACTIVE. Velocity and acceleration are
    derivatives in time, not jω X, so that a window's leakage biases nothing."""
    active = np.flatnonzero(record.inner(record.during(State.ACTIVE)))
    velocity = np.gradient(displacement, record.period, axis=0)
    signals = (
        force,
        np.gradient(force, record.period, axis=0),
        displacement,
        velocity,
        np.gradient(velocity, record.period, axis=0),
    )
    size = min(round(_SEGMENT_S / record.period), 2 * len(active) // (_FEWEST_SEGMENTS + 1))
    if size < 1.0 / record.period:
        none = np.empty(0, np.int64)
        return _Spectra(none, none > 0, *(np.empty((0, 0, 3), complex) for _ in signals))
    starts = range(active[0], active[-1] + 2 - size, size // 2)
    window = hann(size, sym=False)[:, None]
    low, high = _BAND_HZ[kind]
    frequency = np.fft.rfftfreq(size, record.period)
    band = np.flatnonzero((frequency > low) & (frequency < high))

    def transformed(values: Array) -> Complex:
        pieces = np.stack([values[at : at + size] for at in starts])
        pieces -= pieces.mean(axis=1, keepdims=True)
        return np.asarray(np.fft.rfft(pieces * window, axis=1)[:, band])

    all_lines = [transformed(values) for values in signals]
    power = (np.abs(all_lines[0]) ** 2).sum(axis=(0, 2))
    excited = power > _EXCITED * power.max()
    standing = np.pad((np.abs(all_lines[2]) ** 2).sum(axis=(0, 2)), 1)
    peaks = (standing[1:-1] > standing[:-2]) & (standing[1:-1] > standing[2:])
    return _Spectra(band[excited], peaks[excited], *(lines[:, excited] for lines in all_lines))


def _fit(parts: list[_Spectra], delay: float) -> Fit | None:
    """M, C, K by least squares on F = M A + C V + K X at all lines, with the force ``delay`` (s)
    earlier than it was told. Two lines, over all segments and axes, are a block."""
    if not parts:
        return None
    columns = [
        np.concatenate([_real(getattr(part, name)) for part in parts])
        for name in ("acceleration", "velocity", "displacement")
    ]
    force = np.concatenate([_real(part.force + delay * part.force_rate) for part in parts])
    blocks = numbered([_pair_numbers(part) for part in parts])
    matrix = np.stack(columns, axis=1)
    scale = np.linalg.norm(force) / np.linalg.norm(matrix, axis=0)
    return fit(lambda p: matrix @ p - force, np.zeros(3), blocks, scale=scale)


def _pair_numbers(part: _Spectra) -> NDArray[np.int64]:
    """Which pair of neighbouring lines each value in the order of `_real` belongs to, since the
    window spreads a sine over as many."""
    pairs = np.broadcast_to(part.number[:, None] // 2, part.force.shape)
    return np.tile(pairs.reshape(-1), 2)


def _real(values: Complex) -> Array:
    """Real parts, then imaginary parts, in one row."""
    flat = values.reshape(-1)
    return np.concatenate([flat.real, flat.imag])


def _lines(part: _Spectra) -> list[Line]:
    """X/F at each peak from all segments and axes, at the frequency where its power lies; all noise
    is taken as the force's, and the interval from the coherence (Bendat and Piersol)."""
    lines = []
    for k in np.flatnonzero(part.peaks):
        x, f = part.displacement[:, k].reshape(-1), part.force[:, k].reshape(-1)
        sxx, sff, sxf = float(np.vdot(x, x).real), float(np.vdot(f, f).real), complex(np.vdot(x, f))
        coherence = min(abs(sxf) ** 2 / (sxx * sff), 1.0)
        count = len(part.force)
        spread = np.sqrt((1.0 - coherence) / (2.0 * count * max(coherence, 1e-12)))
        speed = float(np.vdot(part.velocity[:, k], part.velocity[:, k]).real)
        frequency = np.sqrt(speed / sxx) / (2.0 * np.pi)
        width = float(student.ppf(0.975, 2 * count) * spread)
        lines.append(Line(float(frequency), sxx / sxf, width))
    return lines


def _rms(values: Array) -> float:
    """Of the distance (n, 3) from its mean."""
    return float(np.sqrt(((values - values.mean(axis=0)) ** 2).sum(axis=1).mean()))
