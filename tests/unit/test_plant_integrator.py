"""The integrator: the same bytes for the same seed, and an error that falls with the step."""

from __future__ import annotations

import numpy as np
import pytest
from plant_setup import LAB, OPTIONS, frictionless, placed, plant, undamped, with_plant

from tonus.sim.plant import Plant


def driven(seed: int) -> Plant:
    p = plant(seed=seed, lab=with_plant(anchor_sigma=0.001))
    p.powered[:] = True
    random = np.random.default_rng(7)
    for k in range(500):
        p.current_reference[:] = random.uniform(0.0, 3.0, 8)
        p.advance((k + 1) * 1_000_000 + (k * 7919) % 400)
    return p


def test_one_seed_one_history() -> None:
    first, second, other = driven(1), driven(1), driven(2)
    assert first.state.tobytes() == second.state.tobytes()
    assert first.state.tobytes() != other.state.tobytes()


def test_a_step_is_never_longer_than_configured() -> None:
    """Spans of just over one step are taken in two, like the same span with a finer setting."""
    whole = placed(plant(lab=with_plant(substep_us=250)))
    fine = placed(plant(lab=with_plant(substep_us=200)))
    for p in (whole, fine):
        p.velocity[:] = (0.1, 0.0, 0.0)
        p.advance(300_000)
    assert whole.state.tobytes() == fine.state.tobytes()


def state_at(
    substep_us: int, damped: bool, opening: float = 0.5, option: str = "none"
) -> np.ndarray:
    """After a fifth of a second of swinging with turning drums."""
    robots = {} if damped else {"robot": undamped()}
    lab = with_plant(frictionless(), substep_us=substep_us, **OPTIONS[option])
    p = placed(plant(lab=lab, **robots))
    p.parameters["opening"] = opening
    p.velocity[:] = (0.1, -0.05, 0.08)
    p.angular_velocity[:] = (0.3, 0.2, -0.4)
    p.current_reference *= 1.1
    p.advance(200_000_000)
    return np.concatenate([p.position, p.quaternion, p.drum_angle])


@pytest.mark.parametrize(
    ("damped", "opening", "option", "order"),
    [
        (False, 0.5, "none", 2),
        (True, 0.5, "none", 2),
        (True, 0.5, "pulleys", 2),
        (True, 0.5, "stiffening cables", 2),
        (True, 0.5, "backlash", 2),
        (True, 1.0, "none", 1),
    ],
)
def test_the_errors_slope_over_the_step_is_the_order(
    damped: bool, opening: float, option: str, order: int
) -> None:
    truth = state_at(5, damped, opening, option)
    steps = np.array([400, 200, 100, 50])
    errors = [
        float(np.max(np.abs(state_at(int(step), damped, opening, option) - truth)))
        for step in steps
    ]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.2)


@pytest.mark.parametrize("option", OPTIONS)
def test_the_configured_step_is_fine_enough(option: str) -> None:
    """Micrometres over a fifth of a second of free swinging."""
    configured = state_at(LAB.plant.substep_us, damped=True, option=option)
    assert np.max(np.abs(configured - state_at(20, damped=True, option=option))[:3]) < 5e-6
