"""Where the platform should be: position, velocity, acceleration over the scenario's own time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from config.schema.scenario import Hold, Multisine, Path, Reference, Sine

Array = NDArray[np.float64]
Sample = tuple[Array, Array, Array]


class Trajectory(Protocol):
    """Offset from home, its velocity and its acceleration at time ``t`` (s), each (3,)."""

    def __call__(self, t: float) -> Sample: ...


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


@dataclass(frozen=True)
class Move:
    """A minimum-jerk motion between two points, standing before and after it."""

    start: Array
    end: Array
    duration: float

    def __call__(self, t: float) -> Sample:
        shape, rate, bend = minimum_jerk(t / self.duration)
        way = self.end - self.start
        return (
            self.start + way * shape,
            way * (rate / self.duration),
            way * (bend / self.duration**2),
        )


class _Hold:
    def __init__(self) -> None:
        self._zero = np.zeros(3)

    def __call__(self, t: float) -> Sample:  # noqa: ARG002
        return self._zero, self._zero, self._zero


class _Sine:
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


class _Multisine:
    """The sum of its sines."""

    def __init__(self, reference: Multisine) -> None:
        self._sines = [
            _Sine(Sine(kind="sine", fade=reference.fade, **component.model_dump()))
            for component in reference.components
        ]

    def __call__(self, t: float) -> Sample:
        position, velocity, acceleration = np.sum([sine(t) for sine in self._sines], axis=0)
        return position, velocity, acceleration


class _Path:
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


def trajectory(reference: Reference) -> Trajectory:
    """The motion a scenario asks for."""
    if isinstance(reference, Hold):
        return _Hold()
    if isinstance(reference, Sine):
        return _Sine(reference)
    if isinstance(reference, Multisine):
        return _Multisine(reference)
    return _Path(reference)
