"""Whatever it reads, the law stays in its bounds and never softens for more of anything."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from tonus.config import load
from tonus.runtime.control.stiffness import Law

LAW = load("config/can.yaml")[0].control.stiffness
size = st.floats(0.0, 1e300)


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
