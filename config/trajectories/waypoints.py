"""Straight lines through waypoints with blended corners, as fast as the limits allow.

The path has a circular arc at each corner (Kunz and Stilman 2012). Along it the speed is the
largest that a forward and a backward pass, with the acceleration that curvature leaves over, admit,
which is the time-optimal one (Bobrow et al. 1985). The mean over a sliding window of that motion is
an S-curve: of velocities and accelerations it is a mean, so that their limits still hold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.trajectory import Samples, Waypoints
from tonus.config.trajectories.samples import TrajectoryError, packed

Array = NDArray[np.float64]
_STEPS = 200
"""of a piece, for the two passes"""
_FINE_S = 0.001
_EVERY = 5
"""fine samples from one row to the next"""
_STRAIGHT, _BACK = 1e-6, math.pi - 1e-3
"""rad, of a corner: below it none, above it a reversal, where the motion stops"""
_LONGEST_S = 300.0


@dataclass(frozen=True)
class _Piece:
    """A line, or an arc of radius ``radius`` that begins along ``along`` and bends to ``aside``."""

    start: Array
    along: Array
    length: float
    radius: float = math.inf
    aside: Array | None = None
    stop: bool = False
    """at rest at its end"""

    def __call__(self, way: Array) -> tuple[Array, Array]:
        """At ``way`` (n,): points (n, 6) and unit tangents (n, 6)."""
        if self.aside is None:
            return self.start + way[:, None] * self.along, np.tile(self.along, (len(way), 1))
        angle = way[:, None] / self.radius
        sine, cosine = np.sin(angle), np.cos(angle)
        points = self.start + self.radius * (sine * self.along + (1.0 - cosine) * self.aside)
        return points, cosine * self.along + sine * self.aside


def timed(reference: Waypoints) -> Samples:
    """Rows of the motion. Raises `TrajectoryError` where it is too long, or none at all."""
    scale = max(
        reference.speed / reference.angular_speed,
        reference.acceleration / reference.angular_acceleration,
    )
    pieces = _pieces(reference, scale)
    if not pieces:
        problem = "all waypoints are home"
        raise TrajectoryError("waypoints", problem, "give one that is not")
    # Each stretch by itself, so that a waypoint to stop at is reached and not only passed near by.
    ends = [0, *(number + 1 for number, piece in enumerate(pieces) if piece.stop)]
    stretches = []
    for first, end in pairwise(ends):
        moved = _motion(pieces[first:end], reference.speed, reference.acceleration)
        stretches.append(_smoothed(*moved, reference.smoothing))
    rows = _joined(stretches)
    for each in rows[1:]:
        each[:, 3:] /= scale
    times, pose, velocity, bend = rows
    return packed(times, pose, velocity, bend)


def _joined(stretches: list[tuple[Array, Array, Array, Array]]) -> tuple[Array, ...]:
    """One after the other; each begins where, and as, the one before it ends."""
    begins = np.cumsum([0.0, *(float(times[-1]) for times, *_ in stretches)])
    later = [
        (times + begin, *rest) for begin, (times, *rest) in zip(begins, stretches, strict=False)
    ]
    return tuple(
        np.concatenate([part[1:] if number else part for number, part in enumerate(parts)])
        for parts in zip(*later, strict=True)
    )


def _pieces(reference: Waypoints, scale: float) -> list[_Piece]:
    """Lines and arcs in the space of offset (m) and scaled rotation."""
    corners = [(np.zeros(6), True)]
    for each in reference.waypoints:
        point = np.array([*each.position, *(scale * value for value in each.rotation)])
        if np.linalg.norm(point - corners[-1][0]) > 1e-9:
            corners.append((point, each.stop))
        elif each.stop:
            corners[-1] = (point, True)
    points = [point for point, _ in corners]
    lines = [after - before for before, after in pairwise(points)]
    lengths = [float(np.linalg.norm(line)) for line in lines]
    ways = [line / length for line, length in zip(lines, lengths, strict=True)]
    pieces: list[_Piece] = []
    cut = 0.0
    for index, (way, length) in enumerate(zip(ways, lengths, strict=True)):
        start = points[index] + cut * way
        if index + 1 == len(ways):
            pieces.append(_Piece(start, way, length - cut, stop=True))
            break
        after = ways[index + 1]
        angle = math.acos(min(max(float(way @ after), -1.0), 1.0))
        if angle < _STRAIGHT and not corners[index + 1][1]:
            pieces.append(_Piece(start, way, length - cut))
            cut = 0.0
            continue
        if corners[index + 1][1] or angle > _BACK or reference.blend == 0.0:
            pieces.append(_Piece(start, way, length - cut, stop=True))
            cut = 0.0
            continue
        reach = min(length, lengths[index + 1]) / 2.0
        reach = min(reach, reference.blend / math.tan(angle / 4.0))
        pieces.append(_Piece(start, way, length - cut - reach))
        radius = reach / math.tan(angle / 2.0)
        aside = after - float(after @ way) * way
        aside /= np.linalg.norm(aside)
        begin = points[index + 1] - reach * way
        pieces.append(_Piece(begin, way, radius * angle, radius, aside))
        cut = reach
    return [piece for piece in pieces if piece.length > 0.0]


def _motion(pieces: list[_Piece], speed: float, acceleration: float) -> tuple[Array, Array]:
    """At every fine sample: point and velocity, (n, 6)."""
    squares, steps = _profile(pieces, speed, acceleration)
    speeds = np.sqrt(squares)
    spans = 2.0 * steps / (speeds[1:] + speeds[:-1])
    ends = np.concatenate([[0.0], np.cumsum(spans)])
    if ends[-1] > _LONGEST_S:
        problem = f"the way takes {ends[-1]:.0f} s, more than {_LONGEST_S:g} s"
        raise TrajectoryError("speed", problem, "raise speed or acceleration, or shorten the way")
    ways = np.concatenate([[0.0], np.cumsum(steps)])
    times = np.arange(math.ceil(ends[-1] / _FINE_S) + 1) * _FINE_S
    at = np.clip(np.searchsorted(ends, times, side="right") - 1, 0, len(spans) - 1)
    since = np.minimum(times - ends[at], spans[at])
    gain = (speeds[at + 1] - speeds[at]) / spans[at]
    way = ways[at] + speeds[at] * since + 0.5 * gain * since**2
    velocity = speeds[at] + gain * since
    over = times >= ends[-1]
    way[over], velocity[over] = ways[-1], 0.0
    position, rate = np.zeros((len(times), 6)), np.zeros((len(times), 6))
    begins = ways[::_STEPS]
    piece_of = np.minimum(at // _STEPS, len(pieces) - 1)
    for number, piece in enumerate(pieces):
        rows = piece_of == number
        position[rows], tangents = piece(way[rows] - begins[number])
        rate[rows] = velocity[rows, None] * tangents
    return position, rate


def _profile(pieces: list[_Piece], speed: float, acceleration: float) -> tuple[Array, Array]:
    """Squared speed (n + 1,) and length (n,) of each step."""
    steps = np.repeat([piece.length / _STEPS for piece in pieces], _STEPS)
    radii = np.repeat([piece.radius for piece in pieces], _STEPS)
    each = np.minimum(speed**2, acceleration * radii)
    most = np.full(len(steps) + 1, speed**2)
    most[:-1] = np.minimum(most[:-1], each)
    most[1:] = np.minimum(most[1:], each)
    most[0] = 0.0
    for number, piece in enumerate(pieces):
        if piece.stop:
            most[(number + 1) * _STEPS] = 0.0
    for order in (range(len(steps)), range(len(steps) - 1, -1, -1)):
        forward = order.step > 0
        for index in order:
            here, there = (index, index + 1) if forward else (index + 1, index)
            gained = _gained(most[here], steps[index], radii[index], acceleration)
            most[there] = min(most[there], gained)
    return most, steps


def _gained(square: float, step: float, radius: float, acceleration: float) -> float:
    """Largest squared speed after a ``step`` on an arc: what is tangential and what is centripetal
    together make the acceleration."""
    if math.isinf(radius):
        return square + 2.0 * acceleration * step
    most = acceleration * radius
    angle = math.asin(min(square / most, 1.0)) + 2.0 * step / radius
    return most * math.sin(min(angle, math.pi / 2.0))


def _smoothed(position: Array, rate: Array, window: float) -> tuple[Array, Array, Array, Array]:
    """The mean over the last ``window`` (s), every few fine samples; standing before and after."""
    width = max(round(window / _FINE_S), 1)
    tail = width + -(len(position) + width - 1) % _EVERY
    ends = np.tile(position[0], (width, 1)), np.tile(position[-1], (tail, 1))
    position = np.vstack([ends[0], position, ends[1]])
    still = np.zeros((width, 6)), np.zeros((tail, 6))
    rate = np.vstack([still[0], rate, still[1]])
    middle = 0.5 * (position[1:] + position[:-1])
    # The corrected trapezoidal rule: the integral's error is of the fourth order.
    middle -= _FINE_S / 12.0 * (rate[1:] - rate[:-1])
    total = np.vstack([np.zeros(6), np.cumsum(middle, axis=0)])
    later, before = slice(width, None, _EVERY), slice(None, -width, _EVERY)
    span = width * _FINE_S
    mean = (total[later] - total[before]) / width
    velocity = (position[later] - position[before]) / span
    bend = (rate[later] - rate[before]) / span
    times = np.arange(len(mean), dtype=np.float64) * (_EVERY * _FINE_S)
    return times, mean, np.asarray(velocity), np.asarray(bend)
