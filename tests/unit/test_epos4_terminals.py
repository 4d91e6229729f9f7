"""Wires, brake, heat and memory of an emulated drive."""

from __future__ import annotations

from math import exp

import pytest
from lab_bench import Bench
from one_drive import BRAKE, ENABLE, SHUTDOWN, OneDrive

from tonus.config.schema.axis import Brake
from tonus.sim.devices.cia402.states import State
from tonus.sim.devices.objects import (
    CANNOT_STORE,
    HARDWARE,
    INTERNAL,
    PASSWORD,
    RANGE,
    WRONG_STATE,
    AbortError,
)

CST = 10
LIMITED, REFERENCED = 0x0800, 0x8000
SAVE, LOAD = 0x65766173, 0x64616F6C


@pytest.mark.parametrize(
    ("name", "bit", "code"),
    [("negative_limit", 0, 0x8A80), ("positive_limit", 1, 0x8A81), ("home", 2, None)],
)
def test_switches_show_and_limits_are_errors(name: str, bit: int, code: int | None) -> None:
    bench = OneDrive()
    bench.drive.set_input(name, True)
    assert bench.read(0x60FD) == bench.read(0x3141, 1) == 1 << bit
    assert not bench.errors, "no motion, no error"
    bench.enable(CST)
    assert bench.drive.enabled, "it can be driven off its switch"
    bench.drive.set_input(name, False)
    assert bench.read(0x60FD) == 0
    bench.drive.set_input(name, True)
    assert [error for error, _ in bench.errors] == ([] if code is None else [code])


def test_polarity_and_functions_are_configured() -> None:
    bench = OneDrive()
    bench.write(0x3141, 2, 0x0001)
    assert bench.read(0x60FD) == 1, "an open normally-closed limit"
    bench.write(0x3142, 1, 20)
    assert bench.read(0x60FD) == 1 << 20
    bench.write(0x3142, 1, 255)
    assert bench.read(0x60FD) == 0
    with pytest.raises(AbortError) as refused:
        bench.write(0x3142, 1, 5)
    assert refused.value.code == RANGE


def test_outputs_show_what_their_functions_are_told() -> None:
    bench = OneDrive()
    bench.write(0x60FE, 1, 1 << 17)
    assert bench.read(0x3150, 1) == 0b010
    bench.write(0x3150, 2, 0b011)
    assert bench.read(0x3150, 1) == 0b001


def test_the_quick_stop_input_stops_and_keeps_stopped() -> None:
    bench = OneDrive()
    bench.write(0x3142, 5, 28)
    bench.enable(CST)
    bench.drive.set_input("quick_stop", True)
    assert bench.drive.state is State.QUICK_STOP_ACTIVE
    bench.drive.controlword(ENABLE)
    assert bench.drive.state is State.QUICK_STOP_ACTIVE
    bench.drive.set_input("quick_stop", False)
    bench.drive.controlword(ENABLE)
    assert bench.drive.enabled


def test_the_enable_input_takes_and_grants_power() -> None:
    bench = OneDrive()
    bench.write(0x3142, 6, 27)
    for word in (SHUTDOWN, ENABLE):
        bench.drive.controlword(word)
    assert not bench.powered
    bench.drive.set_input("drive_enable", True)
    bench.enable(CST)
    bench.drive.set_input("drive_enable", False)
    assert bench.drive.state is State.SWITCH_ON_DISABLED
    assert not bench.powered


def test_safe_torque_off_takes_the_power_and_keeps_it() -> None:
    bench = OneDrive()
    bench.enable(CST)
    assert bench.read(0x3202, 1) == 3
    bench.drive.set_input("sto", True)
    assert not bench.powered
    assert bench.read(0x3202, 1) == 0
    assert bench.errors == [(0x8A88, 0x01)]
    assert bench.reset_fault() is State.FAULT, "it is still off"
    bench.drive.set_input("sto", False)
    assert bench.reset_fault() is State.SWITCH_ON_DISABLED
    bench.drive.set_input("sto", True)
    assert len(bench.errors) == 2, "without power it is none"
    for word in (SHUTDOWN, ENABLE):
        bench.drive.controlword(word)
    assert bench.errors[-1] == (0x8A88, 0x01)
    assert bench.drive.state is State.FAULT


def test_a_wire_there_is_not_is_refused() -> None:
    with pytest.raises(KeyError):
        OneDrive().drive.set_input("coffee", True)


# -- holding brake -------------------------------------------------------------------------------


def test_the_brake_opens_before_the_motor_turns_and_closes_before_the_power_goes() -> None:
    bench = OneDrive(brake=Brake(torque=0.4, opening_ms=50.0, closing_ms=30.0))
    locked = bench.lab.plant.locked
    bench.write(0x3158, 1, 50)
    bench.write(0x3158, 2, 30)
    assert locked[0]
    assert bench.read(0x3158, 3) == 1
    bench.enable(CST)
    bench.drive.target_torque(60)
    bench.wait(45)
    assert locked[0]
    assert bench.rpm == 0.0
    bench.wait(10)
    assert not locked[0]
    assert bench.read(0x3158, 3) == 0
    bench.wait(100)
    assert bench.rpm > 50.0
    bench.drive.controlword(0x07)
    bench.wait(500)
    assert bench.drive.state is State.SWITCHED_ON
    bench.drive.controlword(ENABLE)
    bench.wait(60)
    bench.drive.controlword(0x00)
    assert bench.powered, "the motor holds until the brake does"
    bench.wait(25)
    assert not locked[0]
    bench.wait(10)
    assert locked[0]
    assert not bench.powered


def test_an_error_takes_the_power_before_the_brake_has_closed() -> None:
    bench = OneDrive(brake=BRAKE)
    bench.enable(CST)
    bench.wait(20)
    bench.drive.fail(0x2310)
    assert not bench.powered
    assert not bench.lab.plant.locked[0]
    bench.wait(11)
    assert bench.lab.plant.locked[0]


def test_without_a_brake_nothing_is_ever_locked() -> None:
    bench = OneDrive()
    bench.enable(CST)
    bench.drive.fail(0x2310)
    bench.wait(50)
    assert not bench.lab.plant.locked.any()
    assert bench.read(0x3158, 3) == 0


# -- heat ----------------------------------------------------------------------------------------


def test_an_overloaded_motor_falls_back_to_its_nominal_current_without_a_fault() -> None:
    bench = OneDrive()
    bench.lab.plant.locked[0] = True
    for sub, value in ((1, 2000), (2, 6000), (4, 20)):
        bench.write(0x3001, sub, value)
    bench.enable(CST)
    bench.drive.target_torque(3000)
    reference = bench.lab.plant.current_reference
    # First order: nine times the heat of nominal current reaches its level in -tau ln(8/9).
    bench.wait(1e3 * 2.0 * 0.057158)
    assert bench.read(0x3200, 1) == pytest.approx(900 * (1 - exp(-0.057158)), abs=6)
    assert reference[0] == pytest.approx(6.0)
    bench.wait(1e3 * 2.0 * 0.08)
    assert reference[0] == pytest.approx(2.0)
    assert bench.word & LIMITED
    assert bench.drive.enabled
    assert not bench.errors
    bench.drive.target_torque(0)
    bench.wait(200)
    bench.drive.target_torque(3000)
    assert reference[0] == pytest.approx(6.0), "cooled down"


def test_the_power_stage_warms_by_its_own_figures() -> None:
    bench = OneDrive()
    bench.lab.plant.locked[0] = True
    bench.enable(CST)
    bench.write(0x3001, 4, 10000)
    bench.drive.target_torque(2000)
    bench.wait(2000)
    stage = 400 * (1 - exp(-2.0 / 15.0))
    assert bench.read(0x3200, 2) == pytest.approx(stage, abs=2)
    assert bench.read(0x3200, 1) < 2


# -- parameters ----------------------------------------------------------------------------------


def test_saved_parameters_outlive_a_power_cycle_and_the_factorys_come_back() -> None:
    bench = OneDrive()
    bench.write(0x6081, 0, 777)
    bench.write(0x210C, 1, 0xCAFE)
    bench.write(0x607A, 0, 4242)
    bench.drive.power_cycle()
    assert bench.read(0x6081) == 1000, "not saved"
    bench.write(0x6081, 0, 777)
    bench.write(0x210C, 1, 0xCAFE)
    bench.write(0x607A, 0, 4242)
    bench.write(0x1010, 1, SAVE)
    bench.write(0x6081, 0, 888)
    for again in (bench.drive.reset, bench.drive.power_cycle):
        again()
        assert bench.read(0x6081) == 777
        assert bench.read(0x210C, 1) == 0xCAFE
        assert bench.read(0x607A) == 0, "a set-point is no parameter"
    bench.write(0x1011, 1, LOAD)
    assert bench.read(0x6081) == 777, "with the next reset"
    bench.drive.reset()
    assert bench.read(0x6081) == 1000
    assert bench.read(0x1010, 1) == bench.read(0x1011, 1) == 1


@pytest.mark.parametrize("index", [0x1010, 0x1011])
def test_a_wrong_signature_stores_and_restores_nothing(index: int) -> None:
    with pytest.raises(AbortError) as refused:
        OneDrive().write(index, 1, 0x12345678)
    assert refused.value.code == CANNOT_STORE


def test_motor_and_sensors_are_configured_without_power_only() -> None:
    bench = OneDrive()
    bench.write(0x6098, 0, 37)
    bench.enable(6)
    bench.drive.controlword(0x1F)
    assert bench.word & REFERENCED
    for key, value in (((0x3010, 1), 1024), ((0x3001, 3), 7), ((0x6402, 0), 1)):
        with pytest.raises(AbortError) as refused:
            bench.write(*key, value)
        assert refused.value.code == WRONG_STATE
    bench.drive.controlword(0)
    bench.write(0x3001, 3, 7)
    assert bench.word & REFERENCED
    bench.write(0x3010, 1, 1024)
    assert bench.read(0x3000, 5) == 4096
    assert not bench.word & REFERENCED, "another sensor: nobody knows where it is"


def test_objects_that_other_drives_have_are_absent() -> None:
    indices = {index for index, _ in OneDrive().drive.objects.entries}
    absent = {0x6063, 0x6069, 0x6072, 0x6073, 0x6074, 0x6075, 0x6078, 0x6079, 0x607C, 0x607E}
    absent |= {0x605D, 0x6087, 0x608F, 0x6090, 0x6091, 0x6092, 0x60E0, 0x60E1}
    absent |= {*range(0x606D, 0x6071), 0x1006, 0x1007, 0x1019, 0x1012, 0x1013, 0x1015}
    assert not indices & absent


def test_what_cannot_be_stored_or_is_the_makers_own_is_refused() -> None:
    bench = OneDrive()

    def code(index: int, sub: int, value: int) -> int:
        with pytest.raises(AbortError) as refused:
            bench.write(index, sub, value)
        return refused.value.code

    assert code(0x1011, 4, LOAD) == PASSWORD
    assert code(0x3000, 1, 0x00100005) == INTERNAL
    bench.drive.fail(0x6380)
    assert code(0x1010, 1, SAVE) == HARDWARE
    assert bench.reset_fault() is State.SWITCH_ON_DISABLED
    bench.write(0x1010, 1, SAVE)
    bench.drive.set_supply(5.0)
    assert code(0x1010, 1, SAVE) == HARDWARE


def test_a_node_keeps_what_was_saved_of_its_bus_over_an_nmt_reset() -> None:
    kept = ((0x1029, 1, 1, 1), (0x1017, 0, 250, 2), (0x1400, 2, 1, 1), (0x2001, 0, 2, 1))
    with Bench() as bench:
        for index, sub, value, size in kept:
            assert bench.write("can0", 1, index, sub, value, size) == 0
        assert bench.upload("can0", 1, 0x200A, 0) == b"\x00", "a bit rate counts from the restart"
        assert bench.write("can0", 1, 0x1010, 1, SAVE, 4) == 0
        for word in (b"\x82\x01", b"\x81\x01"):
            assert bench.write("can0", 1, 0x1017, 0, 0, 2) == 0
            bench.send("can0", 0x000, word)
            bench.wait(5)
            for index, sub, value, size in kept:
                assert bench.upload("can0", 1, index, sub) == value.to_bytes(size, "little")
        assert bench.upload("can0", 1, 0x200A, 0) == b"\x02"
        assert bench.write("can0", 1, 0x1011, 1, LOAD, 4) == 0
        bench.send("can0", 0x000, b"\x81\x01")
        bench.wait(5)
        assert bench.upload("can0", 1, 0x1029, 1) == b"\x00"
        assert bench.upload("can0", 1, 0x1400, 2) == b"\xff"
