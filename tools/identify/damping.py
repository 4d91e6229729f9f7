"""Damping of the cables: how much later than it is pulled a cable lengthens.

More cables than six can be stretched against each other while the platform rests. With W n = 0 for
the structure matrix W, n · l' = 0 whatever the platform does, so that of the elongations e

    n · e' = n · (r θ)',

which the encoders alone tell. A cable pulls with T = EA/L e + c e', hence, summed up over time,

    ∫ n · d(T L/EA) = ∫ n · (r θ)' dt + c n · (L/EA e'),

and the cells' low-pass on the right side. Errors of the left are the noise of the cells, new at
each sample. The drums answer to it only ticks later, so that it is independent of the right side at
its own instant and least squares over all frequencies is not biased by the tension loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.signal import butter, filtfilt, lfilter

from tonus.runtime.states import State
from tonus.tools.identify.estimate import Estimate, Fit, fit, numbered
from tonus.tools.identify.record import Record, ways

Array = NDArray[np.float64]
_DEGREES = 6
"""of freedom of a platform: so many cables have no null space"""
_SLOW_HZ = 1.0
"""Below, a pose that is a little wrong looks like an elongation, and 2 ms are hardly a lag."""
_FINE_HZ, _FINE_SHARE = 100.0, 0.4
"""up to which speeds of the drums are taken, at most this share of the tick's rate: above are steps
of the encoder. A regressor with noise of its own would make the damping too small."""
_FORCED_HZ = 30.0
"""the same of elongations that move the platform, which only the cells tell"""
_SHORTEST_S = 2.0
_POLE_DOUBT = 1.0 / 3.0
"""by what share the cells may be later or earlier than their stated bandwidth makes them"""


def has_null_space(record: Record) -> bool:
    """Whether the robot's cables can be stretched against each other."""
    return record.config.robot.cables > _DEGREES


def identify_damping(records: Sequence[Record], cables: Sequence[Estimate]) -> list[Estimate]:
    """The damping of the cables, one value for each configured one. Empty when nothing stretches
    them against each other, or nothing could. ``cables`` has EA as it was identified."""
    robot = records[0].config.robot
    if not has_null_space(records[0]):
        return []
    groups = robot.groups_of_axes("cable", "damping")
    columns = [axes for axes, _ in groups]
    stiffness = _stiffness(robot.axial_stiffness, cables)
    parts = [part for record in records for part in _parts(record, stiffness, columns)]
    found, late = (_fit(parts, doubt) for doubt in (0.0, _POLE_DOUBT))
    if found is None or late is None:
        return []
    estimates = []
    for index, (axes, own) in enumerate(groups):
        change = float(late.value[index + 1] - found.value[index + 1])
        place = "robot.axes.{}" if own else "robot"
        estimates.append(
            Estimate(
                "cable_damping",
                f"cable damping c{robot.whose(axes)}",
                "N s/m",
                float(found.value[index + 1]),
                math.hypot(float(found.half_width[index + 1]), change),
                float(robot.cable_damping[axes[0]]),
                key=f"{place}.cable.damping",
                axes=axes,
            )
        )
    return estimates if any(map(_says_something, estimates)) else []


def _says_something(estimate: Estimate) -> bool:
    return estimate.half_width < max(estimate.value, estimate.configured or 0.0)


def _stiffness(configured: Array, cables: Sequence[Estimate]) -> Array:
    """N (n,): EA as identified, as configured where it is not."""
    result = configured.copy()
    for estimate in cables:
        for axis, value in zip(estimate.axes, estimate.each, strict=True):
            if math.isfinite(value):
                result[axis] = value
    return result


@dataclass(frozen=True)
class _Part:
    """A stretch of a record: what cells and drums say of the cables' elongation against each other,
    in each of the d directions of the null space."""

    block: NDArray[np.int64]
    """(n,)"""
    period: float
    cell_time: float
    """s, of the cells' low-pass"""
    felt: Array
    """m (n, d), by the tensions as if the cables were springs alone"""
    wound: Array
    """m (n, d), by the drums"""
    rates: Array
    """m/(N s/m) (n, d, g): what a damping of 1 N s/m in each group of cables adds"""

    def equations(self, doubt: float) -> tuple[Array, Array]:
        """Left side (n d,) and right side (n d, 1 + g), without what is slow; the cells later by
        this share of their low-pass than it says."""
        time = self.cell_time * (1.0 + doubt)
        right = np.concatenate([self.wound[:, :, None], self.rates], axis=2)
        right = _passed(right, time, self.period)
        columns = _quick(right, self.period).reshape(-1, right.shape[2])
        return _quick(self.felt, self.period).reshape(-1), columns


def _parts(record: Record, stiffness: Array, groups: Sequence[tuple[int, ...]]) -> list[_Part]:
    chosen = np.flatnonzero(record.inner(record.during(State.ACTIVE)))
    if not len(chosen):
        return []
    stretches = np.split(chosen, np.flatnonzero(np.diff(chosen) > 1) + 1)
    long = [part for part in stretches if len(part) * record.period > _SHORTEST_S]
    if not long:
        return []
    period = record.period
    directions, length = _null_space(record)
    free = record.smooth(length / (1.0 + record.tension / stiffness))
    wound = record.angle * record.config.robot.drum_radius
    sprung = record.tension * free / stiffness
    fine = min(_FINE_HZ, _FINE_SHARE / period)
    forced = np.gradient(_low(sprung, min(_FORCED_HZ, fine), period), period, axis=0)
    reeled = np.gradient(_low(wound, fine, period), period, axis=0)
    # The drums tell the part of an elongation that no platform can take, the cells the other one.
    rate = (forced + _within(directions, reeled - forced)) * free / stiffness
    rates = [
        np.einsum("nid,ni->nd", directions[:, axes, :], rate[:, axes]) for axes in map(list, groups)
    ]
    columns = np.stack(rates, axis=2)
    felt, told = (_summed(directions, values) for values in (sprung, wound))
    time = 1.0 / (2.0 * math.pi * record.config.response.force_cell_hz)
    return [
        _Part(record.blocks[s], period, time, felt[s], told[s], columns[s])
        for s in (slice(part[0], part[-1] + 1) for part in long)
    ]


def _null_space(record: Record) -> tuple[Array, Array]:
    """Directions (n, cables, d) with W n = 0, that turn as little as the pose demands, and the
    lengths of the cables (n, cables) in m."""
    config = record.config
    turns = record.rotation
    way = ways(config, record.smooth(record.position), turns)
    length = np.asarray(np.linalg.norm(way, axis=2))
    pull = way / length[:, :, None]
    tips = np.array(config.robot.geometry.platform)
    lever = np.einsum("nij,cj->nci", turns.as_matrix(), tips)
    moment = np.cross(lever, pull) / config.robot.geometry.moment_length
    matrix = np.concatenate([pull, moment], axis=2)
    middle = matrix[len(matrix) // 2]
    start = np.linalg.svd(middle.T)[2][_DEGREES:].T
    square = np.einsum("nci,ncj->nij", matrix, matrix)
    along = np.linalg.solve(square, np.einsum("nci,cd->nid", matrix, start))
    return start - np.einsum("nci,nid->ncd", matrix, along), length


def _within(directions: Array, values: Array) -> Array:
    """The part of values (n, cables) that lies in the null space."""
    square = np.einsum("ncd,nce->nde", directions, directions)
    seen = np.einsum("ncd,nc->nd", directions, values)
    along = np.linalg.solve(square, seen[:, :, None])[:, :, 0]
    return np.asarray(np.einsum("ncd,nd->nc", directions, along))


def _summed(directions: Array, values: Array) -> Array:
    """∫ n · dx (n, d) of values (n, cables) by the trapezium rule."""
    between = 0.5 * (directions[1:] + directions[:-1])
    steps = np.einsum("ncd,nc->nd", between, np.diff(values, axis=0))
    return np.concatenate([np.zeros_like(steps[:1]), np.cumsum(steps, axis=0)])


def _low(values: Array, cutoff: float, period: float) -> Array:
    """Without phase."""
    b, a = butter(2, cutoff, fs=1.0 / period)
    return np.asarray(filtfilt(b, a, values, axis=0))


def _passed(values: Array, time: float, period: float) -> Array:
    """Behind a low-pass of first order, exact for values that are linear between samples."""
    kept = math.exp(-period / time)
    mean = (1.0 - kept) * time / period
    start = values[:1]
    passed = lfilter([1.0 - mean, mean - kept], [1.0, -kept], values - start, axis=0)
    return np.asarray(passed + start)


def _quick(values: Array, period: float) -> Array:
    """Without the cosines slower than the slowest taken."""
    lines = dct(values, axis=0, norm="ortho")
    lines[: math.ceil(2.0 * _SLOW_HZ * len(values) * period)] = 0.0
    return np.asarray(idct(lines, axis=0, norm="ortho"))


def _fit(parts: Sequence[_Part], doubt: float) -> Fit | None:
    """How much of the drums' way the cells tell, about 1, then each group's damping (N s/m)."""
    if not parts:
        return None
    left, right = zip(*(part.equations(doubt) for part in parts), strict=True)
    felt, columns = np.concatenate(left), np.concatenate(right)
    scale = np.linalg.norm(columns, axis=0)
    if not scale.all():
        return None
    blocks = numbered([np.repeat(part.block, part.felt.shape[1]) for part in parts])
    start = np.zeros(columns.shape[1])
    return fit(lambda p: columns @ p - felt, start, blocks, scale=np.linalg.norm(felt) / scale)
