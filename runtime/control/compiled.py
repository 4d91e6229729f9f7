"""The compiled part of pose and motion: geometry, rotations, forward kinematics, and the
estimator's filter.

Functions that call each other stand in this one file because numba's cache notices a change in a
function's own file only. In plain numpy the geometry alone, which a tick needs three times, takes
some forty times as long (`make bench`).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
_FIRST_DAMPING, _LESS, _MORE = 1e-9, 0.1, 1e4
"""Levenberg-Marquardt: nearly Gauss-Newton, which from a warm start converges in one or two steps;
the damping shrinks after a step that helped and grows after one that did not."""
_CONVERGED = 1e-10
"""m and rad"""
_RIDGE = 1e-12
_UNKNOWN = 1.0
"""m2, variance of a length that nobody measured"""
TWIST, EXTERNAL, OFFSETS = 6, 12, 18
"""Where the parts of the error state begin after the pose: twist, external wrench, an offset of
each length and, last, the excess of each cable's compliance."""


def error_size(cables: int) -> int:
    """Of the error state of a robot with so many cables."""
    return OFFSETS + 2 * cables


@njit(cache=True)
def geometry(
    position: Array, quaternion: Array, frame: Array, platform: Array, lengths: Array, matrix: Array
) -> None:
    """Fill ``lengths`` (n,) and the structure matrix (6, n) for a pose (quaternion w x y z)."""
    w, x, y, z = quaternion
    rotation = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    for i in range(frame.shape[0]):
        b0, b1, b2 = platform[i, 0], platform[i, 1], platform[i, 2]
        r0 = rotation[0][0] * b0 + rotation[0][1] * b1 + rotation[0][2] * b2
        r1 = rotation[1][0] * b0 + rotation[1][1] * b1 + rotation[1][2] * b2
        r2 = rotation[2][0] * b0 + rotation[2][1] * b1 + rotation[2][2] * b2
        u0 = frame[i, 0] - position[0] - r0
        u1 = frame[i, 1] - position[1] - r1
        u2 = frame[i, 2] - position[2] - r2
        length = math.sqrt(u0 * u0 + u1 * u1 + u2 * u2)
        lengths[i] = length
        u0, u1, u2 = u0 / length, u1 / length, u2 / length
        matrix[0, i], matrix[1, i], matrix[2, i] = u0, u1, u2
        matrix[3, i] = r1 * u2 - r2 * u1
        matrix[4, i] = r2 * u0 - r0 * u2
        matrix[5, i] = r0 * u1 - r1 * u0


@njit(cache=True)
def rotate(quaternion: Array, rotation: Array) -> Array:
    """Turn an orientation by a rotation vector given in the base frame; unit length is kept."""
    angle = math.sqrt(rotation[0] ** 2 + rotation[1] ** 2 + rotation[2] ** 2)
    half = 0.5 * angle
    scale = 0.5 - angle * angle / 48.0 if angle < 1e-4 else math.sin(half) / angle
    a, b, c, d = math.cos(half), rotation[0] * scale, rotation[1] * scale, rotation[2] * scale
    w, x, y, z = quaternion
    turned = np.array(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
    )
    return turned / math.sqrt((turned**2).sum())


@njit(cache=True)
def angular_velocity(vector: Array, rate: Array) -> Array:
    """Of an orientation (3,), base frame, whose rotation vector is ``vector`` and changes at
    ``rate``: the left Jacobian of SO(3) times the rate (Barfoot 2017)."""
    angle = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    square = angle * angle
    first = 0.5 - square / 24.0 if angle < 1e-4 else (1.0 - math.cos(angle)) / square
    second = 1.0 / 6.0 - square / 120.0
    if angle >= 1e-4:
        second = (angle - math.sin(angle)) / (square * angle)
    once = np.cross(vector, rate)
    return rate + first * once + second * np.cross(vector, once)


@njit(cache=True)
def forward(
    measured: Array,
    usable: NDArray[np.bool_],
    anchors: tuple[Array, Array],
    position: Array,
    quaternion: Array,
    lengths: Array,
    matrix: Array,
    iterations: int,
) -> float:
    """Levenberg-Marquardt from ``position`` and ``quaternion``, which it moves to the pose whose
    lengths fit the ``usable`` ones of ``measured`` (n,) best; geometry is left standing there.

    Returns the RMS of what remains (m); not a number for lengths that are none.
    """
    count = max(1, usable.sum())
    geometry(position, quaternion, anchors[0], anchors[1], lengths, matrix)
    cost = ((lengths - measured)[usable] ** 2).sum()
    damping, step = _FIRST_DAMPING, np.empty(6)
    for _ in range(iterations):
        normal, right = np.zeros((6, 6)), np.zeros(6)
        for i in range(lengths.shape[0]):
            if not usable[i]:
                continue
            error = lengths[i] - measured[i]
            for row in range(6):
                right[row] += matrix[row, i] * error
                for column in range(6):
                    normal[row, column] += matrix[row, i] * matrix[column, i]
        for row in range(6):
            # The ridge, far below the last bit, is for a cable or two without a measurement.
            normal[row, row] += damping * normal[row, row] + _RIDGE
        if not (np.isfinite(normal).all() and np.isfinite(right).all()):
            return math.nan
        step[:] = np.linalg.solve(normal, right)
        there, turned = position + step[:3], rotate(quaternion, step[3:])
        geometry(there, turned, anchors[0], anchors[1], lengths, matrix)
        found = ((lengths - measured)[usable] ** 2).sum()
        if found <= cost:
            position[:], quaternion[:], cost = there, turned, found
            damping *= _LESS
        else:
            geometry(position, quaternion, anchors[0], anchors[1], lengths, matrix)
            damping *= _MORE
        if np.abs(step).max() < _CONVERGED:
            break
    return math.sqrt(cost / count)


@njit(cache=True)
def condition(matrix: Array, moment_length: float) -> float:
    """Condition number of the structure matrix, its moments divided by ``moment_length``; infinite
    in a singular pose."""
    scaled = matrix.copy()
    scaled[3:] /= moment_length
    normal = scaled @ scaled.T
    if not np.isfinite(normal).all():
        return math.nan
    sizes = np.linalg.eigvalsh(normal)
    return math.sqrt(sizes[5] / sizes[0]) if sizes[0] > 0.0 else math.inf


@njit(cache=True)
def elongation(length: float, tension: float, axial_stiffness: float) -> float:
    """m, of a cable that is ``length`` long under ``tension``."""
    return length * tension / (axial_stiffness + tension)


@njit(cache=True)
def accelerations(
    wrench: Array, mobility: Array, rest: Array, body: tuple[float, Array, float, Array]
) -> Array:
    """(6,) under the cables' wrench, the external one and gravity. The gyroscopic moment is left to
    the external one: at 0.3 rad/s it is 1 mN m."""
    result = mobility @ (wrench + rest[EXTERNAL - TWIST : OFFSETS - TWIST])
    result[2] -= body[2]
    return result


@njit(cache=True)
def _mobility(quaternion: Array, mass: float, inertia: Array) -> Array:
    """Accelerations per wrench, (6, 6), base frame."""
    mobility = np.zeros((6, 6))
    w, x, y, z = quaternion
    rotation = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    for i in range(3):
        mobility[i, i] = 1.0 / mass
        for j in range(3):
            for k in range(3):
                mobility[3 + i, 3 + j] += rotation[i][k] * rotation[j][k] / inertia[k]
    return mobility


@njit(cache=True)
def _predict(
    covariance: Array, mobility: Array, noise: Array, creep: float, excess: int, h: float
) -> None:
    """F P F' + Q in place, with F = [[1, h, h^2/2 B], [0, 1, h B], [0, 0, 1]] over pose, twist and
    external wrench; B is the mobility, and the constants of calibration stay what they are, but for
    the ``creep`` that all compliances, from ``excess`` on, have in common."""
    size = covariance.shape[0]
    pushed = np.zeros((6, size))
    for i in range(6):
        for k in range(6):
            share = mobility[i, k]
            if share != 0.0:
                for j in range(size):
                    pushed[i, j] += share * covariance[EXTERNAL + k, j]
    for i in range(6):
        for j in range(size):
            covariance[i, j] += h * (covariance[TWIST + i, j] + 0.5 * h * pushed[i, j])
            covariance[TWIST + i, j] += h * pushed[i, j]
    pulled = np.zeros((size, 6))
    for j in range(size):
        for k in range(6):
            share = covariance[j, EXTERNAL + k]
            for i in range(6):
                pulled[j, i] += share * mobility[k, i]
        for i in range(6):
            covariance[j, i] += h * (covariance[j, TWIST + i] + 0.5 * h * pulled[j, i])
            covariance[j, TWIST + i] += h * pulled[j, i]
    for i in range(size):
        for j in range(i):
            # The two halves were computed in different orders, and differ in the last bit.
            covariance[i, j] = covariance[j, i]
        covariance[i, i] += noise[i]
    for i in range(excess, size):
        for j in range(excess, size):
            covariance[i, j] += creep


@njit(cache=True)
def _absorb(position: Array, quaternion: Array, rest: Array, error: Array) -> None:
    """Move an error state into the nominal one: addition, and a turn for the orientation."""
    position += error[:3]
    quaternion[:] = rotate(quaternion, error[3:6])
    rest += error[6:]


@njit(cache=True)
def _judge(
    wanted: Array,
    tensions: Array,
    elastic: Array,
    usable: NDArray[np.bool_],
    rest: Array,
    axial_stiffness: Array,
    limits: tuple[float, float],
    lengths: Array,
    innovations: Array,
    believed: NDArray[np.bool_],
) -> None:
    """Innovations of the lengths, and which to believe: a slack cable has no length to measure but
    for being no shorter, and one that is far off while most are not is wrong."""
    slack, gate = limits
    excess = OFFSETS + lengths.shape[0]
    far, near = 0, 0
    for i in range(lengths.shape[0]):
        innovations[i], believed[i] = math.nan, False
        if not usable[i]:
            continue
        stretch = elongation(wanted[i], elastic[i], axial_stiffness[i])
        softer = rest[excess - TWIST + i] * stretch
        found = wanted[i] + rest[OFFSETS - TWIST + i] + softer - lengths[i]
        if tensions[i] <= slack:
            innovations[i] = min(found, 0.0)
            continue
        innovations[i], believed[i] = found, True
        if abs(found) > gate:
            far += 1
        else:
            near += 1
    if near >= far + 3:
        for i in range(lengths.shape[0]):
            believed[i] = believed[i] and abs(innovations[i]) <= gate


@njit(cache=True)
def filter_tick(
    state: tuple[Array, Array, Array, Array, Array],
    body: tuple[float, Array, float, Array],
    period: float,
    noise: tuple[Array, float, float, float],
    anchors: tuple[Array, Array],
    measured: tuple[Array, Array, Array, NDArray[np.bool_]],
    limits: tuple[float, float],
    lengths: Array,
    matrix: Array,
    innovations: Array,
    doubts: Array,
    believed: NDArray[np.bool_],
) -> float:
    """Predict over a period with the cables' wrench, then correct with each believed length.

    ``state``: position (3,), quaternion (4,), rest (12 + 2n,), covariance (18 + 2n, 18 + 2n) and
    mean elongations (n,), all changed. ``measured``: lengths with the nominal elongation, tensions,
    the part of them that stretches the cables, and which cables are fresh. ``noise``: variances
    (18 + 2n,) a tick adds, a length's, the share of a tick in the mean elongations, and the
    variance that a tick adds to all compliances in common. ``limits``: tension (N) below which a
    cable is slack, and innovation (m) beyond which a length is left out. ``matrix`` comes in as of
    the last estimate.
    Writes the lengths' ``innovations`` (n,) m before any correction, not a number where there is
    none; the ``doubts`` (n,) m, sigmas of what elongation has changed by since its mean; and which
    cables were ``believed`` (n,). Returns the mean squared innovation in sigmas: about 1.
    """
    position, quaternion, rest, covariance, mean = state
    wanted, tensions, elastic, usable = measured
    mobility = _mobility(quaternion, body[0], body[1])
    acceleration = accelerations(matrix @ tensions, mobility, rest, body)
    position += period * (rest[:3] + 0.5 * period * acceleration[:3])
    quaternion[:] = rotate(quaternion, period * (rest[3:6] + 0.5 * period * acceleration[3:]))
    rest[:6] += period * acceleration
    excess = OFFSETS + lengths.shape[0]
    _predict(covariance, mobility, noise[0], noise[3], excess, period)
    geometry(position, quaternion, anchors[0], anchors[1], lengths, matrix)
    size = covariance.shape[0]
    error, seen = np.zeros(size), np.empty(size)
    total, count = 0.0, 0
    _judge(wanted, tensions, elastic, usable, rest, body[3], limits, lengths, innovations, believed)
    for i in range(lengths.shape[0]):
        doubts[i] = 0.0
        if not believed[i]:
            continue
        stretch = elongation(wanted[i], elastic[i], body[3][i])
        # The measured length is l(x) - offset - excess * stretch, so H = [-W', 0, 0, -1, -stretch];
        # in H a mean, for the cells' noise would pass for a motion that tells excess from offset.
        # Where it lags behind, the difference is one more uncertainty of the length.
        mean[i] += noise[2] * (stretch - mean[i])
        own = excess + i
        innovation = wanted[i] + rest[OFFSETS - TWIST + i] + rest[own - TWIST] * stretch
        innovation -= lengths[i]
        lag = max(0.0, covariance[own, own]) * (stretch - mean[i]) ** 2
        doubts[i] = math.sqrt(lag)
        variance = noise[1] + lag
        # Row after row, so that a compiler may take several columns at once.
        for j in range(size):
            seen[j] = -covariance[OFFSETS + i, j] - mean[i] * covariance[own, j]
        for row in range(6):
            along = matrix[row, i]
            for j in range(size):
                seen[j] -= along * covariance[row, j]
        for row in range(6):
            innovation += matrix[row, i] * error[row]
            variance -= matrix[row, i] * seen[row]
        innovation += error[OFFSETS + i] + mean[i] * error[own]
        variance -= seen[OFFSETS + i] + mean[i] * seen[own]
        seen /= math.sqrt(variance)
        innovation /= math.sqrt(variance)
        for j in range(size):
            error[j] += seen[j] * innovation
            for k in range(size):
                covariance[j, k] -= seen[j] * seen[k]
        total += innovation * innovation
        count += 1
    _absorb(position, quaternion, rest, error)
    return total / max(1, count)


@njit(cache=True)
def track(
    state: tuple[Array, Array, Array, Array, Array],
    seen: tuple[Array, Array],
    variances: tuple[float, float, float],
    then: tuple[Array, Array, NDArray[np.bool_]],
    anchors: tuple[Array, Array],
    axial_stiffness: Array,
    gate: float,
    innovation: Array,
    matrix: Array,
) -> float:
    """Correct with a tracker pose ``seen`` against what the cables said ``then``: lengths, elastic
    tensions, which to believe. How long ago that was costs neither time nor accuracy, for the pose
    of that instant cancels, and what is left of the comparison are the constants of calibration,

        l(seen) - measured = offset + excess * stretch + noise.

    ``variances``: of the tracker's position and rotation, and of a length. Writes the
    ``innovation`` (n,) m and the structure matrix at the pose seen; returns its chi-square, and
    corrects nothing when that is beyond ``gate`` or not a number.
    """
    position, quaternion, rest, covariance, mean = state
    cables, size = innovation.shape[0], covariance.shape[0]
    excess = OFFSETS + cables
    geometry(seen[0], seen[1], anchors[0], anchors[1], innovation, matrix)
    cross = np.zeros((size, cables))
    spread = np.zeros((cables, cables))
    for i in range(cables):
        stretch = elongation(then[0][i], then[1][i], axial_stiffness[i])
        softer = rest[excess - TWIST + i] * stretch
        innovation[i] -= then[0][i] + rest[OFFSETS - TWIST + i] + softer
        for j in range(size):
            cross[j, i] = covariance[j, OFFSETS + i] + mean[i] * covariance[j, excess + i]
    for i in range(cables):
        for j in range(cables):
            value = cross[OFFSETS + i, j] + mean[i] * cross[excess + i, j]
            for row in range(6):
                value += matrix[row, i] * matrix[row, j] * variances[0 if row < 3 else 1]
            spread[i, j] = value
        stretch = elongation(then[0][i], then[1][i], axial_stiffness[i])
        own = covariance[excess + i, excess + i]
        spread[i, i] += variances[2] + own * (stretch - mean[i]) ** 2
        if not then[2][i]:
            spread[i, i] += _UNKNOWN
    if not (np.isfinite(spread).all() and np.isfinite(innovation).all()):
        return math.nan
    weighted = np.linalg.solve(spread, innovation)
    chi_square = (innovation * weighted).sum()
    if chi_square <= gate:
        error = cross @ weighted
        covariance -= cross @ np.linalg.solve(spread, cross.T)
        _absorb(position, quaternion, rest, error)
    return float(chi_square)


@njit(cache=True)
def carry_forward(
    state: tuple[Array, Array, Array, Array, Array],
    body: tuple[float, Array, float, Array],
    period: float,
    wrench: Array,
    anchors: tuple[Array, Array],
    lengths: Array,
    matrix: Array,
    estimate: tuple[Array, Array, Array, Array],
) -> None:
    """The estimate one period on, under the cables' ``wrench``; geometry is left standing there."""
    position, quaternion, rest = state[0], state[1], state[2]
    there, oriented, velocity, turning = estimate
    mobility = _mobility(quaternion, body[0], body[1])
    acceleration = accelerations(wrench, mobility, rest, body)
    there[:] = position + period * (rest[:3] + 0.5 * period * acceleration[:3])
    oriented[:] = rotate(quaternion, period * (rest[3:6] + 0.5 * period * acceleration[3:]))
    velocity[:] = rest[:3] + period * acceleration[:3]
    turning[:] = rest[3:6] + period * acceleration[3:]
    geometry(there, oriented, anchors[0], anchors[1], lengths, matrix)


# The estimate as one array: position, quaternion, velocity, angular velocity, external wrench; and
# the nominal state in front of what is left of it: position and quaternion.
POSE, VELOCITY, TURNING, PUSH, PUBLISHED = 7, 7, 10, 13, 19
# The rows of what is kept of the cables, (4, n).
STRETCH, AXIAL_STIFFNESS, INNOVATION, DOUBT = range(4)


@njit(cache=True)
def estimate_tick(
    state: Array,
    covariance: Array,
    inertia: Array,
    anchors: Array,
    lengths: Array,
    matrix: Array,
    cables: Array,
    believed: NDArray[np.bool_],
    estimate: Array,
    past: Array,
    past_poses: Array,
    past_believed: NDArray[np.bool_],
    noise: Array,
    numbers: Array,
    measured: Array,
    tensions: Array,
    elastic: Array,
    usable: NDArray[np.bool_],
    count: int,
) -> float:
    """What a tick needs of the estimator: the filter; the ``estimate`` (`PUBLISHED`,) one period
    on; and the row of this tick, number ``count``, in what is kept of the ``past``, lengths and
    elastic tensions (2, depth, n), poses (depth, 7), and which lengths were believed (depth, n).

    ``state``: position, quaternion and rest in one; ``anchors`` (2, n, 3): of frame and platform;
    ``cables`` (4, n) has the rows above; ``numbers``: mass, gravity, period, then of the noise a
    length's variance, the share of a tick and the creep, then the limits. The others as in
    `filter_tick`, and what is returned."""
    position, quaternion, rest = state[:3], state[3:POSE], state[POSE:]
    period = numbers[2]
    body = (numbers[0], inertia, numbers[1], cables[AXIAL_STIFFNESS])
    frame, platform = anchors[0], anchors[1]
    nominal = (position, quaternion, rest, covariance, cables[STRETCH])
    squared = filter_tick(
        nominal,
        body,
        period,
        (noise, numbers[3], numbers[4], numbers[5]),
        (frame, platform),
        (measured, tensions, elastic, usable),
        (numbers[6], numbers[7]),
        lengths,
        matrix,
        cables[INNOVATION],
        cables[DOUBT],
        believed,
    )
    row = count % past_poses.shape[0]
    past[0, row], past[1, row] = measured, elastic
    past_poses[row] = state[:POSE]
    past_believed[row] = believed
    wrench = matrix @ tensions
    published = (
        estimate[:3],
        estimate[3:POSE],
        estimate[VELOCITY:TURNING],
        estimate[TURNING:PUSH],
    )
    carry_forward(nominal, body, period, wrench, (frame, platform), lengths, matrix, published)
    estimate[PUSH:] = rest[EXTERNAL - TWIST : OFFSETS - TWIST]
    return squared
