"""A sampled system beside scipy's own function for it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from tonus.tools.margins.hold import zero_order_hold


@pytest.mark.parametrize(("states", "inputs"), [(1, 1), (4, 2), (6, 1)])
def test_it_is_what_scipy_gives(states: int, inputs: int) -> None:
    random = np.random.default_rng(states)
    flow, enter = random.normal(size=(states, states)), random.normal(size=(states, inputs))
    step, effect = zero_order_hold(flow, enter, 0.3)
    system = (flow, enter, np.eye(states), np.zeros((states, inputs)))
    expected, expected_effect, *_ = signal.cont2discrete(system, 0.3)
    np.testing.assert_allclose(step, expected, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(effect, expected_effect, rtol=1e-12, atol=1e-14)
