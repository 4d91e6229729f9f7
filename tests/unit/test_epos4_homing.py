"""Homing among switches, index pulses and stops, seen on a drum that turns freely."""

from __future__ import annotations

import pytest
from one_drive import ENABLE, OneDrive, servo, until

from tonus.sim.devices.objects import RANGE, AbortError

HMM = 6
NEW, HALT = 0x10, 0x100
REACHED, BIT_12, BIT_13, REFERENCED = 0x400, 0x1000, 0x2000, 0x8000
REVOLUTION = 4096


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
    per_radian = bench.lab.samples.per_radian[0]
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


@pytest.mark.parametrize(("method", "side"), [(-1, 1), (-2, -1)])
def test_homing_against_a_stop_goes_back_to_an_index_pulse(method: int, side: int) -> None:
    bench = servo(HMM)
    bench.write(0x6098, 0, method)
    bench.write(0x6099, 2, 120)
    bench.write(0x30B2, 0, 1500)
    bench.drive.controlword(ENABLE | NEW)
    bench.wait(400)
    bench.lab.plant.locked[0] = True
    stop = bench.lab.samples.count(0)
    while bench.lab.plant.current_reference[0] * side >= 0.0:
        bench.wait(1)
        assert bench.lab.now_ns < 10e9
    bench.lab.plant.locked[0] = False
    until(bench, BIT_12)
    zero = bench.lab.samples.count(0) - bench.read(0x6064)
    assert 0 <= -side * (zero - stop) <= REVOLUTION + 22
    assert abs((zero + REVOLUTION // 2) % REVOLUTION - REVOLUTION // 2) <= 4


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
