"""Drums: Stribeck's friction, gearbox losses, backlash, and where the motors' energy goes."""

from __future__ import annotations

import numpy as np
import pytest
from plant_setup import (
    BACKLASH,
    LAB,
    ROBOT,
    STRIBECK,
    TICK_NS,
    frictionless,
    placed,
    plant,
    run,
    undamped,
    with_plant,
)
from scipy.integrate import quad

from tonus.config.schema.lab import Lab
from tonus.sim.errors import LabError
from tonus.sim.plant import Plant

R, J, B = ROBOT.drum.radius, ROBOT.drum.inertia, ROBOT.drum.viscous_friction


def loose_drums(lab: Lab) -> Plant:
    p = plant(lab=lab)
    for cable in range(8):
        p.cut_cable(cable)
    return p


def test_a_drum_spins_down_along_stribecks_curve() -> None:
    """From each speed the time to the next against the integral of J / torque over the speeds."""
    p = loose_drums(with_plant(stribeck=STRIBECK))
    p.drum_rate[:] = 2.0

    def torque(rate: float) -> float:
        sliding = LAB.plant.coulomb_friction * R
        return B * rate + sliding * (1.0 + 0.2 * np.exp(-((rate * R / 0.01) ** 2)))

    rates = [2.0]
    while p.drum_rate[0] > 0.0:
        p.advance(p.now_ns + 250_000)
        rates.append(float(p.drum_rate[0]))
    for k in range(0, len(rates) - 40, 40):
        wanted = quad(lambda rate: J / torque(rate), rates[k + 40], rates[k])[0]
        assert wanted == pytest.approx(40 * 250e-6, rel=1e-4)
    # The last step is one of standstill.
    whole = quad(lambda rate: J / torque(rate), 0.0, 2.0)[0]
    assert (len(rates) - 1) * 250e-6 == pytest.approx(whole, abs=300e-6)
    assert torque(0.0) > 1.19 * (torque(2.0) - 2.0 * B)


@pytest.mark.parametrize("excess", [1.03, 1.17, 1.23])
def test_breaking_loose_takes_stribecks_share_more(excess: float) -> None:
    p = loose_drums(with_plant(stribeck=STRIBECK, gearbox_losses=False))
    p.powered[:] = True
    sliding = LAB.plant.coulomb_friction * R
    p.current[:] = p.current_reference[:] = (
        sliding * excess / (ROBOT.motor.torque_constant * ROBOT.gearbox.ratio)
    )
    run(p, 0.2)
    assert bool(np.all(p.drum_rate > 0.0)) is (excess > 1.2)


@pytest.mark.parametrize("winding", [True, False])
def test_the_gearbox_passes_its_efficiency_on_in_either_direction(winding: bool) -> None:
    """In slow steady motion the cables get eta of the motors' work, and the motors eta of the
    cables'."""
    p = placed(plant(undamped(), with_plant(frictionless(), gearbox_losses=True)))
    efficiency = ROBOT.gearbox.efficiency
    work = cables = 0.0
    start = p.energy()
    for _ in range(400):
        share = 1.0 / efficiency if winding else efficiency
        error = (0.5 if winding else -0.5) - p.drum_rate
        p.current_reference[:] = (p.tension * R * share + 0.05 * error) / (
            ROBOT.motor.torque_constant * ROBOT.gearbox.ratio
        )
        before, angle = p.energy().input_work, p.drum_angle.copy()
        tension = p.tension.copy()
        p.advance(p.now_ns + TICK_NS)
        work += p.energy().input_work - before
        cables += float(np.sum(0.5 * (tension + p.tension) * R * (p.drum_angle - angle)))
    assert (cables > 0.5) if winding else (cables < -0.3)
    assert (cables / work if winding else work / cables) == pytest.approx(efficiency, rel=0.01)
    lost = p.energy().friction_losses - start.friction_losses
    turning = 0.5 * J * float(p.drum_rate @ p.drum_rate)
    assert lost == pytest.approx(work - cables - turning, rel=1e-3)


def test_copper_losses_are_resistance_times_current_squared() -> None:
    p = loose_drums(LAB)
    p.powered[:] = True
    p.current_reference[:] = 3.0
    run(p, 0.02)
    before = p.energy().copper_losses
    run(p, 0.5)
    lost = p.energy().copper_losses - before
    assert lost == pytest.approx(8 * LAB.plant.winding_resistance * 9.0 * 0.5, rel=1e-6)


def test_powers_integrate_to_work() -> None:
    """The powers a metric clips are the ones whose integrals the accounts hold."""
    p = placed(plant(lab=with_plant(frictionless(), pulley_radius=0.03)))
    p.current_reference *= np.linspace(0.7, 1.5, 8)
    p.velocity[:] = (0.05, 0.1, 0.0)
    begin = p.energy()
    p.advance(1)
    platform, electrical = [], []
    for _ in range(400):
        platform.append(float(p.platform_power))
        electrical.append(float(p.electrical_power))
        p.advance(p.now_ns + 250_000)
    end = p.energy()
    spin = 0.5 * p.angular_velocity @ (np.array(ROBOT.platform.inertia) * p.angular_velocity)
    moving = 0.5 * ROBOT.platform.mass * (p.velocity @ p.velocity - 0.0125) + spin
    gained = moving + end.potential - begin.potential
    assert np.sum(platform) * 250e-6 == pytest.approx(gained, rel=0.02, abs=2e-3)
    turned = end.input_work - begin.input_work + end.copper_losses - begin.copper_losses
    assert np.sum(electrical) * 250e-6 == pytest.approx(turned, rel=0.01)


def test_losses_are_the_sum_of_their_parts_when_nothing_else_dissipates() -> None:
    p = placed(plant(lab=with_plant(stribeck=STRIBECK)))
    p.current_reference *= np.tile([0.5, 1.6], 4)
    start = p.energy()
    run(p, 0.1)
    end = p.energy()
    friction = end.friction_losses - start.friction_losses
    cables = end.cable_losses - start.cable_losses
    assert friction > 0.0
    assert cables > 0.0
    assert end.losses - start.losses == pytest.approx(friction + cables, rel=1e-9)


def test_backlash_rests_without_a_limit_cycle() -> None:
    p = placed(plant(lab=with_plant(backlash=BACKLASH)))
    p.velocity[:] = (0.02, -0.01, 0.03)
    run(p, 6.0)
    angle, tension = p.motor_angle.copy(), p.tension.copy()
    run(p, 0.5)
    assert np.array_equal(p.motor_angle, angle)
    assert p.tension == pytest.approx(tension, abs=1e-6)


def test_a_slack_drum_follows_its_rotor_with_the_play_between() -> None:
    """Wound in, then out, by friction drums: the angle lost on reversal is the play."""
    p = loose_drums(with_plant(gearbox_losses=False, backlash=BACKLASH))
    p.powered[:] = True
    lag = []
    for current in (0.2, -0.2):
        p.current_reference[:] = current
        run(p, 0.5)
        lag.append(p.motor_angle / ROBOT.gearbox.ratio - p.drum_angle)
    wound_up = 2.0 * 0.2 * LAB.plant.coulomb_friction * R / BACKLASH.stiffness
    assert lag[0] - lag[1] == pytest.approx(
        np.full(8, np.radians(BACKLASH.play_deg)), rel=0.05, abs=2 * wound_up
    )


def test_a_brake_holds_the_rotor_and_leaves_the_drum_its_play() -> None:
    p = loose_drums(with_plant(frictionless(), backlash=BACKLASH))
    p.locked[:] = True
    p.drum_rate[:] = 0.2
    furthest = np.zeros(8)
    for _ in range(300):
        p.advance(p.now_ns + TICK_NS)
        furthest = np.maximum(furthest, p.drum_angle)
        assert not p.motor_angle.any()
    half = 0.5 * np.radians(BACKLASH.play_deg)
    assert np.all(furthest > half)
    assert np.all(furthest < 1.1 * half)


def test_under_tension_the_play_is_never_felt() -> None:
    """The cable keeps the teeth on one side, so tensions differ by the teeth's elasticity only."""
    with_play = placed(plant(lab=with_plant(backlash=BACKLASH)))
    without = placed(plant())
    for p in (with_play, without):
        p.current_reference *= 1.3
        run(p, 0.3)
    assert with_play.tension == pytest.approx(without.tension, rel=0.02)
    lost = with_play.motor_angle / ROBOT.gearbox.ratio - with_play.drum_angle
    assert np.all(lost > 0.5 * np.radians(BACKLASH.play_deg))


def test_teeth_too_stiff_for_the_step_are_refused_with_the_step_that_would_do() -> None:
    with pytest.raises(LabError, match=r"lab\.plant\.backlash: .* substep_us 250; set it to \d+"):
        plant(lab=with_plant(backlash=BACKLASH.model_copy(update={"stiffness": 1e5})))
