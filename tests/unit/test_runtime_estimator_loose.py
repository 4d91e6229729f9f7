"""The loosened estimate, that of a descent: lengths that are wrong by millimetres, and hardly
change, still tell how fast the platform moves."""

from __future__ import annotations

import numpy as np
import pytest
from flight import CONFIG, LEVEL, MASS, PERIOD, ROBOT, TRACKER, Flight
from numpy.typing import NDArray

from tonus.runtime.control.estimator import Doubts, PoseEstimator
from tonus.runtime.control.kinematics import Kinematics

Array = NDArray[np.float64]
WRONG = 2.0e-3
"""m"""
BEGUN, PUSHED = 0.2, 0.3
"""s at which the estimate is loosened, and from which on a load accelerates the platform"""
ACCELERATION = np.array([3.0, 0.0, -4.0])
"""m/s2"""


def pushed(t: float) -> Array:
    return 0.5 * ACCELERATION * max(t - PUSHED, 0.0) ** 2


def loosened(slip: float = 0.0) -> Flight:
    """Cable 3 is wrong by ``slip`` m from the moment on in which the estimate is loosened, and the
    tracker is silent."""
    flight = Flight(pushed)
    estimator = flight.estimator = PoseEstimator(
        ROBOT,
        CONFIG.control.estimator,
        TRACKER,
        Kinematics(ROBOT.geometry),
        PERIOD,
        Doubts.of(CONFIG.control),
    )
    estimator.start(pushed(0.0), LEVEL, flight._cables(0.0)[1], 60)
    flight.run(round(BEGUN / PERIOD), tracked=False)
    estimator.loosen()
    flight.slip[3] = slip
    return flight.run(round((PUSHED - BEGUN) / PERIOD), tracked=False)


@pytest.mark.parametrize("slip", [0.0, WRONG])
def test_a_load_that_nobody_announced_shows_in_the_velocity_at_once(slip: float) -> None:
    flight = loosened(slip)
    before = flight.estimator.estimate.velocity.copy()
    flight.external[:3] = MASS * ACCELERATION
    flight.run(30, tracked=False)
    gained = flight.estimator.estimate.velocity - before
    assert gained == pytest.approx(0.8 * 0.03 * ACCELERATION, rel=0.1, abs=2e-3)


def test_a_length_that_becomes_wrong_strays_and_no_other_does_as_far() -> None:
    flight = loosened()
    assert flight.estimator.strays == pytest.approx(np.zeros(8), abs=1e-6)
    flight = loosened(WRONG)
    strays = np.abs(flight.estimator.strays)
    assert int(strays.argmax()) == 3
    flight.estimator.loosen()
    assert not flight.estimator.strays.any()
