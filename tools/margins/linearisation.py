"""A controller's feedback for small motion, from its own output: what the margins of a controller
that is not ours are computed with.

The controller is a sampled system from the platform's place and speed along an axis to the force it
asks for. Its response to an impulse of either is measured round the resting pose, at a held
stiffness, as half the difference of a positive and a negative one, and realised as a state space
(Ho and Kalman 1966; Kung 1978): filters, integrals and delays inside the controller count. A later
part of the response, which the realisation has not seen, has to come out of it, or there is none.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.runtime.control.controllers.linear import NoLinearLawError
from tonus.tools.margins.probe import Probe

Array = NDArray[np.float64]

STATES = 100
"""the largest order, in ticks; half of the response that is realised"""
_UNSEEN = 200
"""ticks of the response that are compared only"""
_WARM_TICKS = 20
_SMALL = 1e-5
"""m, and m/s: far above rounding, far below what any bound or threshold is about"""
_NEGLIGIBLE = 1e-6
"""singular value over the largest: what is smaller is rounding"""
_ALIKE = 1e-3
"""share of a response by which two that should be equal may differ"""
_COUPLED = 0.05
"""share of its own axis' response that another axis may show; the margins are per axis"""


@dataclass(frozen=True)
class LinearResponse:
    """x+ = A x + B u, force = C x + D u, with u the platform's place (m) and speed (m/s) along an
    axis and the force in N along it."""

    axis: int
    stiffness: float
    """N/m that was held"""
    matrix: Array
    """A (n, n)"""
    entry: Array
    """B (n, 2)"""
    out: Array
    """C (n,)"""
    direct: Array
    """D (2,)"""

    @property
    def order(self) -> int:
        return len(self.out)

    def step(self, state: Array, place: float, speed: float) -> tuple[float, Array]:
        """Force (N), and the next state (n,)."""
        given = np.array([place, speed])
        force = float(self.out @ state + self.direct @ given)
        return force, self.matrix @ state + self.entry @ given


def commands_tensions(config: Config, name: str) -> bool:
    """Whether a controller asks for tensions at rest. Raises `ControllerError`."""
    probe = Probe(name, config.robot, config.control)
    probe.begin()
    probe.tick(probe.motion())
    return probe.commands_tensions


def linear_responses(config: Config, name: str) -> Iterator[LinearResponse]:
    """Along three axes, at the least stiffness, at the one asked for at rest, and at the largest:
    the limiter may let through any of them. Raises `ControllerError` for a controller that fails,
    `NoLinearLawError` for one that cannot be linearised."""
    law = config.control.stiffness
    _examine_drums(config, name)
    for stiffness in (law.minimum, None, law.maximum):
        for axis in range(3):
            yield _response(config, name, axis, stiffness)


def _examine_drums(config: Config, name: str) -> None:
    """A force that answers to the drums is another loop than the one computed here."""
    for signal in ("wound", "winding"):
        forces = []
        for size in (0.0, _SMALL):
            probe = Probe(name, config.robot, config.control)
            probe.begin()
            still = getattr(probe.motion(), signal)
            forces += [probe.tick(probe.motion(**{signal: still + size}))[:3]]
        if np.abs(forces[1] - forces[0]).max() > _SMALL:
            raise NoLinearLawError(
                f"{name} answers to cable lengths or rates with a wrench; it may command tensions"
            )


def _response(config: Config, name: str, axis: int, stiffness: float | None) -> LinearResponse:
    held = _asked(config, name) if stiffness is None else stiffness
    measured = np.empty((2 * STATES + _UNSEEN, 2))
    for column in range(2):
        up, down = (_impulse(config, name, axis, held, column, sign) for sign in (1.0, -1.0))
        both = (up - down) / (2.0 * _SMALL)
        own, others = np.abs(both[:, axis]).max(), np.abs(np.delete(both, axis, axis=1)).max()
        if others > _COUPLED * max(own, np.finfo(float).tiny):
            raise NoLinearLawError(
                f"{name} answers to motion along {'xyz'[axis]} with a force along another axis, "
                "and margins are computed per axis"
            )
        measured[:, column] = both[:, axis]
    found = _realised(axis, held, measured[: 2 * STATES])
    again = _impulses(found, len(measured))
    if np.abs(again - measured).max() > _ALIKE * max(float(np.abs(measured).max()), 1.0):
        raise NoLinearLawError(
            f"{name} does not answer as a linear system of at most {STATES} states does, at "
            f"{held:g} N/m along {'xyz'[axis]}"
        )
    return found


def _asked(config: Config, name: str) -> float:
    """N/m at rest, within bounds."""
    probe, law = Probe(name, config.robot, config.control), config.control.stiffness
    probe.begin()
    return min(max(probe.stiffness(probe.motion()), law.minimum), law.maximum)


def _impulse(
    config: Config, name: str, axis: int, stiffness: float, column: int, sign: float
) -> Array:
    """Force (ticks, 3) on one tick of displacement (``column`` 0) or of speed (1)."""
    probe = Probe(name, config.robot, config.control)
    probe.begin()
    for _ in range(_WARM_TICKS):
        probe.tick(probe.motion(), stiffness)
    small = np.zeros((2, 3))
    small[column, axis] = sign * _SMALL
    forces = np.empty((2 * STATES + _UNSEEN, 3))
    forces[0] = probe.tick(probe.displaced(*small), stiffness)[:3]
    for tick in range(1, len(forces)):
        forces[tick] = probe.tick(probe.motion(), stiffness)[:3]
    return forces


def _realised(axis: int, stiffness: float, impulses: Array) -> LinearResponse:
    """State space of the impulse responses (2 m, 2)."""
    half = len(impulses) // 2
    rows = np.arange(half)[:, None] + np.arange(half - 1)[None, :]
    first = impulses[rows + 1].reshape(half, -1)[:-1]
    later = impulses[rows + 1].reshape(half, -1)[1:]
    left, size, right = np.linalg.svd(first, full_matrices=False)
    floor = _NEGLIGIBLE * max(float(np.abs(impulses).max()), float(size[0]))
    count = int((size > floor).sum())
    root = np.sqrt(size[:count])
    left, right = left[:, :count] * root, root[:, None] * right[:count]
    inverse = 1.0 / size[:count]
    matrix = inverse[:, None] * (left.T @ later @ right.T) * inverse
    return LinearResponse(axis, stiffness, matrix, right[:, :2], left[0], impulses[0])


def _impulses(found: LinearResponse, ticks: int) -> Array:
    """Its own responses (ticks, 2)."""
    responses = np.empty((ticks, 2))
    for column in range(2):
        state = np.zeros(found.order)
        for tick in range(ticks):
            place, speed = float(tick == 0 and column == 0), float(tick == 0 and column == 1)
            responses[tick, column], state = found.step(state, place, speed)
    return responses
