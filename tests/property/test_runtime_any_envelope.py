"""Any finite measurements leave the envelope's outputs in their ranges, and a red grade with its
reason."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tonus.config import load
from tonus.runtime.safety.envelope import Envelope
from tonus.runtime.signals import Bound, Grade
from tonus.runtime.states import Fault

CONFIG, _ = load("config/can.yaml")
CONTROL, LAW = CONFIG.control, CONFIG.control.stiffness
value = st.floats(-1e6, 1e6)
vector = st.tuples(*[value | st.floats(-0.3, 0.3)] * 3)
tick = st.tuples(
    st.lists(value | st.floats(0.0, 250.0), min_size=8, max_size=8),
    value | st.floats(0.0, 40.0),
    vector,
    vector,
    st.lists(st.booleans(), min_size=8, max_size=8),
)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.lists(tick, min_size=1, max_size=12), st.booleans())
def test_cap_and_progress_stay_in_range_and_red_has_a_reason(
    ticks: list[tuple[list[float], float, tuple[float, ...], tuple[float, ...], list[bool]]],
    enabled: bool,
) -> None:
    chosen = CONTROL.envelope.model_copy(update={"enabled": enabled})
    e = Envelope(chosen, CONTROL.tension, LAW, CONFIG.robot, CONTROL.rates.period)
    for tension, contact, position, velocity, bearing in ticks:
        e(np.array(tension), contact, np.array(position), np.array(velocity), np.array(bearing))
        assert LAW.minimum <= e.cap <= LAW.maximum
        assert 0.0 <= e.progress <= 1.0
        assert (e.grade is Grade.RED) == (e.fault is not Fault.NONE)
        assert (e.grade is Grade.GREEN) <= (e.bound is Bound.NONE)
        if not enabled:
            assert e.fault is Fault.NONE
        elif contact >= chosen.contact_limit:
            assert e.fault is Fault.CONTACT_LIMIT
            assert (e.cap, e.progress) == (LAW.minimum, 0.0) or e.bound is not Bound.CONTACT
