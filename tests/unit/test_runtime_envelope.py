"""The Dynamic Safety Envelope's grading: each bound in turn, from green over amber to red."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tonus.config import load
from tonus.runtime.safety.envelope import Envelope
from tonus.runtime.signals import Bound, Grade
from tonus.runtime.states import Fault

CONFIG, _ = load("config/can.yaml")
CONTROL, ROBOT = CONFIG.control, CONFIG.robot
SETTINGS, TENSION, LAW = CONTROL.envelope, CONTROL.tension, CONTROL.stiffness
PERIOD = CONTROL.rates.period
ALL = np.ones(8, dtype=bool)
Array = NDArray[np.float64]


def envelope(**changes: Any) -> Envelope:
    settings = SETTINGS.model_copy(update=changes)
    return Envelope(settings, TENSION, LAW, ROBOT, PERIOD)


def settle(
    e: Envelope,
    *,
    tension: Any = 45.0,
    contact: float = 0.0,
    position: Any = (0.0, 0.0, 0.0),
    velocity: Any = (0.0, 0.0, 0.0),
    bearing: NDArray[np.bool_] = ALL,
    ticks: int = 2,
) -> Envelope:
    """The same measurements long enough that nothing seems to change."""
    tensions = np.broadcast_to(np.asarray(tension, dtype=float), (8,)).copy()
    for _ in range(ticks):
        e(tensions, contact, np.array(position), np.array(velocity), bearing)
    return e


def test_a_robot_at_ease_is_green_and_untouched() -> None:
    e = settle(envelope())
    assert (e.grade, e.bound, e.fault) == (Grade.GREEN, Bound.NONE, Fault.NONE)
    assert (e.cap, e.progress) == (LAW.maximum, 1.0)


def test_growing_contact_softens_slows_and_only_then_stops() -> None:
    forces = np.linspace(0.0, 26.0, 105)
    graded = [settle(envelope(), contact=float(force)) for force in forces]
    caps = [e.cap for e in graded]
    progress = [e.progress for e in graded]
    assert caps == sorted(caps, reverse=True)
    assert progress == sorted(progress, reverse=True)
    assert (caps[0], caps[-1]) == (LAW.maximum, LAW.minimum)
    grades = [int(e.grade) for e in graded]
    assert grades == sorted(grades)
    assert set(grades) == {Grade.GREEN, Grade.AMBER, Grade.RED}
    first_amber = forces[grades.index(Grade.AMBER)]
    first_red = forces[grades.index(Grade.RED)]
    assert first_amber == pytest.approx(SETTINGS.contact_warning * SETTINGS.contact_limit, abs=0.3)
    assert first_red == SETTINGS.contact_limit
    amber = [e for e in graded if e.grade is Grade.AMBER]
    assert all(e.bound is Bound.CONTACT and e.fault is Fault.NONE for e in amber)
    assert all(e.fault is Fault.CONTACT_LIMIT for e in graded if e.grade is Grade.RED)


def test_contact_is_predicted_over_the_horizon() -> None:
    """A force that grows by 0.3 N a tick is 15 N more in 50 ms: soft long before it is met."""
    e = envelope()
    for force in np.arange(0.0, 10.0, 0.3):
        settle(e, contact=float(force), ticks=1)
    assert (e.grade, e.bound, e.cap, e.progress) == (Grade.AMBER, Bound.CONTACT, LAW.minimum, 0.0)
    steady = settle(envelope(), contact=10.0)
    assert steady.grade is Grade.GREEN
    falling = envelope()
    for force in np.arange(20.0, 9.0, -0.3):
        settle(falling, contact=float(force), ticks=1)
    assert falling.contact == pytest.approx((SETTINGS.contact_limit - force) / 25.0)


def test_noise_of_the_contact_cell_is_no_growth() -> None:
    """0.02 N of noise a tick are 20 N/s; twenty of them never come near amber at 17 N."""
    e, random = envelope(), np.random.default_rng(4)
    for noise in random.normal(0.0, 0.02, 2000):
        settle(e, contact=17.0 + noise, ticks=1)
        assert e.grade is Grade.GREEN


def test_what_was_softened_stays_so_until_the_bound_recedes_by_the_band() -> None:
    e = settle(envelope(), contact=22.0)
    cap, progress = e.cap, e.progress
    zone = SETTINGS.contact_limit * (1.0 - SETTINGS.hysteresis - SETTINGS.contact_warning)
    settle(e, contact=22.0 - 0.9 * SETTINGS.release_band * zone, ticks=500)
    assert (e.cap, e.progress) == (cap, progress)
    settle(e, contact=22.4)
    assert e.cap < cap


def test_it_lets_go_slowly_and_in_the_end_altogether() -> None:
    e = settle(envelope(), contact=24.5)
    assert e.progress == 0.0
    paces = []
    for _ in range(1500):
        settle(e, contact=5.0, ticks=1)
        paces.append(e.progress)
    assert np.diff(paces).max() <= SETTINGS.release_rate * PERIOD * (1.0 + 1e-9)
    assert (e.grade, e.cap, e.progress) == (Grade.GREEN, LAW.maximum, 1.0)


def test_speed_slows_the_reference_but_leaves_the_stiffness() -> None:
    limit = SETTINGS.speed_limit
    e = settle(envelope(), velocity=(0.93 * limit, 0.0, 0.0))
    assert (e.grade, e.bound, e.cap) == (Grade.AMBER, Bound.SPEED, LAW.maximum)
    assert 0.0 < e.progress < 1.0
    e = settle(envelope(), velocity=(0.8 * limit, 0.0, 0.6 * limit))
    assert (e.grade, e.fault) == (Grade.RED, Fault.SPEED_LIMIT)


def test_the_workspace_counts_where_the_platform_is_going() -> None:
    edge = ROBOT.workspace.x[1]
    inside = (edge - 0.015, 0.0, 0.0)
    assert settle(envelope(), position=inside).grade is Grade.GREEN
    outward = settle(envelope(), position=inside, velocity=(0.2, 0.0, 0.0))
    assert (outward.grade, outward.bound) == (Grade.AMBER, Bound.WORKSPACE)
    beyond = settle(envelope(), position=(edge + 0.001, 0.0, 0.0))
    assert (beyond.grade, beyond.fault) == (Grade.RED, Fault.WORKSPACE_LIMIT)


def test_a_cable_must_stay_over_its_bound_to_stop_the_robot() -> None:
    tension = np.full(8, 45.0)
    tension[5] = TENSION.max + 1.0
    ticks = SETTINGS.over_tension_ticks
    e = settle(envelope(), tension=tension, ticks=ticks - 1)
    assert (e.fault, e.grade, e.cap) == (Fault.NONE, Grade.AMBER, LAW.minimum)
    settle(e, ticks=1)
    settle(e, tension=tension, ticks=ticks - 1)
    assert e.fault is Fault.NONE
    settle(e, tension=tension, ticks=1)
    assert (e.fault, e.where) == (Fault.OVER_TENSION, 5)


def test_a_slack_cable_counts_only_where_it_should_bear() -> None:
    tension = np.full(8, 45.0)
    tension[2] = TENSION.slack - 1.0
    e = settle(envelope(), tension=tension, ticks=SETTINGS.over_tension_ticks)
    assert (e.fault, e.where, e.grade) == (Fault.SLACK_CABLE, 2, Grade.RED)
    excused = ALL.copy()
    excused[2] = False
    assert settle(envelope(), tension=tension, bearing=excused, ticks=50).fault is Fault.NONE


@pytest.mark.parametrize(
    "excess",
    [
        {"contact": 80.0},
        {"velocity": (3.0, 0.0, 0.0)},
        {"position": (1.0, 0.0, 0.0)},
        {"tension": 500.0},
        {"tension": 0.0},
    ],
    ids=lambda excess: next(iter(excess)),
)
def test_a_disabled_envelope_measures_but_never_acts(excess: dict[str, Any]) -> None:
    e = settle(envelope(enabled=False), ticks=50, **excess)
    assert (e.fault, e.grade, e.cap, e.progress) == (Fault.NONE, Grade.GREEN, LAW.maximum, 1.0)
    margins = (e.tension_high, e.tension_low, e.contact, e.speed, e.workspace)
    assert min(margins) < 0.0


def test_margins_are_shares_of_their_span() -> None:
    e = settle(envelope(), contact=10.0, velocity=(0.0, 0.05, 0.0), position=(0.0, 0.0, 0.12))
    assert e.contact == pytest.approx(0.6)
    assert e.speed == pytest.approx(0.8)
    assert e.workspace == pytest.approx(0.08)
    assert (e.tension_high, e.tension_low) == (1.0, 1.0)


def test_reset_forgets_a_fault() -> None:
    e = settle(envelope(), contact=30.0, ticks=20)
    e.reset()
    assert (e.fault, e.grade, e.cap, e.progress) == (Fault.NONE, Grade.GREEN, LAW.maximum, 1.0)


def test_the_first_tick_after_a_reset_predicts_nothing() -> None:
    """A steady force has no growth, whatever was measured in another state long ago."""
    e = settle(envelope(), contact=0.0)
    e.reset()
    settle(e, contact=2.0, ticks=1)
    assert e.grade is Grade.GREEN
