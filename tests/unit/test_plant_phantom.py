"""The phantom's two models against their solutions in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from plant_setup import KELVIN_VOIGT, ROBOT, TICK_NS, plant, run, with_plant, without_cradle

from tonus.config.schema.lab import Phantom
from tonus.sim.plant import Plant

SOLID = KELVIN_VOIGT.model_copy(update={"model": "standard_linear_solid"})
WEIGHTLESS = without_cradle(ROBOT).model_copy(update={"gravity": 1e-12})
K, C = KELVIN_VOIGT.stiffness, KELVIN_VOIGT.damping
K1, TAU = SOLID.relaxing_stiffness, SOLID.relaxation_time


def driven(phantom: Phantom, depth: float, speed: float = 0.0) -> Plant:
    """A port that nothing stops: a platform as heavy as a ship, without weight or cables."""
    p = plant(WEIGHTLESS, with_plant(mass_scale=1e9), phantom=phantom)
    for cable in range(8):
        p.cut_cable(cable)
    p.position[:] = (depth, 0.0, 0.0)
    p.velocity[0] = speed
    return p


def pushes(p: Plant, seconds: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    times, found = [], []
    for k in range(1, round(seconds * 1000) + 1):
        p.advance(p.now_ns + TICK_NS)
        times.append(k * 1e-3)
        found.append(float(p.contact_force))
    return np.array(times), np.array(found)


def test_after_a_step_the_solid_relaxes_exponentially_to_its_quasi_static_stiffness() -> None:
    times, found = pushes(driven(SOLID, 0.02), 2.0)
    assert found == pytest.approx(0.02 * (K + K1 * np.exp(-times / TAU)), rel=1e-6)


def test_under_a_ramp_the_solids_push_lags_by_its_relaxation() -> None:
    speed = 0.05
    times, found = pushes(driven(SOLID, 0.0, speed), 1.5)
    wanted = speed * (K * times + K1 * TAU * (1.0 - np.exp(-times / TAU)))
    # The dashpot sees the port where it was at a step's start: half a step of travel.
    assert found == pytest.approx(wanted, abs=K1 * speed * 0.25e-3 + 1e-6 * wanted[-1])


def test_under_a_ramp_the_kelvin_voigt_bodys_push_is_spring_plus_damper() -> None:
    times, found = pushes(driven(KELVIN_VOIGT, 0.0, 0.05), 0.5)
    assert found == pytest.approx(0.05 * (K * times + C), rel=1e-6)


def test_a_step_meets_the_kelvin_voigt_bodys_spring_alone() -> None:
    _, found = pushes(driven(KELVIN_VOIGT, 0.02), 0.5)
    assert found == pytest.approx(np.full(500, K * 0.02), rel=1e-6)


def sprung_back(phantom: Phantom, after: float) -> float:
    """Depth of the surface, some time after the port that had long pressed 20 mm deep was gone."""
    p = driven(phantom, 0.02)
    run(p, 5.0)
    p.position[0] = -0.01
    run(p, after)
    depth = 0.0
    for depth in np.arange(0.0, 0.02, 2e-5):
        p.position[0] = depth
        p.advance(p.now_ns + 1)
        if p.contact_force > 0.0:
            break
    return float(depth)


@pytest.mark.parametrize("after", [0.01, 0.1, 0.5, 1.0])
def test_the_solid_springs_back_at_once_and_then_creeps(after: float) -> None:
    at_once = 0.02 * K1 / (K + K1)
    slow = TAU * (K + K1) / K
    assert sprung_back(SOLID, after) == pytest.approx(at_once * np.exp(-after / slow), abs=3e-5)


@pytest.mark.parametrize("after", [0.01, 0.04, 0.1])
def test_the_kelvin_voigt_body_creeps_back_with_its_own_time_constant(after: float) -> None:
    assert sprung_back(KELVIN_VOIGT, after) == pytest.approx(
        0.02 * np.exp(-after * K / C), abs=3e-5
    )


@pytest.mark.parametrize("phantom", [SOLID, KELVIN_VOIGT])
def test_a_port_that_leaves_for_a_moment_closes_the_accounts(phantom: Phantom) -> None:
    """In, out faster than the surface follows, in again: what is not given back is a loss."""
    p = plant(WEIGHTLESS, phantom=phantom)
    for cable in range(8):
        p.cut_cable(cable)
    p.position[:] = 0.0
    p.velocity[0] = 0.3
    start = p.energy().balance
    p.advance(1)
    for _ in range(6):
        run(p, 0.03)
        p.velocity[0] *= -1.0  # a mirror keeps the kinetic energy
    end = p.energy()
    assert end.losses > 5e-4
    assert end.balance - start == pytest.approx(
        0.5 * ROBOT.platform.mass * 0.3**2, abs=0.02 * end.losses
    )
