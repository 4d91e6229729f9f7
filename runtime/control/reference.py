"""Where the platform should be: position, velocity, acceleration over the scenario's own time."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.base import Vector3
from tonus.config.schema.scenario import Hold, Multisine, Path, Press, Reference, Sine
from tonus.config.schema.trajectory import Circle, Lissajous, Prepared, Samples, Turn
from tonus.config.trajectories.samples import unpacked

Array = NDArray[np.float64]
Sample = tuple[Array, Array, Array]
Evaluator = Callable[[float], Sample]
Wave = tuple[Array, float, float]
"""vector of the amplitude (3,), angular frequency (rad/s), phase (rad)"""
_NOTHING = np.zeros(3)


class Trajectory(ABC):
    """What a scenario asks for at its time ``t`` (s)."""

    @abstractmethod
    def __call__(self, t: float) -> Sample:
        """Offset from home, its velocity and its acceleration, each (3,)."""

    def push(self, t: float) -> Array:  # noqa: ARG002
        """Force (3,) at the contact port, N."""
        return _NOTHING

    turns = False
    """whether it commands an orientation other than level"""

    def rotation(self, t: float) -> Sample:  # noqa: ARG002
        """Rotation vector from level (rad, base frame) and its first and second derivative."""
        return _NOTHING, _NOTHING, _NOTHING


def minimum_jerk(s: float) -> tuple[float, float, float]:
    """Shape from 0 to 1 over s in 0..1, with its first and second derivative (Flash and Hogan
    1985)."""
    if s <= 0.0:
        return 0.0, 0.0, 0.0
    if s >= 1.0:
        return 1.0, 0.0, 0.0
    return (
        s**3 * (10.0 - 15.0 * s + 6.0 * s * s),
        30.0 * s * s * (1.0 - s) ** 2,
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
    )


@njit(cache=True)
def _between(start: Array, end: Array, shape: float, rate: float, bend: float) -> Sample:
    """``shape`` of the way (3,) and its derivatives."""
    way = end - start
    return start + way * shape, way * rate, way * bend


@njit(cache=True)
def _scale(way: Array, shape: float, rate: float, bend: float, sample: Array) -> None:
    for k in range(3):
        sample[0, k] = way[k] * shape
        sample[1, k] = way[k] * rate
        sample[2, k] = way[k] * bend


def _scaled(way: Array, shape: float, rate: float, bend: float) -> Sample:
    """So many times the ``way`` (3,), and its derivatives."""
    sample = np.empty((3, 3))
    _scale(way, shape, rate, bend, sample)
    return sample[0], sample[1], sample[2]


@dataclass(frozen=True)
class Move:
    """A minimum-jerk motion between two points, standing before and after it."""

    start: Array
    end: Array
    duration: float

    def __call__(self, t: float) -> Sample:
        shape, rate, bend = minimum_jerk(t / self.duration)
        sample: Sample = _between(
            self.start, self.end, shape, rate / self.duration, bend / self.duration**2
        )
        return sample


class _Hold(Trajectory):
    def __call__(self, t: float) -> Sample:  # noqa: ARG002
        return _NOTHING, _NOTHING, _NOTHING


class _Sine(Trajectory):
    """A sine whose amplitude fades in by a minimum-jerk shape."""

    def __init__(self, reference: Sine) -> None:
        direction = np.array(reference.direction)
        self._way = direction / np.linalg.norm(direction) * reference.amplitude
        self._omega = 2.0 * math.pi * reference.frequency
        self._fade = reference.fade

    def __call__(self, t: float) -> Sample:
        a, da, dda = 1.0, 0.0, 0.0
        if self._fade > 0.0 and t < self._fade:
            a, da, dda = minimum_jerk(t / self._fade)
            da, dda = da / self._fade, dda / self._fade**2
        w = self._omega
        s, c = math.sin(w * t), math.cos(w * t)
        return _scaled(
            self._way,
            a * s,
            da * s + a * w * c,
            dda * s + 2.0 * da * w * c - a * w * w * s,
        )


class _Multisine(Trajectory):
    """The sum of its sines."""

    def __init__(self, reference: Multisine) -> None:
        self._sines = [
            _Sine(Sine(kind="sine", fade=reference.fade, **component.model_dump()))
            for component in reference.components
        ]

    def __call__(self, t: float) -> Sample:
        position, velocity, acceleration = np.sum([sine(t) for sine in self._sines], axis=0)
        return position, velocity, acceleration


class _Path(Trajectory):
    """Minimum-jerk moves from point to point, with pauses; starts at home."""

    def __init__(self, reference: Path) -> None:
        self._moves: list[tuple[float, Move]] = []
        begin, point = 0.0, np.zeros(3)
        for waypoint in reference.waypoints:
            target = np.array(waypoint.position)
            self._moves.append((begin, Move(point, target, waypoint.duration)))
            begin += waypoint.duration + waypoint.pause
            point = target

    def __call__(self, t: float) -> Sample:
        begin, move = self._moves[0]
        for later_begin, later in self._moves[1:]:
            if t < later_begin:
                break
            begin, move = later_begin, later
        return move(t - begin)


class _Press(Trajectory):
    """Up to the surface, then as deep as the force would go into a body of the given stiffness."""

    def __init__(self, reference: Press) -> None:
        self._r = reference
        direction = np.array(reference.direction)
        self._way = direction / np.linalg.norm(direction)
        self._move = Move(np.zeros(3), self._way * reference.distance, reference.approach)
        self._omega = 2.0 * math.pi * reference.frequency

    def _force(self, t: float) -> tuple[float, float, float]:
        """N and its two derivatives."""
        r, w = self._r, self._omega
        a, da, dda = minimum_jerk(t / r.fade)
        da, dda = da / r.fade, dda / r.fade**2
        s, c = r.force + r.swing * math.sin(w * t), r.swing * w * math.cos(w * t)
        bend = -r.swing * w * w * math.sin(w * t)
        return a * s, da * s + a * c, dda * s + 2.0 * da * c + a * bend

    def __call__(self, t: float) -> Sample:
        position, velocity, acceleration = self._move(t)
        deep, rate, bend = (f / self._r.stiffness for f in self._force(t - self._r.approach))
        return (
            position + deep * self._way,
            velocity + rate * self._way,
            acceleration + bend * self._way,
        )

    def push(self, t: float) -> Array:
        return np.asarray(self._force(t - self._r.approach)[0] * self._way)


class _Waves(Trajectory):
    """Sines with phases, of offset and of rotation, that fade in by a minimum-jerk shape."""

    def __init__(self, waves: Sequence[Wave], turns: Sequence[Wave], fade: float) -> None:
        self._waves, self._turns, self._fade = tuple(waves), tuple(turns), fade
        self.turns = bool(turns)

    def _sum(self, waves: tuple[Wave, ...], t: float) -> Sample:
        a, da, dda = minimum_jerk(t / self._fade)
        da, dda = da / self._fade, dda / self._fade**2
        position, velocity, acceleration = np.zeros(3), np.zeros(3), np.zeros(3)
        for vector, w, phase in waves:
            s, c = math.sin(w * t + phase), math.cos(w * t + phase)
            position += vector * (a * s)
            velocity += vector * (da * s + a * w * c)
            acceleration += vector * (dda * s + 2.0 * da * w * c - a * w * w * s)
        return position, velocity, acceleration

    def __call__(self, t: float) -> Sample:
        return self._sum(self._waves, t)

    def rotation(self, t: float) -> Sample:
        return self._sum(self._turns, t)


def _wave(way: Vector3, amplitude: float, frequency: float, phase_deg: float) -> Wave:
    direction = np.array(way)
    vector = direction / np.linalg.norm(direction) * amplitude
    return vector, 2.0 * math.pi * frequency, math.radians(phase_deg)


def _turns(turns: tuple[Turn, ...]) -> list[Wave]:
    return [_wave(each.axis, each.amplitude, each.frequency, each.phase_deg) for each in turns]


def _circle(reference: Circle) -> _Waves:
    """From the axis that is most in the plane, counter-clockwise about the normal."""
    normal = np.array(reference.normal) / np.linalg.norm(reference.normal)
    first = np.eye(3)[int(np.abs(normal).argmin())]
    first = first - float(first @ normal) * normal
    first /= np.linalg.norm(first)
    omega, radius = 2.0 * math.pi * reference.frequency, reference.radius
    waves = [
        (radius * first, omega, 0.5 * math.pi),
        (radius * np.cross(normal, first), omega, 0.0),
    ]
    return _Waves(waves, _turns(reference.turns), reference.fade)


def _lissajous(reference: Lissajous) -> _Waves:
    waves = [
        _wave(each.direction, each.amplitude, each.frequency, each.phase_deg)
        for each in reference.components
    ]
    return _Waves(waves, _turns(reference.turns), reference.fade)


class _Sampled(Trajectory):
    """Quintic polynomials through prepared samples; standing before and after them."""

    def __init__(self, samples: Samples) -> None:
        # Functions are constants to a keyframe: it need not copy the rows.
        self._offset, self._turn, self.turns = _polynomials(unpacked(samples))

    def __call__(self, t: float) -> Sample:
        return self._offset(t)

    def rotation(self, t: float) -> Sample:
        return self._turn(t)


def _polynomials(rows: Array) -> tuple[Evaluator, Evaluator, bool]:
    """Of offset and of rotation, and whether there is any. ``rows`` as `Samples` describes them.
    Sums and products of single numbers only, so that every machine gets the same bits."""
    kept = np.flatnonzero(np.diff(rows[:, 0]) > 0.0)
    times, spans = rows[kept, 0].tolist(), np.diff(rows[:, 0])[kept, None]
    last = float(rows[-1, 0])

    def evaluator(first: int) -> Evaluator:
        p, v, a = (rows[:, first + 3 * k : first + 3 * k + 3] for k in range(3))
        p0, v0, a0 = p[kept], v[kept] * spans, a[kept] * spans**2
        p1, v1, a1 = p[kept + 1], v[kept + 1] * spans, a[kept + 1] * spans**2
        way = p1 - p0
        c3 = 10.0 * way - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1
        c4 = -15.0 * way + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1
        c5 = 6.0 * way - 3.0 * v0 - 3.0 * v1 - 0.5 * a0 + 0.5 * a1
        coefficients = np.stack([p0, v0, 0.5 * a0, c3, c4, c5], axis=1)

        def at(t: float) -> Sample:
            if t >= last:
                return p[-1], _NOTHING, _NOTHING
            index = max(bisect_right(times, t) - 1, 0)
            span = float(spans[index, 0])
            s = max((t - times[index]) / span, 0.0)
            b0, b1, b2, b3, b4, b5 = coefficients[index]
            return (
                b0 + s * (b1 + s * (b2 + s * (b3 + s * (b4 + s * b5)))),
                (b1 + s * (2.0 * b2 + s * (3.0 * b3 + s * (4.0 * b4 + s * 5.0 * b5)))) / span,
                (2.0 * b2 + s * (6.0 * b3 + s * (12.0 * b4 + s * 20.0 * b5))) / span**2,
            )

        return at

    return evaluator(1), evaluator(10), bool(rows[:, 10:].any())


def trajectory(reference: Reference) -> Trajectory:
    """The motion a scenario asks for. Raises `ValueError` for one that was not prepared."""
    if isinstance(reference, Prepared):
        if reference.prepared is None:
            raise ValueError(f"a reference of kind {reference.kind} is prepared by load_scenario")
        return _Sampled(reference.prepared)
    if isinstance(reference, Circle):
        return _circle(reference)
    if isinstance(reference, Lissajous):
        return _lissajous(reference)
    if isinstance(reference, Hold):
        return _Hold()
    if isinstance(reference, Sine):
        return _Sine(reference)
    if isinstance(reference, Press):
        return _Press(reference)
    if isinstance(reference, Multisine):
        return _Multisine(reference)
    return _Path(reference)
