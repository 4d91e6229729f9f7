"""Stability margins of the inner tension loop: with the real delay, and without friction, which
would hide the lack of them.

One cable, its platform end fixed: drum, elastic cable, current loop and force cell as a continuous
model under a zero-order hold; the loop of `runtime.tension` with its two ticks from sampling to
effect; the loop is cut where the torque acts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from config.schema.control import TensionLoop
from config.schema.robot import Robot

Array = NDArray[np.float64]
DELAY_TICKS = 2
"""A value sampled in tick k is read in k+1, and the torque computed from it acts in k+2."""


@dataclass(frozen=True)
class Margins:
    """Distance to instability at the plant input."""

    gain_db: float
    phase_deg: float
    crossover_hz: float


def tension_loop_margins(
    robot: Robot,
    loop: TensionLoop,
    period: float,
    *,
    cable_length: float,
    current_loop_hz: float,
    cell_bandwidth_hz: float,
    delay_ticks: int = DELAY_TICKS,
) -> Margins:
    """Margins for a cable of ``cable_length`` m; drive and cell have first-order bandwidths."""
    frequency = np.geomspace(0.05, 0.5 / period, 20_000)
    response = _open_loop(
        robot,
        loop,
        period,
        cable_length,
        current_loop_hz,
        cell_bandwidth_hz,
        delay_ticks,
        frequency,
    )
    return margins_of(response, frequency)


def margins_of(response: NDArray[np.complex128], frequency: Array) -> Margins:
    """Margins of an open loop's response over ``frequency`` (Hz)."""
    size, phase = np.abs(response), np.unwrap(np.angle(response))
    crossing = np.flatnonzero((size[:-1] >= 1.0) & (size[1:] < 1.0))
    lagging = np.flatnonzero(np.diff(np.floor((phase - np.pi) / (2.0 * np.pi))) != 0)
    to_edge = np.degrees(np.abs((phase[crossing] + np.pi) % (2.0 * np.pi)))
    to_edge = np.minimum(to_edge, 360.0 - to_edge)
    gains = -20.0 * np.log10(size[lagging]) if lagging.size else np.array([np.inf])
    return Margins(
        gain_db=float(gains[np.abs(gains).argmin()]),
        phase_deg=float(to_edge.min()) if crossing.size else float("inf"),
        crossover_hz=float(frequency[crossing].max()) if crossing.size else 0.0,
    )


def _open_loop(
    robot: Robot,
    loop: TensionLoop,
    period: float,
    cable_length: float,
    current_loop_hz: float,
    cell_bandwidth_hz: float,
    delay_ticks: int,
    frequency: Array,
) -> NDArray[np.complex128]:
    drum, cable = robot.drum, robot.cable
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
    z = np.exp(2j * np.pi * frequency * period)
    plant = seen @ np.linalg.solve(z[:, None, None] * np.eye(4) - step, effect)
    integral = loop.integral * period * z / (z - 1.0)
    on_force = radius * (loop.proportional + integral)
    on_angle = loop.rate_damping * (1.0 - 1.0 / z) / period
    return np.asarray((on_force * plant[:, 0, 0] + on_angle * plant[:, 1, 0]) * z ** (-delay_ticks))
