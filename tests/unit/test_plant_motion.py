"""The plant moves as mechanics says: signs, contacts, friction, currents, schedules."""

from __future__ import annotations

import numpy as np
import pytest
from plant_setup import (
    CONFIG,
    KELVIN_VOIGT,
    LAB,
    ROBOT,
    SCENARIO,
    TICK_NS,
    UPRIGHT,
    frictionless,
    placed,
    plant,
    run,
    undamped,
    with_plant,
    without_cradle,
)

from tonus.config.schema.lab import Phantom
from tonus.sim.plant import Plant

WEIGHT = ROBOT.platform.mass * ROBOT.gravity


def loose(p: Plant) -> Plant:
    for cable in range(8):
        p.cut_cable(cable)
    return p


def test_at_first_the_platform_lies_still_with_every_cable_a_little_slack() -> None:
    p = plant()
    run(p, 0.2)
    assert p.position == pytest.approx(ROBOT.rest, abs=1e-9)
    assert np.max(np.abs(p.velocity)) < 1e-9
    assert not p.tension.any()
    assert not p.motor_angle.any()
    levers = np.array(ROBOT.geometry.platform)
    lengths = np.linalg.norm(np.array(ROBOT.geometry.frame) - ROBOT.rest - levers, axis=1)
    slack = p.parameters["start_length"][0] - lengths
    low, high = LAB.plant.slack_at_start
    assert np.all((slack > low) & (slack < high))
    assert len(set(slack)) == 8


def test_free_fall_keeps_angular_momentum() -> None:
    p = loose(plant(without_cradle()))
    p.position[:] = (0.1, 0.0, 0.2)
    p.velocity[:] = (0.5, 0.0, 1.0)
    p.angular_velocity[:] = (3.0, -2.0, 4.0)

    def momentum() -> np.ndarray:
        w, x, y, z = p.quaternion
        v = np.array([x, y, z])

        def turn(a: np.ndarray, side: float) -> np.ndarray:
            return a + 2 * np.cross(side * v, np.cross(side * v, a) + w * a)

        return turn(np.array(ROBOT.platform.inertia) * turn(p.angular_velocity, -1.0), 1.0)

    p.advance(1)
    start, energy = momentum(), p.energy().balance
    run(p, 1.0)
    spin = 0.5 * momentum() @ p.angular_velocity
    assert p.energy().balance == pytest.approx(energy, abs=1e-6 * spin)
    assert p.position[0] == pytest.approx(0.6, rel=1e-8)
    assert p.position[2] == pytest.approx(1.2 - 0.5 * ROBOT.gravity, rel=1e-8)
    assert momentum() == pytest.approx(start, rel=1e-9)
    assert np.linalg.norm(p.quaternion) == pytest.approx(1.0, abs=1e-14)
    # Unequal moments of inertia: the axis itself wanders.
    assert not np.allclose(p.angular_velocity, (3.0, -2.0, 4.0), atol=0.1)


def test_hanging_at_rest_the_cables_carry_the_weight() -> None:
    p = placed(plant(without_cradle()))
    p.locked[:] = True
    p.velocity[:] = (0.05, 0.02, -0.05)
    run(p, 6.0)
    assert np.max(np.abs(p.velocity)) < 1e-6
    wrench = p.structure_matrix() @ p.tension
    assert wrench == pytest.approx([0, 0, WEIGHT, 0, 0, 0], abs=1e-4)


def test_positive_current_winds_in_and_raises_tension() -> None:
    p = plant()
    p.powered[:] = True
    p.current_reference[:] = 1.0
    run(p, 1.0)
    assert np.all(p.motor_angle > 0.0)
    assert p.motor_angle == pytest.approx(p.drum_angle * ROBOT.gearbox.ratio)
    assert np.all(p.tension > 20.0)
    # Friction holds what the arrival of the cables leaves, between winding and being unwound.
    assert np.all(p.tension > 0.8 * ROBOT.tension_per_amp)
    assert np.all(p.tension < 1.15 * ROBOT.tension_per_amp / ROBOT.gearbox.efficiency**2)
    wound_in = p.motor_angle.copy()
    p.current_reference[:] = -1.0
    run(p, 0.3)
    assert np.all(p.motor_angle < wound_in)
    assert np.all(p.tension < 10.0)


def test_a_single_pull_moves_the_platform_towards_its_anchor() -> None:
    p = placed(plant(lab=frictionless()))
    p.current_reference[0] += 0.3
    run(p, 0.05)
    towards = np.array(ROBOT.geometry.frame[0]) - np.array(ROBOT.geometry.platform[0])
    assert p.position @ towards > 0.0
    assert p.motor_rate[0] > 0.0


def test_friction_holds_a_drum_until_it_breaks_loose() -> None:
    p = placed(plant())
    at_rest = p.drum_angle.copy()
    p.current_reference *= 1.05
    run(p, 0.5)
    assert np.array_equal(p.drum_angle, at_rest)
    p.current_reference *= 1.5
    run(p, 0.1)
    assert np.all(p.drum_angle > at_rest)
    slippery = placed(plant(lab=frictionless()))
    slippery.current_reference *= 1.05
    run(slippery, 0.1)
    assert np.all(slippery.drum_angle > at_rest)


@pytest.mark.parametrize("load_friction", [0.0, 0.03, 0.1])
def test_friction_is_what_is_configured(load_friction: float) -> None:
    """A drum breaks loose where the motor exceeds tension, Coulomb and load-dependent friction."""
    lab = with_plant(coulomb_friction=1.5, load_friction=load_friction, gearbox_losses=False)
    tension = placed(plant(undamped(), lab)).tension.copy()
    for excess, moves in ((0.97, False), (1.03, True)):
        p = placed(plant(undamped(), lab))
        start = p.drum_angle.copy()
        share = 1.0 + (1.5 + load_friction * tension) / tension * excess
        p.current[:] = p.current_reference[:] = p.current * share
        run(p, 0.005)
        assert bool(np.all(p.drum_angle > start)) is moves


def test_a_cable_never_pushes_however_fast_it_is_let_go() -> None:
    p = plant(without_cradle())
    p.place((0.0, 0.0, 0.0), UPRIGHT, np.full(8, 5.0))
    towards = np.subtract(ROBOT.geometry.frame[0], ROBOT.geometry.platform[0])
    p.velocity[:] = 2.0 * towards / np.linalg.norm(towards)
    p.advance(1)
    assert p.tension[0] == 0.0
    assert np.all(p.tension >= 0.0)
    assert p.tension[6] > 5.0


@pytest.mark.parametrize("losses", [True, False])
def test_gearbox_losses_work_against_the_motion(losses: bool) -> None:
    """Winding needs T r/eta of motor torque, being unwound holds with T r eta of it."""
    lab = with_plant(frictionless(), gearbox_losses=losses)
    efficiency = ROBOT.gearbox.efficiency if losses else 1.0
    for share, moves in ((0.97, False), (1.03, True)):
        winding = placed(plant(undamped(), lab))
        start = winding.drum_angle.copy()
        winding.current[:] = winding.current_reference[:] = winding.current / efficiency * share
        run(winding, 0.02)
        unwinding = placed(plant(undamped(), lab))
        unwinding.current_reference *= efficiency / share
        unwinding.current[:] = unwinding.current_reference
        run(unwinding, 0.02)
        if moves or losses:
            assert bool(np.all(winding.drum_angle > start)) is moves
            assert bool(np.all(unwinding.drum_angle < start)) is moves


def test_current_follows_exponentially_saturates_and_decays() -> None:
    p = plant()
    p.powered[:] = True
    p.current_reference[:] = (1.0, -2.0, 100.0, -100.0, 0.0, 3.0, 4.0, 5.0)
    p.advance(300_000)
    limit = ROBOT.motor.current_limit
    goal = np.clip(p.current_reference, -limit, limit)
    rise = 1.0 - np.exp(-2 * np.pi * LAB.plant.current_loop_hz * 0.3e-3)
    assert p.current == pytest.approx(goal * rise, rel=1e-12)
    run(p, 0.05)
    assert p.current == pytest.approx(goal, rel=1e-9)
    p.powered[:4] = False
    p.advance(p.now_ns + 300_000)
    assert p.current[:4] == pytest.approx(goal[:4] * (1.0 - rise), rel=1e-9)
    assert p.current[5:] == pytest.approx(goal[5:])


def test_a_holding_brake_holds_and_an_unpowered_drum_lets_go() -> None:
    held, free = placed(plant()), placed(plant())
    start = held.drum_angle.copy()
    held.locked[:] = True
    for p in (held, free):
        p.powered[:] = False
        run(p, 2.0)
    assert np.array_equal(held.drum_angle, start)
    assert held.position[2] > -0.01
    assert free.position[2] == pytest.approx(ROBOT.rest[2], abs=0.01)
    assert np.linalg.norm(free.velocity) < 1e-2


def thrown_at(phantom: Phantom) -> tuple[Plant, np.ndarray, np.ndarray]:
    """A loose platform flies into the phantom; push and lagging cell at every tick."""
    p = loose(plant(without_cradle(), phantom=phantom))
    p.position[:] = (-0.03, 0.0, 0.0)
    p.velocity[:] = (0.3, 0.0, 0.0)
    history = []
    for _ in range(1000):
        p.advance(p.now_ns + TICK_NS)
        history.append((float(p.contact_force), p.cell_force[8]))
    pushes, cells = np.array(history).T
    return p, pushes, cells


def test_the_phantom_pushes_only_and_gives_its_momentum_back() -> None:
    p, pushes, cells = thrown_at(KELVIN_VOIGT.model_copy(update={"damping": 0.0}))
    assert np.all(pushes >= 0.0)
    assert pushes[50] == 0.0
    assert pushes[-1] == 0.0
    change = ROBOT.platform.mass * (p.velocity[0] - 0.3)
    assert np.sum(pushes) * 1e-3 == pytest.approx(-change, rel=1e-3)
    assert p.velocity[0] == pytest.approx(-0.3, rel=1e-3)
    peak = 0.3 * np.sqrt(KELVIN_VOIGT.stiffness * ROBOT.platform.mass)
    assert np.max(pushes) == pytest.approx(peak, rel=1e-3)
    assert np.argmax(cells) >= np.argmax(pushes)
    assert np.max(cells) == pytest.approx(peak, rel=1e-2)


@pytest.mark.parametrize("model", ["kelvin_voigt", "standard_linear_solid"])
def test_a_viscoelastic_phantom_keeps_part_of_the_energy(model: str) -> None:
    p, pushes, _ = thrown_at(KELVIN_VOIGT.model_copy(update={"model": model}))
    assert np.all(pushes >= 0.0)
    assert -0.29 < p.velocity[0] < -0.05
    assert p.energy().losses > 0.0
    assert p.energy().balance == pytest.approx(0.5 * ROBOT.platform.mass * 0.3**2, abs=2e-4)


@pytest.mark.parametrize("model", ["kelvin_voigt", "standard_linear_solid"])
def test_in_the_end_only_the_quasi_static_stiffness_carries(model: str) -> None:
    bed = KELVIN_VOIGT.model_copy(update={"model": model, "normal": (0.0, 0.0, 2.0)})
    p = loose(plant(without_cradle(), phantom=bed))
    p.position[:] = 0.0
    run(p, 40.0)
    assert p.contact_penetration == pytest.approx(WEIGHT / bed.stiffness, rel=2e-3)
    assert p.contact_force == pytest.approx(WEIGHT, rel=2e-3)
    assert p.cell_force[8] == pytest.approx(WEIGHT, rel=2e-3)


def test_the_load_port_plays_its_schedule_from_its_start() -> None:
    load = SCENARIO.lab.load
    assert load is not None
    moved = load.model_copy(update={"point": (0.0, 0.05, 0.0), "direction": (2.0, 0.0, 0.0)})
    p = placed(plant(load=moved))
    p.locked[:] = True
    run(p, 0.1)
    assert not p.load_wrench.any()
    p.start_schedule(p.now_ns)
    begun = p.now_ns
    for seconds in (5.0, 7.5, 11.0, 12.0, 14.25, 16.0):
        run(p, seconds - (p.now_ns - begun) * 1e-9)
        wanted = np.interp(seconds, [q.at for q in load.profile], [q.force for q in load.profile])
        assert p.load_wrench[0] == pytest.approx(wanted, abs=1e-6)
        assert p.load_wrench[5] == pytest.approx(-0.05 * wanted, rel=0.05, abs=1e-6)
        if wanted > 50.0:
            assert p.position[0] == pytest.approx(wanted / 8.3e3, rel=0.1)


def test_time_does_not_run_backwards() -> None:
    p = placed(plant(start_ns=5_000_000_000))
    assert p.now_ns == 5_000_000_000
    p.advance(5_001_000_000)
    before = p.state.tobytes()
    p.advance(5_001_000_000)
    p.advance(0)
    assert p.state.tobytes() == before
    assert p.now_ns == 5_001_000_000


def test_mismatch_changes_the_true_robot_only_by_configuration() -> None:
    lab = with_plant(stiffness_scale=1.15, mass_scale=1.1, anchor_sigma=0.002)
    p, other = plant(lab=lab), plant(lab=lab, seed=2)
    record = p.parameters[0]
    assert record["axial_stiffness"] == pytest.approx(1.15 * ROBOT.cable.axial_stiffness)
    assert record["mass"] == pytest.approx(1.1 * ROBOT.platform.mass)
    moved = record["anchors"] - np.array(ROBOT.geometry.frame)
    assert 0.001 < np.std(moved) < 0.003
    assert not np.array_equal(record["anchors"], other.parameters[0]["anchors"])
    nominal = plant().parameters[0]["anchors"]
    assert np.array_equal(nominal, np.array(ROBOT.geometry.frame))
    assert CONFIG.robot.platform.mass == ROBOT.platform.mass
    run(p, 0.1)
    assert p.position == pytest.approx(ROBOT.rest, abs=1e-9)


def test_spreads_are_drawn_evenly_once_per_seed_and_shift_no_other_draw() -> None:
    spread = {"stiffness_spread": 0.15, "mass_spread": 0.2, "friction_spread": 1.0}
    records = [plant(lab=with_plant(**spread), seed=seed).parameters[0] for seed in range(200)]
    nominal = plant().parameters[0]
    for name, bound in (("axial_stiffness", 0.15), ("mass", 0.2), ("coulomb", 1.0)):
        shares = np.array([record[name] for record in records]) / nominal[name] - 1.0
        assert np.max(np.abs(shares)) <= bound
        assert np.std(shares) == pytest.approx(bound / np.sqrt(3.0), rel=0.1)
        assert np.mean(shares) == pytest.approx(0.0, abs=0.1 * bound)
        if shares.ndim == 2:
            assert len(np.unique(shares)) == shares.size
    for seed, record in enumerate(records[:20]):
        alone = plant(lab=with_plant(mass_spread=0.2), seed=seed).parameters[0]
        assert alone["mass"] == record["mass"]
        assert np.array_equal(alone["start_length"], record["start_length"])
        inertia = record["inertia"] / record["mass"]
        assert inertia == pytest.approx(nominal["inertia"] / nominal["mass"])
        friction = record["load_friction"] / record["coulomb"]
        assert friction == pytest.approx(nominal["load_friction"] / nominal["coulomb"])


def test_a_robot_with_a_seed_of_its_own_is_the_same_in_every_run() -> None:
    spread = {"stiffness_spread": 0.15, "mass_spread": 0.2, "anchor_sigma": 0.002}
    of_seven = with_plant(**spread).model_copy(update={"robot_seed": 7})
    first, second = (plant(lab=of_seven, seed=seed).parameters for seed in (1, 2))
    assert first.tobytes() == second.tobytes()
    assert first.tobytes() == plant(lab=with_plant(**spread), seed=7).parameters.tobytes()
    assert first.tobytes() != plant(lab=with_plant(**spread), seed=1).parameters.tobytes()


def test_what_the_wrench_is_asked_changes_nothing() -> None:
    p = placed(plant())
    before = p.state.tobytes()
    p.wrench((0.1, 0.0, 0.0), UPRIGHT)
    p.wrench((0.1, 0.0, 0.0), UPRIGHT, np.full(8, 10.0))
    assert p.state.tobytes() == before
