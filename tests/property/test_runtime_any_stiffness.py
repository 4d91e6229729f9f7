"""Whatever the law and the envelope ask for, what reaches the platform stays in its bounds and
rises no faster than it may."""

from __future__ import annotations

import math

from hypothesis import given, settings
from hypothesis import strategies as st

from config import load
from runtime.stiffness import Law, Limiter

LAW = load("config/can.yaml")[0].control.stiffness
PERIOD = 0.001
special = st.sampled_from([math.nan, math.inf, -math.inf, -0.0, 1e308, LAW.minimum, LAW.maximum])
anything = special | st.floats(allow_nan=True, allow_infinity=True)
near = st.floats(0.0, 2.0 * LAW.maximum)
size = st.floats(0.0, 1e300)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    st.lists(st.tuples(anything | near, anything | near), min_size=1, max_size=40),
    st.sampled_from([LAW.rise_rate, 1e6]),
)
def test_the_limiter_keeps_bounds_and_rate_for_any_floats(
    asked: list[tuple[float, float]], rise_rate: float
) -> None:
    law = LAW.model_copy(update={"rise_rate": rise_rate})
    limiter = Limiter(law, PERIOD)
    before = limiter.value
    for wanted, cap in asked:
        value = limiter(wanted, cap)
        assert LAW.minimum <= value <= LAW.maximum
        assert value - before <= rise_rate * PERIOD * (1.0 + 1e-9)
        if LAW.minimum <= cap:
            assert value <= cap
        before = value


@settings(max_examples=200, deadline=None, derandomize=True)
@given(size, size, size, st.sampled_from(["table1_eq3", "eq10"]), st.floats(0.0, 2.0))
def test_the_law_stays_between_base_and_maximum(
    deviation: float, velocity: float, force: float, profile: str, gain: float
) -> None:
    law = Law(LAW.model_copy(update={"profile": profile, "deviation_gain": gain}))
    assert LAW.base <= law(deviation, velocity, force) <= LAW.maximum


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.floats(0.0, 0.3), st.floats(0.0, 40.0), st.floats(0.0, 0.3), st.floats(0.0, 40.0))
def test_more_of_anything_never_makes_the_law_softer(
    velocity: float, force: float, faster: float, harder: float
) -> None:
    law = Law(LAW)
    assert law(0.0, velocity + faster, force + harder) >= law(0.0, velocity, force)
