"""Where the platform should be: position, velocity, acceleration over the scenario's own time."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.scenario import Hold, Multisine, Path, Press, Reference, Sine

Array = NDArray[np.float64]
Sample = tuple[Array, Array, Array]
_NOTHING = np.zeros(3)


class Trajectory(ABC):
    """What a scenario asks for at its time ``t`` (s)."""

    @abstractmethod
    def __call__(self, t: float) -> Sample:
        """Offset from home, its velocity and its acceleration, each (3,)."""

    def push(self, t: float) -> Array:  # noqa: ARG002
        """Force (3,) at the contact port, N."""
        return _NOTHING


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
        return (
            self._way * (a * s),
            self._way * (da * s + a * w * c),
            self._way * (dda * s + 2.0 * da * w * c - a * w * w * s),
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


def trajectory(reference: Reference) -> Trajectory:
    """The motion a scenario asks for."""
    if isinstance(reference, Hold):
        return _Hold()
    if isinstance(reference, Sine):
        return _Sine(reference)
    if isinstance(reference, Press):
        return _Press(reference)
    if isinstance(reference, Multisine):
        return _Multisine(reference)
    return _Path(reference)
