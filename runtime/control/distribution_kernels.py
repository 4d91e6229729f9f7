"""The compiled part of the tension distribution: what each cable does for a wrench, its bounds and
centre, the minimiser without bounds, and what is delivered.

Functions that call each other stand in this one file because numba's cache notices a change in a
function's own file only.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True)
def opposition(
    matrix: Array, lengths: Array, force: Array, least: float, agonism: Array, gradient: Array
) -> None:
    """How far each cable pulls with a force (agonist, up to 1) or against it (antagonist, down to
    -1), and the derivative (1/m) of the geometric stiffness along it by each tension,

        g_i = (1 - (u_i . d)^2) / l_i.

    ``least`` (N) makes both smooth where the force vanishes and has no direction: no cable is then
    an agonist, and g is the mean over all directions.
    """
    size = force[0] ** 2 + force[1] ** 2 + force[2] ** 2
    for i in range(lengths.shape[0]):
        along = matrix[0, i] * force[0] + matrix[1, i] * force[1] + matrix[2, i] * force[2]
        agonism[i] = along / (math.sqrt(size) + least)
        share = (along * along + least * least / 3.0) / (size + least * least)
        gradient[i] = (1.0 - share) / lengths[i]


@njit(cache=True)
def tension_bounds(
    matrix: Array,
    before: Array,
    present: NDArray[np.bool_],
    levels: tuple[float, float, float, float],
    contraction: float,
    agonism: Array,
    low: Array,
    high: Array,
    centre: Array,
    bearing: Array,
) -> None:
    """Bounds and centre of each tension: the configured ones, no further from the last reference
    than ``reach``, and zero where a cable is lost. ``levels``: low, high, centre, reach; the centre
    rises by the share ``contraction``, of antagonists more and of agonists less, since the wrench
    tightens these anyway. ``bearing`` becomes the structure matrix without the lost cables.
    """
    lowest, highest, middle, reach = levels
    for i in range(before.shape[0]):
        low[i] = high[i] = centre[i] = 0.0
        if present[i]:
            low[i] = min(max(before[i] - reach, lowest), highest)
            high[i] = max(min(before[i] + reach, highest), lowest)
            wanted = middle * (1.0 + contraction * (1.0 - agonism[i]))
            centre[i] = min(max(wanted, lowest), highest)
        for row in range(6):
            bearing[row, i] = matrix[row, i] if present[i] else 0.0


@njit(cache=True)
def delivered(
    matrix: Array,
    reference: Array,
    commanded: Array,
    gradient: Array,
    tension: Array,
    delivered: Array,
    shortfall: Array,
) -> float:
    """The wrench (6,) of the tension ``reference`` and the force (3,) it falls short by; returns
    the geometric stiffness (N/m) of the measured tensions."""
    for row in range(6):
        total = 0.0
        for i in range(reference.shape[0]):
            total += matrix[row, i] * reference[i]
        delivered[row] = total
        if row < 3:
            shortfall[row] = commanded[row] - total
    geometric = 0.0
    for i in range(tension.shape[0]):
        geometric += gradient[i] * tension[i]
    return geometric


@njit(cache=True)
def _free_minimiser(
    matrix: Array,
    wrench: Array,
    bounds: tuple[Array, Array, Array],
    gradient: Array,
    weights: tuple[float, float],
    scale: Array,
    normal: Array,
    scaled: tuple[Array, Array],
    tensions: Array,
) -> bool:
    """Tensions without regard to the bounds, and whether they lie within them.

    ``bounds``: low, high, centre; ``weights``: of the wrench, and the root of that of the row
    ``gradient``. ``normal`` (n, n) becomes H = I + p p^T + weight W^T W; ``scaled``, matrix and
    wrench, what they are times ``scale``.
    """
    low, high, centre = bounds
    weight, preference = weights
    w, target = scaled
    size = centre.shape[0]
    row = np.empty(size)
    metric = 0.0
    for i in range(size):
        # A lost cable must not take part: its correction has to be zero by itself.
        row[i] = preference * gradient[i] if high[i] > low[i] else 0.0
        metric += row[i] * centre[i]
    for k in range(6):
        target[k] = scale[k] * wrench[k]
        for i in range(size):
            w[k, i] = scale[k] * matrix[k, i]
    right, finite = np.empty(size), True
    for i in range(size):
        pulled = 0.0
        for k in range(6):
            pulled += w[k, i] * target[k]
        right[i] = centre[i] + row[i] * metric + weight * pulled
        finite = finite and math.isfinite(right[i])
        for j in range(i + 1):
            together = 0.0
            for k in range(6):
                together += w[k, i] * w[k, j]
            value = weight * together + row[i] * row[j] + (1.0 if i == j else 0.0)
            normal[i, j] = normal[j, i] = value
            finite = finite and math.isfinite(value)
    if not finite:
        tensions[:] = np.nan
        return True
    tensions[:] = np.linalg.solve(normal, right)
    inside = True
    for i in range(size):
        inside = inside and low[i] <= tensions[i] <= high[i]
    return inside


@njit(cache=True)
def deliver(
    matrix: Array, wrench: Array, low: Array, high: Array, tensions: Array
) -> tuple[bool, float]:
    """Put the tensions into their bounds to the last bit; whether all are numbers, and the norm of
    the wrench they miss."""
    for i in range(tensions.shape[0]):
        if not math.isfinite(tensions[i]):
            return False, math.inf
        tensions[i] = min(max(tensions[i], low[i]), high[i])
    total = 0.0
    for row in range(6):
        miss = -wrench[row]
        for i in range(tensions.shape[0]):
            miss += matrix[row, i] * tensions[i]
        total += miss * miss
    return True, math.sqrt(total)


@njit(cache=True)
def prepare(
    matrix: Array,
    lengths: Array,
    force: Array,
    before: Array,
    present: NDArray[np.bool_],
    lowest: float,
    highest: float,
    middle: float,
    contraction: float,
    least: float,
    reach: float,
    agonism: Array,
    gradient: Array,
    low: Array,
    high: Array,
    centre: Array,
    bearing: Array,
) -> None:
    """`opposition`, then `tension_bounds`."""
    opposition(matrix, lengths, force, least, agonism, gradient)
    levels = (lowest, highest, middle, reach)
    tension_bounds(
        matrix, before, present, levels, contraction, agonism, low, high, centre, bearing
    )


@njit(cache=True)
def solve(
    matrix: Array,
    wrench: Array,
    low: Array,
    high: Array,
    centre: Array,
    gradient: Array,
    weight: float,
    preference: float,
    scale: Array,
    normal: Array,
    scaled: Array,
    target: Array,
    tensions: Array,
) -> tuple[bool, bool, float]:
    """`_free_minimiser` and, where that is the answer, `deliver`: whether it is, and what that
    returns."""
    bounds, weights, found = (low, high, centre), (weight, preference), (scaled, target)
    if not _free_minimiser(
        matrix, wrench, bounds, gradient, weights, scale, normal, found, tensions
    ):
        return False, False, 0.0
    finite, deficit = deliver(scaled, target, low, high, tensions)
    return True, finite, deficit


# The rows of what a tick's distribution keeps of each cable, (5, n), and of wrenches, (3, 6).
AGONISM, GRADIENT, LOW, HIGH, CENTRE = range(5)
SCALE, TARGET, DELIVERED = range(3)


@njit(cache=True)
def distribute_tick(
    prepared: bool,
    matrix: Array,
    lengths: Array,
    wrench: Array,
    before: Array,
    present: NDArray[np.bool_],
    lowest: float,
    highest: float,
    middle: float,
    contraction: float,
    tension: Array,
    tensions: Array,
    cables: Array,
    bearing: Array,
    scaled: Array,
    normal: Array,
    wrenches: Array,
    shortfall: Array,
    numbers: Array,
) -> tuple[bool, bool, float, float]:
    """`prepare`, unless that is done, then `solve` into ``tensions``, and where these are the
    answer, what they and the measured ``tension`` (n,) have `delivered`; returns what both do.
    ``cables`` (5, n) and ``wrenches`` (3, 6) have the rows above; ``numbers``: least force and
    reach (N), weight and preference."""
    gradient, low, high, centre = cables[GRADIENT], cables[LOW], cables[HIGH], cables[CENTRE]
    if not prepared:
        prepare(
            matrix,
            lengths,
            wrench[:3],
            before,
            present,
            lowest,
            highest,
            middle,
            contraction,
            numbers[0],
            numbers[1],
            cables[AGONISM],
            gradient,
            low,
            high,
            centre,
            bearing,
        )
    inside, finite, deficit = solve(
        bearing,
        wrench,
        low,
        high,
        centre,
        gradient,
        numbers[2],
        numbers[3],
        wrenches[SCALE],
        normal,
        scaled,
        wrenches[TARGET],
        tensions,
    )
    geometric = 0.0
    if inside and finite:
        geometric = delivered(
            matrix, tensions, wrench, gradient, tension, wrenches[DELIVERED], shortfall
        )
    return inside, finite, deficit, geometric
