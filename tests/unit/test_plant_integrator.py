"""The integrator: the same bytes for the same seed, and an error that falls with the step."""

from __future__ import annotations

import numpy as np
import pytest
from plant_setup import LAB, frictionless, placed, plant, undamped, with_plant

from sim.plant import Plant


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


def error_at(substep_us: int, damped: bool, opening: float = 0.5) -> np.ndarray:
    robots = {} if damped else {"robot": undamped()}
    p = placed(plant(lab=with_plant(frictionless(), substep_us=substep_us), **robots))
    p.parameters["opening"] = opening
    p.velocity[:] = (0.1, -0.05, 0.08)
    p.angular_velocity[:] = (0.3, 0.2, -0.4)
    p.current_reference *= 1.1
    p.advance(200_000_000)
    return np.concatenate([p.position, p.quaternion, p.drum_angle])


@pytest.mark.parametrize(
    ("damped", "opening", "order"), [(False, 0.5, 2), (True, 0.5, 2), (True, 1.0, 1)]
)
def test_convergence_order(damped: bool, opening: float, order: int) -> None:
    truth = error_at(20, damped)
    errors = [
        float(np.max(np.abs(error_at(step, damped, opening) - truth))) for step in (1000, 500)
    ]
    assert errors[0] / errors[1] == pytest.approx(2.0**order, rel=0.25)


def test_the_configured_step_is_fine_enough() -> None:
    """Micrometres over a fifth of a second of free swinging."""
    configured = error_at(LAB.plant.substep_us, damped=True)
    assert np.max(np.abs(configured - error_at(20, damped=True))[:3]) < 5e-6
