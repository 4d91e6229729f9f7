"""What the limiter promises on the reduced model: mass, virtual spring and damper (on the plant,
cables and drums come between)."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import expm

from tonus.config import load
from tonus.config.schema.control import Passivity
from tonus.runtime.control.passivity import Limiter, Tank, damping

CONFIG, _ = load("config/can.yaml")
ROBOT, LAW, TANK = CONFIG.robot, CONFIG.control.stiffness, CONFIG.control.passivity
MASS, PERIOD = ROBOT.platform.mass, CONFIG.control.rates.period
ZERO = np.zeros(3)
special = st.sampled_from([math.nan, math.inf, -math.inf, -0.0, 1e308, LAW.minimum, LAW.maximum])
anything = special | st.floats(allow_nan=True, allow_infinity=True)
near = st.floats(0.0, 2.0 * LAW.maximum)
errors = st.tuples(*[st.floats(-0.3, 0.3) | anything] * 3)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    st.lists(st.tuples(anything | near, anything | near, errors), min_size=1, max_size=40),
    st.sampled_from([LAW.rise_rate, 1e6]),
    st.floats(0.02, 2.0),
)
def test_bounds_rate_cap_and_tank_hold_for_any_floats(
    asked: list[tuple[float, float, tuple[float, ...]]], rise_rate: float, ratio: float
) -> None:
    law = LAW.model_copy(update={"rise_rate": rise_rate})
    limiter = Limiter(law, TANK, ROBOT, ratio, PERIOD)
    for wanted, cap, error in asked:
        before = limiter.value
        bound = min(limiter.rise_bound(before), 2.0 * limiter.alpha * before, rise_rate)
        value = limiter(wanted, cap, np.array(error), ZERO, ZERO)
        assert LAW.minimum <= value <= LAW.maximum
        assert value - before <= bound * PERIOD + 1e-9
        assert TANK.tank_minimum <= limiter.tank.level <= TANK.tank_capacity
        if LAW.minimum <= cap:
            assert value <= cap


@lru_cache
def transition(stiffness: float, resistance: float) -> NDArray[np.float64]:
    flow = np.array([[0.0, 1.0], [-stiffness / MASS, -resistance / MASS]])
    return np.asarray(expm(flow * PERIOD))


class Reduced:
    """m e'' + D(K) e' + K e = 0 along one axis, exact between ticks, K in the limiter's hands."""

    def __init__(self, ratio: float, tank: Passivity = TANK, **law: float) -> None:
        chosen = LAW.model_copy(update=law)
        self.limiter = Limiter(chosen, tank, ROBOT, ratio, PERIOD)
        self.ratio = ratio
        self.state = np.array([0.01, 0.0])

    @property
    def energy(self) -> float:
        e, v = self.state
        return float(0.5 * MASS * v * v + 0.5 * self.limiter.value * e * e)

    def tick(self, wanted: float) -> None:
        error = np.array([self.state[0], 0.0, 0.0])
        self.limiter(wanted, LAW.maximum, error, np.array([self.state[1], 0.0, 0.0]), ZERO)

    def move(self) -> None:
        k = self.limiter.value
        self.state = transition(k, damping(self.ratio, k, MASS)) @ self.state


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    st.floats(0.02, 1.0),
    st.tuples(st.floats(-0.1, 0.1), st.floats(-1.0, 1.0)),
    st.lists(st.tuples(near, st.integers(1, 25)), min_size=1, max_size=8),
)
def test_storage_and_tank_together_never_grow_by_themselves(
    ratio: float, start: tuple[float, float], phases: list[tuple[float, int]]
) -> None:
    """Any stiffness asked for, at any moment: what is stored in spring, mass and tank only falls,
    from tick to tick and from before to after the stiffness changes."""
    model = Reduced(ratio, rise_rate=1e9)
    model.limiter(0.0, LAW.maximum, np.array([start[0], 0.0, 0.0]), ZERO, ZERO)
    model.state[:] = start
    total = model.energy + model.limiter.tank.level
    for wanted, ticks in phases:
        for _ in range(ticks):
            model.move()
            model.tick(wanted)
            now = model.energy + model.limiter.tank.level
            assert now <= total + 1e-12 + 1e-9 * total
            total = now


def pumped(settings: Passivity, seconds: float = 7.0) -> float:
    """Largest |e| (m) under a law that stiffens on the way in and softens on the way out, with a
    damper of 8 N s/m at K0 and no rate bound: what a tank does by itself."""
    ratio = 8.0 / damping(1.0, LAW.base, MASS)
    tank, stiffness, state = Tank(settings), LAW.base, np.array([0.01, 0.0])
    largest = last = float(state[0])
    for _ in range(round(seconds / PERIOD)):
        inward, stretch = state[0] * state[1] < 0.0, float(state[0]) ** 2
        tank.fill(damping(ratio, stiffness, MASS) * (float(state[0]) - last) ** 2 / PERIOD)
        last = float(state[0])
        if inward:
            stiffness = tank.admit(stiffness, LAW.maximum, stretch)
        else:
            tank.fill(0.5 * (stiffness - LAW.base) * stretch)
            stiffness = LAW.base
        state = transition(stiffness, damping(ratio, stiffness, MASS)) @ state
        largest = max(largest, abs(float(state[0])))
    return largest


def test_pumping_diverges_without_the_tank_and_stays_bounded_with_it() -> None:
    """10 mm grow to more than a metre, or not at all beyond what the tank held at first."""
    endless = TANK.model_copy(update={"tank_capacity": 1e9, "tank_initial": 1e9})
    assert pumped(endless) > 1.0
    held = 0.5 * LAW.base * 0.01**2 + TANK.tank_initial
    assert pumped(TANK) <= math.sqrt(2.0 * held / LAW.base) + 1e-6
