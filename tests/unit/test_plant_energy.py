"""Energy: what is neither lost nor put in is kept."""

from __future__ import annotations

import numpy as np
import pytest
from plant_setup import (
    BACKLASH,
    KELVIN_VOIGT,
    OPTIONS,
    ROBOT,
    SCENARIO,
    TICK_NS,
    frictionless,
    placed,
    plant,
    run,
    undamped,
    with_plant,
    without_cradle,
)

from tonus.sim.plant import Plant

BUDGET = 1e-3  # of the excitation energy


def worst_relative_error(p: Plant, held: bool) -> float:
    """Throw the platform out of equilibrium and watch the balance for 10 s, with the drums held or
    free under constant torque. Free, the constant tensions cannot hold roll and pitch (their
    geometric stiffness is negative), so the platform ends in a large motion: the harsher case."""
    placed(p)
    p.locked[:] = held
    still = p.energy().balance
    p.velocity[:] = (0.10, -0.06, 0.08)
    p.angular_velocity[:] = (0.3, -0.2, 0.4)
    p.advance(p.now_ns + 1)  # the accounts take notice
    start = p.energy().balance
    worst = 0.0
    for _ in range(10_000):
        p.advance(p.now_ns + TICK_NS)
        worst = max(worst, abs(p.energy().balance - start))
    assert np.all(p.tension > 0.0)
    assert p.energy().losses == 0.0
    return worst / (start - still)


@pytest.mark.parametrize("option", ["none", "pulleys", "stiffening cables"])
@pytest.mark.parametrize("held", [True, False])
def test_the_ideal_plant_conserves_its_energy(option: str, held: bool) -> None:
    lab = with_plant(frictionless(), **OPTIONS[option])
    assert worst_relative_error(plant(undamped(without_cradle()), lab), held) < BUDGET


def test_elastic_teeth_give_back_what_they_take() -> None:
    """Rotors shaken across their play, nothing damped: the impacts on the flanks lose nothing."""
    teeth = BACKLASH.model_copy(update={"damping": 0.0})
    p = plant(undamped(without_cradle()), with_plant(frictionless(), backlash=teeth))
    p.powered[:] = True
    for cable in range(8):
        p.cut_cable(cable)
    start = p.energy()
    turned_over = 0.0
    for k in range(400):
        p.current_reference[:] = 0.5 * np.sin(0.2 * k)
        before = p.energy().input_work
        run(p, 0.002)
        turned_over += abs(p.energy().input_work - before)
    end = p.energy()
    assert end.losses == pytest.approx(start.losses, abs=1e-12)
    assert turned_over > 0.5, turned_over
    assert abs(end.balance - start.balance) < 2e-3 * turned_over


@pytest.mark.parametrize("held", [True, False])
def test_semi_implicit_euler_would_not(held: bool) -> None:
    p = plant(undamped(without_cradle()), frictionless())
    p.parameters["opening"] = 1.0
    assert worst_relative_error(p, held) > 5 * BUDGET


def test_cable_wound_on_under_tension_belongs_to_the_account() -> None:
    p = placed(plant(undamped(), frictionless()))
    p.current_reference *= 1.5
    start = p.energy()
    run(p, 0.5)
    end = p.energy()
    assert abs(end.wound - start.wound) > 100 * abs(end.balance - start.balance)
    assert end.balance == pytest.approx(start.balance, abs=1e-3 * end.input_work)


@pytest.mark.parametrize("option", OPTIONS)
def test_the_balance_closes_with_every_loss_on(option: str) -> None:
    assert SCENARIO.lab.load is not None
    lab = with_plant(**OPTIONS[option])
    p = placed(plant(lab=lab, phantom=KELVIN_VOIGT, load=SCENARIO.lab.load), (0.0, 0.01, 0.05))
    p.start_schedule(-8_000_000_000)
    start = p.energy()
    random = np.random.default_rng(3)
    hold = p.current.copy()
    for _ in range(100):
        p.current_reference[:] = hold * random.uniform(0.7, 1.6, 8)
        run(p, 0.02)
    end = p.energy()
    turned_over = abs(end.losses) + abs(end.input_work) + abs(end.load_work)
    assert end.losses > 0.5
    assert end.phantom > 0.0 or end.load_work != 0.0
    assert abs(end.balance - start.balance) < 2e-3 * turned_over


def test_losses_only_grow_in_free_motion() -> None:
    p = placed(plant())
    p.velocity[:] = (0.2, 0.1, -0.1)
    last = 0.0
    for _ in range(1000):
        p.advance(p.now_ns + TICK_NS)
        assert p.losses >= last - 1e-12
        last = float(p.losses)
    assert last > 0.0


def test_a_cut_cable_takes_its_strain_energy_with_it() -> None:
    p = placed(plant(undamped(), frictionless()))
    start = p.energy()
    stretch = p.tension[2] ** 2 / ROBOT.cable.axial_stiffness / 2
    length = np.linalg.norm(np.subtract(ROBOT.geometry.frame[2], ROBOT.geometry.platform[2]))
    p.cut_cable(2)
    unstretched = length / (1 + p.tension[3] / ROBOT.cable.axial_stiffness)
    assert p.energy().losses == pytest.approx(stretch * unstretched, rel=1e-6)
    assert p.energy().balance == pytest.approx(start.balance, abs=1e-9)
    run(p, 0.05)
    assert p.tension[2] == 0.0
