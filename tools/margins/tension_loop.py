"""Stability margins of the inner tension loop: with the real delay, and without friction, which
would hide the lack of them.

One cable, its platform end fixed: drum, elastic cable, current loop and force cell as a continuous
model under a zero-order hold; the loop of `tonus.runtime.control.tension` with its two ticks from
sampling to effect; the loop is cut where the torque acts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.axis import DriveTrain
from tonus.config.schema.control import TensionLoop
from tonus.config.schema.root import Config
from tonus.runtime.control.tension import of_axis
from tonus.tools.margins.hold import zero_order_hold
from tonus.tools.margins.response import frequency_response

Array = NDArray[np.float64]
DELAY_TICKS = 2
"""A value sampled in tick k is read in k+1, and the torque computed from it acts in k+2."""
FREQUENCIES = 20_000
"""points of an open loop's response"""


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
    points: int = FREQUENCIES,
) -> Margins:
    """Margins of an axis with a cable of ``cable_length`` m; drive and cell have first-order
    bandwidths. The poles of the closed loop decide whether there are any."""
    plant = _plant(train, period, cable_length, current_loop_hz, cell_bandwidth_hz)
    if not stable(_closed_loop(plant, train, loop, period, delay_ticks)):
        return UNSTABLE
    frequency = frequencies(period, points)
    return margins_of(_open_loop(plant, train, loop, period, delay_ticks, frequency), frequency)


def robot_margins(
    config: Config, loop: TensionLoop, lengths: Sequence[float], points: int = FREQUENCIES
) -> dict[tuple[int, ...], list[Margins]]:
    """Margins of a ``loop`` on the robot: for the axes of each kind, over cable ``lengths`` (m)."""
    robot, response = config.robot, config.response
    return {
        axes: [
            tension_loop_margins(
                train,
                of_axis(loop, train, robot),
                config.control.rates.period,
                cable_length=length,
                current_loop_hz=response.current_loop_hz,
                cell_bandwidth_hz=response.force_cell_hz,
                points=points,
            )
            for length in lengths
        ]
        for train, axes in robot.kinds_of_axes.items()
    }


def tension_errors(
    train: DriveTrain,
    loop: TensionLoop,
    period: float,
    *,
    cable_length: float,
    current_loop_hz: float,
    cell_bandwidth_hz: float,
    ticks: int,
) -> Array:
    """Error (ticks, 2) of the tension in N, frictionless but for what is said: after the torque of
    1 N at the cable has appeared as friction at the drum, and after the reference has risen by 1 N.
    The bounds on the integral and on the slope of the reference are not reached."""
    step, effects, (force, angle, tension) = _plant(
        train, period, cable_length, current_loop_hz, cell_bandwidth_hz
    )
    radius = train.drum.radius
    follow = 1.0 - np.exp(-2.0 * np.pi * loop.lead_cutoff_hz * period)
    turn = loop.lead * cable_length / (train.cable.axial_stiffness * radius * period)

    def tick(state: Array) -> Array:
        """Of the plant (4), last angle, integral, last reference, its slope, torques under way,
        friction in N, reference."""
        plant, (before, integral, last, slope), queue = state[:4], state[4:8], state[8:-2]
        friction, reference = state[-2:]
        error = reference - force @ plant
        integral = integral + loop.integral * period * error
        slope = slope + follow * (reference - last - slope)
        asked = radius * (loop.feed_forward * reference + loop.proportional * error + integral)
        asked += loop.rate_damping * (turn * slope - (angle @ plant - before) / period)
        plant = step @ plant + effects @ np.array([queue[-1], -radius * friction])
        kept = (angle @ state[:4], integral, reference, slope)
        return np.array([*plant, *kept, asked, *queue[:-1], friction, reference])

    size = 4 + 4 + DELAY_TICKS + 2
    power = np.array([tick(unit) for unit in np.eye(size)]).T
    # Row k: the error after k ticks on the state at the start; doubled until there are enough.
    rows = np.zeros((1, size))
    rows[0, :4], rows[0, -1] = -tension, 1.0
    while len(rows) < ticks:
        rows, power = np.vstack([rows, rows @ power]), power @ power
    return rows[:ticks, -2:]


def stable(matrix: Array) -> bool:
    """Whether every pole of a sampled loop with this state matrix (n, n) is inside the circle."""
    finite = bool(np.isfinite(matrix).all())
    return finite and bool(np.abs(np.linalg.eigvals(matrix)).max() < 1.0)


def frequencies(period: float, count: int = FREQUENCIES) -> Array:
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
"""Step (4, 4), effects (4, 2) of a torque command and of a torque at the drum, and the rows (3, 4)
of cell force, drum angle and true tension."""


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
    torques = np.array([[0.0, 0.0], [0.0, 1.0 / inertia], [drive, 0.0], [0.0, 0.0]])
    seen = np.array(
        [
            [0.0, 0.0, 0.0, 1.0],
            [1.0, 0.0, 0.0, 0.0],
            [stiffness * radius, cable.damping * radius, 0.0, 0.0],
        ]
    )
    return *zero_order_hold(system, torques, period), seen


def _closed_loop(
    plant: _Plant, train: DriveTrain, loop: TensionLoop, period: float, delay_ticks: int
) -> Array:
    """State matrix: the plant; the last angle; the integral, if there is one; torques under way."""
    step, effects, (force, angle, _) = plant
    effect = effects[:, 0]
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
    step, effects, seen = plant
    z = np.exp(2j * np.pi * frequency * period)
    force, angle = frequency_response(step, effects[:, 0], seen[:2], z)
    integral = loop.integral * period * z / (z - 1.0)
    on_force = train.drum.radius * (loop.proportional + integral)
    on_angle = loop.rate_damping * (1.0 - 1.0 / z) / period
    returned = on_force * force + on_angle * angle
    return np.asarray(returned * z ** (-delay_ticks))
