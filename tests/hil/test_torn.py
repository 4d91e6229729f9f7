"""Every cable torn at rest at three poses; `make torn` does it at all 27, and in motion."""

from __future__ import annotations

import pytest

from config.loader import load_bounds
from tests.torn import CABLES, Place, Torn

TENSION = 1.2 * 200.0
"""N: `tension` of config/bounds.yaml, of T_max"""


@pytest.mark.parametrize(
    "home", [(0.0, 0.0, 0.0), (-0.15, -0.15, -0.06), (0.15, 0.0, 0.0)], ids=str
)
def test_no_torn_cable_throws_the_platform(home: Place) -> None:
    bounds = load_bounds()
    robot = Torn(home)
    for cable in range(CABLES):
        (case,) = robot.cases(cable, ("rest",))
        assert case.peak_speed <= bounds.speed, case
        assert case.peak_tension <= TENSION, case
        assert case.where == cable, case
        assert case.given_up == (cable,), case
        assert case.found_after is not None, case
        assert case.found_after <= bounds.found_within["cable_cut"], case
        assert case.at_rest, case
        assert case.ended_after is not None, case
