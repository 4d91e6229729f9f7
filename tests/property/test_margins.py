"""The verdict on a tension loop's stability against a simulation that shares nothing with it."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from tonus.config import load
from tonus.tools.margins.tension_loop import tension_loop_margins

CONFIG, _ = load("config/can.yaml")
ROBOT = CONFIG.robot
TICKS = 1200
LEAST = 2e-3
"""growth a tick (natural logarithm) that a simulation of so many ticks tells for sure"""


def growth(
    gains: tuple[float, float, float], period: float, length: float, bands: tuple[float, float]
) -> float:
    """Of the state over the second half of a simulation, a tick: drum, cable, current loop, cell;
    force and angle sampled, torque two ticks later."""
    proportional, integral_gain, damping = gains
    k, c, r = ROBOT.cable.axial_stiffness / length, ROBOT.cable.damping, ROBOT.drum.radius
    inertia, friction = ROBOT.drum.inertia, ROBOT.drum.viscous_friction
    drive, cell = (2.0 * np.pi * band for band in bands)
    flow = np.zeros((5, 5))  # rate, angle, torque, force seen; the torque asked, held over a tick
    flow[0, :3] = [-(friction + c * r * r) / inertia, -k * r * r / inertia, 1.0 / inertia]
    flow[1, 0] = 1.0
    flow[2, 2], flow[2, 4] = -drive, drive
    flow[3, :4] = [cell * c * r, cell * k * r, 0.0, -cell]
    tick = expm(flow * period)[:4]
    state = np.array([0.0, 0.0, 0.01, 0.0])
    integral, last, waiting, total, middle = 0.0, 0.0, [0.0, 0.0], 0.0, 0.0
    for number in range(TICKS):
        force, angle = float(state[3]), float(state[1])
        integral += integral_gain * period * force
        asked = -r * (proportional * force + integral) - damping * (angle - last) / period
        state = tick @ np.append(state, waiting.pop(0))
        waiting.append(asked)
        last = angle
        scale = float(np.abs(state / [10.0, 1.0, 1.0, 100.0]).max()) + abs(integral) * 1e-3 + 1e-300
        if scale > 1e50 or scale < 1e-50:  # the loop is linear: shrink it, and remember
            state, integral, last = state / scale, integral / scale, last / scale
            waiting = [value / scale for value in waiting]
            total, scale = total + np.log(scale), 1.0
        if number == TICKS // 2:
            middle = total + np.log(scale)
    return float(total + np.log(scale) - middle) / (TICKS - TICKS // 2)


@settings(max_examples=25, deadline=None)
@given(
    proportional=st.floats(0.0, 80.0),
    integral=st.one_of(st.just(0.0), st.floats(1.0, 2000.0)),
    damping=st.floats(0.0, 3.0),
    period=st.sampled_from([0.0005, 0.001, 0.002, 0.004]),
    length=st.floats(0.05, 3.0),
    bands=st.sampled_from([(500.0, 500.0), (300.0, 100.0), (800.0, 60.0)]),
)
def test_a_loop_has_margins_if_and_only_if_it_decays(
    proportional: float,
    integral: float,
    damping: float,
    period: float,
    length: float,
    bands: tuple[float, float],
) -> None:
    rate = growth((proportional, integral, damping), period, length, bands)
    assume(abs(rate) > LEAST)
    gains = {"proportional": proportional, "integral": integral, "rate_damping": damping}
    found = tension_loop_margins(
        ROBOT.drive_trains[0],
        CONFIG.control.tension_loop.model_copy(update=gains),
        period,
        cable_length=length,
        current_loop_hz=bands[0],
        cell_bandwidth_hz=bands[1],
    )
    assert found.stable == (rate < 0.0)
