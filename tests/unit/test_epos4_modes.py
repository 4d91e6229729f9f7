"""What the drive does by itself, seen on a drum that turns freely."""

from __future__ import annotations

import itertools
from math import sqrt

import numpy as np
import pytest
from one_drive import ENABLE, OneDrive

from sim.devices.cia402 import State
from sim.devices.objects import RANGE, AbortError

PPM, PVM, HMM, CSP, CSV, CST = 1, 3, 6, 8, 9, 10
NEW, IMMEDIATELY, RELATIVE, HALT, ENDLESS = 0x10, 0x20, 0x40, 0x100, 0x8000
REACHED, LIMITED, BIT_12, BIT_13, REFERENCED = 0x400, 0x800, 0x1000, 0x2000, 0x8000
REVOLUTION = 4096


def servo(mode: int) -> OneDrive:
    bench = OneDrive()
    bench.write(0x6065, 0, 0xFFFFFFFF)
    bench.write(0x6067, 0, 60)
    bench.write(0x6068, 0, 5)
    bench.enable(mode)
    return bench


def go(bench: OneDrive, target: int, bits: int = 0) -> None:
    """Offer a set-point with bit 4, and take the bit back once it is acknowledged."""
    bench.write(0x607A, 0, target)
    bench.drive.controlword(ENABLE | NEW | bits)
    bench.drive.controlword(ENABLE | bits & ~NEW)


def until(bench: OneDrive, bit: int, within_ms: float = 5000.0) -> float:
    """ms until a statusword bit is set."""
    for passed in range(round(within_ms)):
        if bench.word & bit:
            return passed
        bench.wait(1)
    raise AssertionError(f"bit 0x{bit:04X} did not come")


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


# -- homing --------------------------------------------------------------------------------------


def test_method_37_names_the_present_position() -> None:
    bench = servo(HMM)
    bench.write(0x6098, 0, 37)
    bench.write(0x30B0, 0, 12345)
    bench.drive.controlword(ENABLE | NEW)
    assert bench.read(0x6064) == 12345
    assert bench.word & (BIT_12 | BIT_13 | REACHED) == BIT_12 | REACHED
    assert bench.word & REFERENCED


def test_method_35_is_refused() -> None:
    with pytest.raises(AbortError) as refused:
        OneDrive().write(0x6098, 0, 35)
    assert refused.value.code == RANGE


NEGATIVE, HOME, POSITIVE = -5000, (2000, 4000), 8000
"""Where the switches act, in increments from where the drive starts."""


def home(method: int, start: int = 0) -> tuple[OneDrive, float]:
    """Run a method among the switches; the encoder's count where home was found."""
    bench = servo(HMM)
    per_radian = bench.lab.samples.per_radian
    begin = float(bench.lab.plant.motor_angle[0]) * per_radian - start
    for sub, speed in ((1, 400), (2, 120)):
        bench.write(0x6099, sub, speed)
    bench.write(0x6098, 0, method)

    def place() -> float:
        return float(bench.lab.plant.motor_angle[0]) * per_radian - begin

    def switches() -> None:
        at = place()
        bench.drive.set_input("negative_limit", at <= NEGATIVE)
        bench.drive.set_input("positive_limit", at >= POSITIVE)
        bench.drive.set_input("home", HOME[0] <= at <= HOME[1])

    switches()
    bench.drive.controlword(ENABLE | NEW)
    for _ in range(20000):
        if bench.word & BIT_12:
            break
        assert bench.word & BIT_13 == 0
        bench.wait(0.4)
        switches()
    assert bench.word & REFERENCED, "home was not found"
    bench.wait(300)
    assert not bench.errors, "a switch that homing goes to is no error"
    # What the drive calls 0 is `place() - position` from where it started.
    return bench, place() - bench.read(0x6064)


@pytest.mark.parametrize(
    ("method", "edge", "start"),
    [
        (17, NEGATIVE, 0),
        (18, POSITIVE, 0),
        (23, HOME[0], 0),
        (23, HOME[0], 3000),
        (23, HOME[0], 6000),
        (27, HOME[1], 6000),
        (27, HOME[1], 3000),
        (27, HOME[1], 0),
    ],
)
def test_homing_finds_the_edge_of_its_switch(method: int, edge: int, start: int) -> None:
    bench, zero = home(method, start)
    # Found within a loop and a look at the wires, 0.4 ms each, at 400 rpm or less.
    assert zero == pytest.approx(edge, abs=22)
    assert abs(bench.rpm) < 3.0


@pytest.mark.parametrize(
    ("method", "side", "edge"),
    [(1, 1, NEGATIVE), (2, -1, POSITIVE), (7, -1, HOME[0]), (11, 1, HOME[1])],
)
def test_homing_goes_on_to_the_next_index_pulse(method: int, side: int, edge: int) -> None:
    bench, zero = home(method, 6000 if method == 11 else 0)
    assert 0 <= side * (zero - edge) <= REVOLUTION + 22
    count = bench.lab.samples.count(0) - bench.read(0x6064)
    off = (count + REVOLUTION // 2) % REVOLUTION - REVOLUTION // 2
    assert abs(off) <= 4, "an index pulse is at every whole revolution"


@pytest.mark.parametrize(("method", "side"), [(33, -1), (34, 1)])
def test_homing_on_the_index_pulse_alone(method: int, side: int) -> None:
    bench, zero = home(method)
    assert 0 <= side * zero <= REVOLUTION + 4
    count = bench.lab.samples.count(0) - bench.read(0x6064)
    assert abs((count + REVOLUTION // 2) % REVOLUTION - REVOLUTION // 2) <= 4


@pytest.mark.parametrize(("method", "side"), [(-3, 1), (-4, -1)])
def test_homing_against_a_stop_ends_where_the_current_rises(method: int, side: int) -> None:
    bench = servo(HMM)
    bench.write(0x6098, 0, method)
    bench.write(0x30B2, 0, 1500)
    bench.drive.controlword(ENABLE | NEW)
    bench.wait(600)
    assert bench.rpm * side > 50.0
    assert not bench.word & BIT_12
    bench.lab.plant.locked[0] = True
    until(bench, BIT_12)
    assert abs(bench.read(0x6064)) < 10


def test_the_home_offset_is_moved_before_home_is_named() -> None:
    bench = servo(HMM)
    bench.write(0x6099, 2, 60)
    bench.write(0x30B1, 0, 2000)
    bench.write(0x30B0, 0, 500)
    bench.write(0x6098, 0, 34)
    before = bench.lab.samples.count(0)
    bench.drive.controlword(ENABLE | NEW)
    until(bench, BIT_12)
    bench.wait(300)
    assert bench.read(0x6064) == pytest.approx(500, abs=40)
    away = bench.lab.samples.count(0) - before
    assert 2000 <= away + 40 <= REVOLUTION + 2100


def test_homing_halts_and_can_be_left() -> None:
    bench = servo(HMM)
    bench.write(0x6098, 0, 17)
    bench.drive.controlword(ENABLE | NEW)
    bench.wait(300)
    assert bench.word & (BIT_12 | BIT_13 | REACHED) == 0, "on its way"
    bench.drive.controlword(ENABLE | NEW | HALT)
    bench.wait(300)
    assert bench.word & (BIT_12 | REACHED) == REACHED, "interrupted"
    assert abs(bench.rpm) < 3.0
    bench.drive.controlword(ENABLE | NEW)
    bench.wait(300)
    assert bench.rpm < -50.0
    bench.drive.controlword(ENABLE)
    bench.wait(300)
    assert abs(bench.rpm) < 3.0
