"""Stability margins of the inner tension loop: with the real delay, and without friction, which
would hide the lack of them.

One cable, its platform end fixed: drum, elastic cable, current loop and force cell as a continuous
model under a zero-order hold; the loop of `tonus.runtime.control.tension` with its two ticks from
sampling to effect; the loop is cut where the torque acts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from tonus.config.schema.axis import DriveTrain
from tonus.config.schema.control import TensionLoop

Array = NDArray[np.float64]
DELAY_TICKS = 2
"""A value sampled in tick k is read in k+1, and the torque computed from it acts in k+2."""


@dataclass(frozen=True)
class Margins:
    """Distance of a stable loop to instability; an unstable one has none: minus infinity."""

    gain_db: float
    """by which the gain may rise"""
    phase_deg: float
    crossover_hz: float
    """the highest"""
    reduction_db: float = float("inf")
    """by which the gain may fall: a loop may be stable only because of its gain"""

    @property
    def stable(self) -> bool:
        return self.gain_db > -np.inf

    @property
    def least_gain_db(self) -> float:
        """In either direction."""
        return min(self.gain_db, self.reduction_db)

    def meet(self, loop: TensionLoop) -> bool:
        """The floors of the configuration."""
        gain, phase = loop.gain_margin_db, loop.phase_margin_deg
        return self.stable and self.least_gain_db >= gain and self.phase_deg >= phase

    def reserve(self, loop: TensionLoop) -> float:
        """How far above the floors of the configuration, by the scarcer of the two: the margin over
        its floor; the least of several is the worst of them."""
        return min(self.least_gain_db / loop.gain_margin_db, self.phase_deg / loop.phase_margin_deg)


UNSTABLE = Margins(-np.inf, -np.inf, 0.0, -np.inf)


def tension_loop_margins(
    train: DriveTrain,
    loop: TensionLoop,
    period: float,
    *,
    cable_length: float,
    current_loop_hz: float,
    cell_bandwidth_hz: float,
    delay_ticks: int = DELAY_TICKS,
) -> Margins:
    """Margins of an axis with a cable of ``cable_length`` m; drive and cell have first-order
    bandwidths. The poles of the closed loop decide whether there are any."""
    plant = _plant(train, period, cable_length, current_loop_hz, cell_bandwidth_hz)
    if not stable(_closed_loop(plant, train, loop, period, delay_ticks)):
        return UNSTABLE
    frequency = frequencies(period)
    return margins_of(_open_loop(plant, train, loop, period, delay_ticks, frequency), frequency)


def stable(matrix: Array) -> bool:
    """Whether every pole of a sampled loop with this state matrix (n, n) is inside the circle."""
    finite = bool(np.isfinite(matrix).all())
    return finite and bool(np.abs(np.linalg.eigvals(matrix)).max() < 1.0)


def frequencies(period: float, count: int = 20_000) -> Array:
    """Hz (count,), up to half the sampling rate and with it."""
    return np.geomspace(0.05, 0.5 / period, count)


def margins_of(response: NDArray[np.complex128], frequency: Array) -> Margins:
    """Margins of a stable loop by its open loop's ``response`` over ``frequency`` (Hz). Every
    crossing counts, upward and downward."""
    size = np.abs(response)
    crossing = np.flatnonzero((size[:-1] >= 1.0) != (size[1:] >= 1.0))
    to_edge = np.degrees(np.pi - np.abs(np.angle(response[crossing])))
    real, imaginary = response.real, response.imag
    lagging = np.flatnonzero(
        ((imaginary[:-1] < 0.0) != (imaginary[1:] < 0.0)) & (real[:-1] < 0.0) & (real[1:] < 0.0)
    )
    reach = size[lagging]
    if real[-1] < 0.0:  # at half the sampling rate a response is real
        reach = np.append(reach, size[-1])
    decibels = -20.0 * np.log10(reach)
    rising, falling = decibels[decibels >= 0.0], -decibels[decibels < 0.0]
    return Margins(
        gain_db=float(rising.min()) if rising.size else float("inf"),
        phase_deg=float(to_edge.min()) if crossing.size else float("inf"),
        crossover_hz=float(frequency[crossing].max()) if crossing.size else 0.0,
        reduction_db=float(falling.min()) if falling.size else float("inf"),
    )


_Plant = tuple[Array, Array, Array]
"""Step (4, 4), effect (4,) of a torque, and the rows (2, 4) that see cell force and drum angle."""


def _plant(
    train: DriveTrain,
    period: float,
    cable_length: float,
    current_loop_hz: float,
    cell_bandwidth_hz: float,
) -> _Plant:
    drum, cable = train.drum, train.cable
    stiffness = cable.axial_stiffness / cable_length
    radius, inertia = drum.radius, drum.inertia
    drive, cell = 2.0 * np.pi * current_loop_hz, 2.0 * np.pi * cell_bandwidth_hz
    # State: drum angle, drum rate, torque, force as the cell sees it.
    system = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [
                -stiffness * radius**2 / inertia,
                -(drum.viscous_friction + cable.damping * radius**2) / inertia,
                1.0 / inertia,
                0.0,
            ],
            [0.0, 0.0, -drive, 0.0],
            [cell * stiffness * radius, cell * cable.damping * radius, 0.0, -cell],
        ]
    )
    torque = np.array([[0.0], [0.0], [drive], [0.0]])
    seen = np.array([[0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0]])
    step, effect, *_ = signal.cont2discrete((system, torque, seen, np.zeros((2, 1))), period)
    return step, effect[:, 0], seen


def _closed_loop(
    plant: _Plant, train: DriveTrain, loop: TensionLoop, period: float, delay_ticks: int
) -> Array:
    """State matrix: the plant; the last angle; the integral, if there is one; torques under way."""
    step, effect, (force, angle) = plant
    integrates = loop.integral > 0.0
    first = 5 + integrates
    size = first + delay_ticks
    matrix, asked = np.zeros((size, size)), np.zeros(size)
    matrix[:4, :4] = step
    matrix[4, :4] = angle
    asked[:4] = -train.drum.radius * (loop.proportional + loop.integral * period) * force
    asked[:4] -= loop.rate_damping / period * angle
    asked[4] = loop.rate_damping / period
    if integrates:
        matrix[5, :4], matrix[5, 5] = loop.integral * period * force, 1.0
        asked[5] = -train.drum.radius
    if delay_ticks:
        matrix[:4, -1] = effect
        matrix[first] = asked
        matrix[first + 1 :, first:-1] = np.eye(delay_ticks - 1)
    else:
        matrix[:4] += np.outer(effect, asked)
    return matrix


def _open_loop(
    plant: _Plant,
    train: DriveTrain,
    loop: TensionLoop,
    period: float,
    delay_ticks: int,
    frequency: Array,
) -> NDArray[np.complex128]:
    step, effect, seen = plant
    z = np.exp(2j * np.pi * frequency * period)
    answer = seen @ np.linalg.solve(z[:, None, None] * np.eye(4) - step, effect[:, None])
    integral = loop.integral * period * z / (z - 1.0)
    on_force = train.drum.radius * (loop.proportional + integral)
    on_angle = loop.rate_damping * (1.0 - 1.0 / z) / period
    returned = on_force * answer[:, 0, 0] + on_angle * answer[:, 1, 0]
    return np.asarray(returned * z ** (-delay_ticks))
