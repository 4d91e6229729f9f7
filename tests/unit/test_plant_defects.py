"""What is broken on purpose, against physics: what it does, and where its energy goes."""

from __future__ import annotations

import numpy as np
import pytest
from plant_setup import (
    BACKLASH,
    KELVIN_VOIGT,
    ROBOT,
    STIFFENING,
    TICK_NS,
    frictionless,
    placed,
    plant,
    run,
    undamped,
    with_plant,
)

from tonus.sim.plant import Plant

RADIUS = ROBOT.drum.radius
RATIO = ROBOT.gearbox.ratio
PORT = KELVIN_VOIGT.model_copy(update={"point": (0.01, 0.0, 0.0)})
"""a phantom 10 mm in front of the port"""


def held(p: Plant) -> Plant:
    """In equilibrium, drums held."""
    placed(p)
    p.locked[:] = True
    run(p, 0.2)
    return p


def balanced_through(p: Plant, seconds: float) -> float:
    """Worst error (J) of the balance on the way, and no step in which losses shrink."""
    start, last, worst = p.energy().balance, float(p.losses), 0.0
    for _ in range(round(seconds * 4000)):
        p.advance(p.now_ns + TICK_NS // 4)
        assert p.losses >= last
        last = float(p.losses)
        worst = max(worst, abs(p.energy().balance - start))
    return worst


def unstretched(p: Plant, axis: int) -> float:
    """m, between drum and platform, from the cable's tension and length."""
    return float(p.cable_lengths()[axis] / (1.0 + p.tension[axis] / ROBOT.cable.axial_stiffness))


def test_nothing_broken_changes_nothing() -> None:
    plants = [placed(plant()) for _ in range(2)]
    axis = 3
    plants[1].defects.weaken_motor(axis, 0.5)()
    plants[1].defects.scale_cell(axis, 2.0)()
    plants[1].defects.offset_cell(axis, 2.0)()
    plants[1].defects.rub_drum(axis, 5.0)()
    plants[1].defects.jam_drum(axis)()
    plants[1].defects.freeze_cell(axis)()
    plants[1].defects.freeze_encoder(axis)()
    for p in plants:
        p.velocity[:] = (0.05, 0.0, 0.02)
        run(p, 0.2)
    assert plants[0].state.tobytes() == plants[1].state.tobytes()


def test_a_cut_cable_is_told_by_the_truth() -> None:
    p = placed(plant())
    p.cut_cable(2)
    run(p, 0.01)
    assert p.cut.tolist() == [0, 0, 1, 0, 0, 0, 0, 0]
    assert p.tension[2] == 0.0


@pytest.mark.parametrize("length", [0.004, -0.004])
@pytest.mark.parametrize("stiffening", [None, STIFFENING])
def test_cable_slips_on_its_drum(length: float, stiffening: object) -> None:
    p = held(plant(lab=with_plant(stiffening=stiffening)))
    axis = 4
    before, angle = unstretched(p, axis), float(p.motor_angle[axis])
    loose = float(p.parameters["start_length"][0, axis])
    start = p.energy()
    p.defects.slip_drum(axis, length, 0.05)
    worst = balanced_through(p, 0.0333333)
    assert p.state["slipped"][0, axis] == pytest.approx(length * 2.0 / 3.0, rel=0.01)
    worst = max(worst, balanced_through(p, 0.3))
    assert worst < 2e-4
    assert p.state["slipped"][0, axis] == pytest.approx(length, rel=1e-9)
    assert p.parameters["start_length"][0, axis] == loose
    assert p.motor_angle[axis] == angle, "the encoder does not see it"
    if stiffening is None:
        assert unstretched(p, axis) - before == pytest.approx(length, rel=0.01)
    # The cable's tension, which changes on the way, times the length is what friction or fault do.
    end = p.energy()
    heat, work = end.friction_losses - start.friction_losses, end.input_work - start.input_work
    force = (heat if length > 0.0 else work) / abs(length)
    low, high = sorted((45.0, float(p.tension[axis])))
    assert low - 5.0 < force < high + 5.0
    assert (work if length > 0.0 else heat) == pytest.approx(0.0, abs=1e-9)


def test_a_jammed_drum_stands_and_then_turns_again() -> None:
    p = placed(plant())
    release = p.defects.jam_drum(0)
    p.current_reference[:] *= 1.6
    run(p, 0.1)
    assert p.drum_rate[0] == 0.0
    assert abs(p.drum_rate[1]) > 0.0
    angle = p.drum_angle[0]
    release()
    run(p, 0.1)
    assert p.drum_angle[0] > angle


def test_a_jammed_drum_stands_behind_its_play() -> None:
    p = placed(plant(lab=with_plant(backlash=BACKLASH)))
    p.defects.jam_drum(0)
    angle, motor = float(p.drum_angle[0]), float(p.motor_angle[0])
    p.current_reference[0] = -2.0
    run(p, 0.2)
    assert p.drum_angle[0] == angle
    assert p.motor_angle[0] < motor


def test_a_turning_drum_that_jams_loses_its_energy() -> None:
    p = placed(plant())
    p.current_reference[:] *= 1.6
    run(p, 0.1)
    p.defects.jam_drum(0)
    assert balanced_through(p, 0.2) < 0.02 * p.energy().losses


@pytest.mark.parametrize("over", [0.0, 0.2])
def test_friction_grows_by_its_force(over: float) -> None:
    """What a drum holds against the cable without a motor: its own friction and the added one."""
    p = held(plant(undamped(), frictionless()))
    axis = 2
    p.current_reference[:] = 0.0
    end = p.defects.rub_drum(axis, 80.0, over)
    run(p, 0.5 * over)
    at = float(p.parameters["coulomb"][0, axis]) / RADIUS
    assert at == pytest.approx(40.0 if over else 80.0, abs=0.5)
    run(p, 0.6 * over + 0.05)
    p.locked[axis] = False
    angle = float(p.drum_angle[axis])
    assert balanced_through(p, 0.1) < 1e-4
    assert p.drum_angle[axis] == angle, "80 N hold 45 N"
    end()
    run(p, 0.1)
    assert p.drum_angle[axis] < angle - 0.1


@pytest.mark.parametrize("gain", [0.5, 0.0, -1.0])
def test_a_weak_motor_gives_its_share(gain: float) -> None:
    p = plant(undamped(), frictionless())
    p.powered[:] = True
    p.parameters["start_length"] += 10.0
    p.current_reference[:] = 1.0
    end = p.defects.weaken_motor(5, gain)
    run(p, 0.1)
    assert p.drum_rate[5] == pytest.approx(gain * p.drum_rate[4], rel=1e-9, abs=1e-12)
    whole = ROBOT.motor.torque_constant * RATIO
    start = p.energy().input_work
    power = whole * float(np.sum(p.drum_rate * p.current * np.where(np.arange(8) == 5, gain, 1.0)))
    p.advance(p.now_ns + TICK_NS)
    assert p.energy().input_work - start == pytest.approx(power * 1e-3, rel=0.02)
    end()
    rate = float(p.drum_rate[5])
    run(p, 0.1)
    assert p.drum_rate[5] - rate == pytest.approx(p.drum_rate[4] * 0.5, rel=0.05)


def test_a_cell_of_wrong_gain_and_offset_shows_them_and_the_robot_is_not_moved() -> None:
    broken, sound = held(plant()), held(plant())
    cell = 6
    ends = [broken.defects.scale_cell(cell, 1.5, 0.1), broken.defects.offset_cell(cell, -7.0, 0.1)]
    for seconds, share in ((0.05, 0.5), (0.1, 1.0)):
        for p in (broken, sound):
            run(p, seconds)
        expected = sound.cell_force[cell] * (1.0 + 0.5 * share) - 7.0 * share
        assert broken.cell_force[cell] == pytest.approx(expected, rel=1e-9)
    assert broken.truth.tobytes() == sound.truth.tobytes()
    for end in ends:
        end()
    for p in (broken, sound):
        run(p, 0.001)
    assert broken.cell_force.tobytes() == sound.cell_force.tobytes()


def test_a_frozen_cell_shows_what_it_showed() -> None:
    p = held(plant(phantom=PORT))
    thaw = p.defects.freeze_cell(8)
    p.defects.hit(0.02, 0.1)
    run(p, 0.5)
    assert p.contact_force > 1.0
    assert p.cell_force[8] == 0.0
    thaw()
    run(p, 0.001)
    assert p.cell_force[8] == pytest.approx(float(p.contact_force), rel=1e-3)


@pytest.mark.parametrize("backlash", [None, BACKLASH])
def test_an_encoder_that_slips_is_off_by_its_angle(backlash: object) -> None:
    p = placed(plant(lab=with_plant(backlash=backlash)))
    inside = p.state["rotor_angle" if backlash else "drum_angle"][0]
    p.defects.slip_encoder(1, 0.3, 0.1)
    run(p, 0.05)
    assert p.motor_angle[1] / RATIO - inside[1] == pytest.approx(0.15, rel=1e-6)
    run(p, 0.1)
    p.defects.slip_encoder(1, -0.1)
    run(p, 0.01)
    assert p.motor_angle[1] / RATIO - inside[1] == pytest.approx(0.2, rel=1e-6)
    assert p.motor_angle[0] / RATIO == pytest.approx(inside[0], rel=1e-12)


def test_a_frozen_encoder_never_counts_what_it_missed() -> None:
    p = placed(plant())
    p.current_reference[:] *= 1.6
    run(p, 0.02)
    thaw = p.defects.freeze_encoder(0)
    shown, angle = float(p.motor_angle[0]), float(p.drum_angle[0])
    run(p, 0.05)
    missed = float(p.drum_angle[0]) - angle
    assert missed > 0.01
    assert p.motor_angle[0] == shown
    assert p.motor_rate[0] == 0.0
    thaw()
    run(p, 0.001)
    assert abs(p.motor_angle[0] - shown) < 0.2
    run(p, 0.05)
    assert p.drum_angle[0] - p.motor_angle[0] / RATIO == pytest.approx(missed, rel=1e-9)


def test_a_phantom_hits_the_port_and_withdraws() -> None:
    p = held(plant(phantom=PORT))
    start = p.energy()
    withdraw = p.defects.hit(0.03, 0.2)
    assert balanced_through(p, 0.15) < 2e-5
    assert p.state["contact_shift"][0] == pytest.approx(0.03, rel=1e-9)
    run(p, 3.0)
    # 20 mm of it are beyond the port, which gives way as the cables do.
    depth = 0.03 - 0.01 - (-p.position[0])
    assert p.contact_penetration == pytest.approx(depth, rel=1e-6)
    assert p.contact_force == pytest.approx(KELVIN_VOIGT.stiffness * depth, rel=1e-3)
    assert p.energy().load_work - start.load_work > 0.5 * p.contact_force * depth
    withdraw()
    assert balanced_through(p, 0.3) < 1e-4
    assert p.state["contact_shift"][0] == pytest.approx(0.0, abs=1e-12)
    assert p.contact_force == 0.0


def test_a_push_is_a_load() -> None:
    p = held(plant())
    start = p.energy()
    force, point = np.array([5.0, 0.0, -10.0]), (0.0, 0.1, 0.0)
    let_go = p.defects.push(force, point, 0.1)
    assert balanced_through(p, 0.05) < 1e-4
    assert p.load_wrench[:3] == pytest.approx(0.5 * force, rel=0.02)
    run(p, 0.5)
    assert p.load_wrench[:3] == pytest.approx(force, rel=1e-12)
    assert p.load_wrench[3:] == pytest.approx(np.cross(point, force), rel=0.05, abs=0.01)
    work = p.energy().load_work - start.load_work
    assert work > 0.0
    let_go()
    assert balanced_through(p, 0.3) < 1e-4
    assert not p.load_wrench.any()
    run(p, 1.0)
    assert p.energy().total == pytest.approx(start.total, abs=1e-3)


def test_equal_calls_break_equally_and_other_instants_nearly() -> None:
    def broken(step_ns: int) -> Plant:
        p = placed(plant(phantom=PORT))
        p.defects.slip_drum(0, 0.003, 0.0303)
        p.defects.push((3.0, 0.0, 0.0), rise=0.02)
        p.defects.hit(0.02, 0.5)
        p.defects.slip_encoder(3, 0.1, 0.033)
        for _ in range(60_000_000 // step_ns):
            p.advance(p.now_ns + step_ns)
        return p

    first = broken(1_000_000)
    assert first.state.tobytes() == broken(1_000_000).state.tobytes()
    finely = broken(250_000)
    assert first.position == pytest.approx(finely.position, abs=2e-6)
    assert first.motor_angle == pytest.approx(finely.motor_angle, abs=1e-3)


@pytest.mark.parametrize("powered", [False, True])
def test_a_platform_that_is_put_back_lies_as_at_the_start(powered: bool) -> None:
    """In its cups, with every cable as slack as before; a person neither gives nor takes power."""
    p, fresh = plant(), plant()
    slack = fresh.parameters["start_length"][0] - fresh.cable_lengths()
    placed(p)
    run(p, 0.05)
    p.cut_cable(2)
    p.powered[:] = powered
    run(p, 0.3)
    p.put_back()
    assert p.position == pytest.approx(ROBOT.rest)
    assert p.quaternion == pytest.approx((1.0, 0.0, 0.0, 0.0))
    assert (p.powered == powered).all()
    free = p.parameters["start_length"][0] - RADIUS * p.drum_angle - p.state["slipped"][0]
    assert free - p.cable_lengths() == pytest.approx(slack, abs=1e-9)
    if not powered:
        run(p, 0.3)
        assert np.linalg.norm(p.position - np.array(ROBOT.rest)) < 1e-3
        assert p.tension.max() == 0.0
