"""What the drive does by itself, seen on a drum that turns freely."""

from __future__ import annotations

import itertools
from math import sqrt

import numpy as np
import pytest
from one_drive import ENABLE, OneDrive, servo, until

from tonus.sim.devices.cia402.states import State
from tonus.sim.devices.objects import AbortError

PPM, PVM, CSP, CSV, CST = 1, 3, 8, 9, 10
NEW, IMMEDIATELY, RELATIVE, HALT, ENDLESS = 0x10, 0x20, 0x40, 0x100, 0x8000
REACHED, LIMITED, BIT_12 = 0x400, 0x800, 0x1000
REVOLUTION = 4096


def go(bench: OneDrive, target: int, bits: int = 0) -> None:
    """Offer a set-point with bit 4, and take the bit back once it is acknowledged."""
    bench.write(0x607A, 0, target)
    bench.drive.controlword(ENABLE | NEW | bits)
    bench.drive.controlword(ENABLE | bits & ~NEW)


def test_a_profile_position_move_takes_the_trapezoids_time_and_ends_in_the_window() -> None:
    bench = servo(PPM)
    speed, ramp, distance = 1000.0, 5000.0, 40000
    bench.write(0x6081, 0, int(speed))
    bench.write(0x6083, 0, int(ramp))
    bench.write(0x6084, 0, int(ramp))
    go(bench, distance)
    fastest = 0.0
    started = bench.lab.now_ns
    while not bench.word & REACHED:
        bench.wait(1)
        fastest = max(fastest, bench.rpm)
        assert bench.lab.now_ns - started < 5e9
    # By the textbook: revolutions over speed, plus one ramp.
    seconds = distance / REVOLUTION / (speed / 60.0) + speed / ramp
    assert (bench.lab.now_ns - started) * 1e-9 == pytest.approx(seconds, abs=0.08)
    assert fastest == pytest.approx(speed, rel=0.1)
    assert bench.read(0x6064) == pytest.approx(distance, abs=60)
    assert bench.read(0x6062) == distance


def test_a_short_move_never_reaches_its_speed_and_does_not_overshoot_its_demand() -> None:
    bench = servo(PPM)
    go(bench, 500)
    demands, speeds = [], []
    for _ in range(300):
        bench.wait(1)
        demands.append(bench.read(0x6062))
        speeds.append(bench.read(0x606B))
    assert max(demands) == demands[-1] == 500
    # The triangle's top, sqrt(a d), with 10,000 rpm/s.
    assert max(speeds) == pytest.approx(sqrt(10000 * 60 * 500 / REVOLUTION), rel=0.03)


def test_a_set_point_is_acknowledged_until_bit_4_falls() -> None:
    bench = servo(PPM)
    bench.write(0x607A, 0, 20000)
    bench.drive.controlword(ENABLE | NEW)
    assert bench.word & BIT_12
    bench.drive.controlword(ENABLE)
    assert not bench.word & BIT_12
    assert not bench.word & REACHED


def test_one_set_point_waits_behind_the_one_on_its_way() -> None:
    bench = servo(PPM)
    go(bench, 8000)
    go(bench, 4000)
    assert bench.word & BIT_12, "the place behind is taken"
    go(bench, 1000)
    bench.wait(40)
    highest = 0
    while not bench.word & REACHED:
        bench.wait(1)
        highest = max(highest, bench.read(0x6062))
    assert highest == 8000, "the first was gone to"
    assert bench.read(0x6062) == 4000, "the third found no room"
    assert not bench.word & BIT_12


def test_change_immediately_leaves_the_old_target() -> None:
    bench = servo(PPM)
    go(bench, 40000)
    bench.wait(150)
    go(bench, -5000, IMMEDIATELY)
    until(bench, REACHED)
    assert bench.read(0x6062) == -5000


def test_relative_moves_add_up() -> None:
    bench = servo(PPM)
    for _ in range(3):
        go(bench, 3000, RELATIVE)
        until(bench, REACHED)
    assert bench.read(0x6062) == 9000


def test_halt_stops_and_its_end_goes_on() -> None:
    bench = servo(PPM)
    go(bench, 40000)
    bench.wait(200)
    bench.drive.controlword(ENABLE | HALT)
    assert until(bench, REACHED) < 200
    bench.wait(300)
    assert abs(bench.rpm) < 5.0
    assert bench.read(0x6062) < 30000
    bench.drive.controlword(ENABLE)
    bench.wait(1)
    assert not bench.word & REACHED
    until(bench, REACHED)
    assert bench.read(0x6062) == 40000


def test_endless_movement_goes_on_at_profile_speed() -> None:
    bench = servo(PPM)
    bench.write(0x6081, 0, 300)
    go(bench, -1, ENDLESS)
    bench.wait(2000)
    assert bench.rpm == pytest.approx(-300.0, rel=0.03)


def test_the_following_error_is_a_fault_that_brakes() -> None:
    bench = servo(PPM)
    bench.write(0x6065, 0, 200)
    bench.write(0x3001, 2, 100)
    go(bench, 40000)
    bench.wait(500)
    assert bench.errors == [(0x8611, 0x80)]
    bench.wait(1500)
    assert bench.drive.state is State.FAULT
    assert not bench.powered


def test_a_target_beyond_the_software_limit_is_a_fault() -> None:
    bench = servo(PPM)
    bench.write(0x607D, 1, -1000)
    bench.write(0x607D, 2, 1000)
    go(bench, 500)
    until(bench, REACHED)
    assert not bench.errors
    go(bench, 1001)
    assert bench.errors == [(0x8A82, 0x80)]


@pytest.mark.parametrize("mode", [PVM, CST])
def test_a_motor_that_passes_its_software_limit_is_stopped_once(mode: int) -> None:
    bench = servo(mode)
    bench.write(0x607D, 1, -3000)
    bench.write(0x607D, 2, 3000)
    bench.write(0x60FF, 0, 600)
    bench.drive.target_torque(60)
    bench.wait(1000)
    assert bench.errors == [(0x8A82, 0x80)]
    assert bench.read(0x6064) > 3000
    bench.wait(1000)
    assert bench.reset_fault() is State.SWITCH_ON_DISABLED
    bench.write(0x60FF, 0, -200)
    bench.drive.target_torque(-60)
    bench.enable()
    bench.wait(150)
    assert len(bench.errors) == 2, "back in it may go"
    assert bench.errors[-1] == (0, 0)


@pytest.mark.parametrize("speed", [500, -1200])
def test_profile_velocity_ramps_and_settles(speed: int) -> None:
    bench = servo(PVM)
    bench.write(0x6083, 0, 5000)
    bench.write(0x60FF, 0, speed)
    bench.wait(abs(speed) / 5000 * 500)
    assert bench.read(0x606B) == pytest.approx(speed / 2, rel=0.05), "half-way up the ramp"
    assert not bench.word & REACHED
    until(bench, REACHED)
    bench.wait(400)
    assert bench.read(0x606C) == pytest.approx(speed, abs=2)
    bench.drive.controlword(ENABLE | HALT)
    bench.wait(600)
    assert abs(bench.rpm) < 2.0
    assert bench.word & REACHED


def test_speeds_end_at_the_two_limits() -> None:
    bench = servo(PVM)
    bench.write(0x60FF, 0, 900)
    bench.write(0x607F, 0, 400)
    bench.wait(600)
    assert bench.rpm == pytest.approx(400.0, rel=0.02)
    bench.write(0x6080, 0, 250)
    bench.wait(600)
    assert bench.rpm == pytest.approx(250.0, rel=0.02)


def test_velocity_units_follow_their_prefix() -> None:
    bench = OneDrive()
    bench.write(0x60A9, 0, 0xFDB44700)  # mrpm
    bench.write(0x607F, 0, 5_000_000)
    bench.write(0x6080, 0, 5_000_000)
    bench.enable(CSV)
    bench.write(0x60FF, 0, 300_000)
    bench.wait(800)
    assert bench.rpm == pytest.approx(300.0, rel=0.01)
    assert bench.read(0x606C) == pytest.approx(300_000, rel=0.01)
    with pytest.raises(AbortError):
        bench.write(0x60A9, 0, 0x00B44700)


def test_cyclic_velocity_follows_its_set_points_and_offset() -> None:
    bench = servo(CSV)
    assert bench.word & BIT_12, "it follows the command"
    for n in range(1000):
        wanted = 400 * np.sin(2 * np.pi * n / 1000)
        bench.write(0x60FF, 0, round(wanted))
        bench.wait(1)
        if n > 200:
            assert bench.rpm == pytest.approx(wanted, abs=40.0), "friction at standstill included"
    bench.write(0x60FF, 0, 100)
    bench.write(0x60B1, 0, 50)
    bench.wait(600)
    assert bench.rpm == pytest.approx(150.0, abs=2.0)


def test_cyclic_position_interpolates_between_set_points() -> None:
    steps = {}
    for period in (0, 10):
        bench = servo(CSP)
        bench.write(0x60C2, 1, period)
        demands = []
        for n in range(20):
            bench.write(0x607A, 0, 40 * n)
            bench.drive.received(bench.lab.now_ns)
            for _ in range(10):
                bench.wait(1)
                demands.append(bench.read(0x6062))
        steps[period] = max(b - a for a, b in itertools.pairwise(demands))
        assert demands[-1] == 760
        assert not bench.errors
    assert steps[0] == 40, "held, then a step"
    assert steps[10] in (4, 5), "a straight line"


def test_a_missing_pdo_is_a_time_out_only_with_a_period() -> None:
    for period, errors in ((0, []), (5, [(0x8250, 0x10)])):
        bench = OneDrive()
        bench.write(0x60C2, 1, period)
        bench.enable(CST)
        for _ in range(10):
            bench.drive.received(bench.lab.now_ns)
            bench.wait(5)
        assert not bench.errors, "they came"
        bench.wait(4)
        assert not bench.errors
        bench.wait(2)
        assert bench.errors == errors


def test_torque_mode_leaves_off_driving_at_the_highest_motor_speed() -> None:
    bench = OneDrive()
    bench.write(0x6080, 0, 1000)
    bench.enable(CST)
    bench.drive.target_torque(60)
    bench.wait(1500)
    assert 850.0 < bench.rpm < 1020.0
    assert bench.word & LIMITED
    bench.write(0x6080, 0, 50000)
    bench.wait(1500)
    assert bench.rpm > 1500.0
    assert not bench.word & LIMITED


def test_a_mode_can_change_while_the_drive_runs() -> None:
    bench = servo(CST)
    bench.drive.target_torque(40)
    bench.wait(300)
    bench.write(0x60FF, 0, 200)
    bench.write(0x6060, 0, PVM)
    assert bench.read(0x6061) == PVM
    bench.wait(800)
    assert bench.rpm == pytest.approx(200.0, abs=3.0)


def test_a_mode_that_changes_during_a_stop_does_not_end_the_stop() -> None:
    bench = servo(CST)
    bench.drive.target_torque(60)
    bench.wait(300)
    bench.write(0x605C, 0, 1)
    bench.write(0x60FF, 0, 800)
    bench.drive.controlword(0x07)
    assert bench.drive.enabled, "it slows down first"
    bench.write(0x6060, 0, PVM)
    bench.wait(1500)
    assert bench.drive.state is State.SWITCHED_ON
    assert abs(bench.rpm) < 5.0
