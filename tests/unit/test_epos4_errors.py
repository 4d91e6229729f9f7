"""Every error an EPOS4 can have: register, reaction, history, emergency and the way back."""

from __future__ import annotations

import pytest
from one_drive import OneDrive

from sim.devices.cia402 import State
from sim.devices.epos4_errors import ERRORS
from sim.devices.objects import RANGE, AbortError

CST = 10
REFERENCED, WARNING = 0x8000, 0x0080
# Code, error register, reaction, as the maker's table has them: "D" power off at once, "A" as
# 0x6007 says, "F" as 0x605E says, "W" a warning.
TABLE: dict[tuple[int, ...], tuple[int, str]] = {
    (0x1000, *range(0x1080, 0x1089), 0x1090): (0x01, "D"),
    (0x2310, 0x2320): (0x02, "D"),
    (0x3210, 0x3220, 0x5113): (0x04, "D"),
    (0x4210, 0x4380): (0x08, "D"),
    (0x5280, 0x5281, 0x5282, 0x5480, 0x5481, 0x5482, 0x5483): (0x01, "D"),
    (0x6080, 0x6180, 0x61F0, 0x6380): (0x01, "D"),
    (0x6081,): (0x01, "A"),
    (0x6320,): (0x01, "F"),
    (0x7320, 0x7380, 0x7381, 0x7382, 0x7388, 0x7389, 0x738A): (0x20, "D"),
    (0x738C, 0x738D, 0x7390, 0x7391, 0x7392): (0x20, "D"),
    (0x8110, 0x8111, 0x8120, 0x8130, 0x8150, 0x81FD, 0x81FE, 0x81FF): (0x10, "A"),
    (0x8210, 0x8250, 0x8180, 0x8182, 0x8183, 0x8184, 0x8280, 0x8281): (0x10, "A"),
    (0x8181,): (0x10, "D"),
    (0x8611, 0x8A80, 0x8A81, 0x8A82): (0x80, "F"),
    (0x8A88, 0x8A8B, 0xFF02, 0xFF0B): (0x01, "D"),
    (0x8A8A,): (0x01, "W"),
    (0xFF01,): (0x00, "W"),
    (0xFF10,): (0x20, "F"),
    (*range(0xFF11, 0xFF18), 0xFF19, *range(0xFF20, 0xFF25)): (0x20, "D"),
}
CODES = {code: row for codes, row in TABLE.items() for code in codes}
NEEDS_COMMUNICATION_RESET = {0x8120, 0x8130}
NEEDS_DEVICE_RESET = {*range(0x1080, 0x1089), *range(0x5280, 0x5283), *range(0x5480, 0x5484)}
LOSES_POSITION = {0x7380, 0x7381, 0x7382, 0x7388, 0x7389, 0x738A, 0x7392, 0xFF02}


def running() -> OneDrive:
    bench = OneDrive()
    bench.write(0x6098, 0, 37)
    bench.enable(6)
    bench.drive.controlword(0x1F)
    assert bench.word & REFERENCED
    bench.drive.controlword(0x0F)
    bench.write(0x6060, 0, CST)
    bench.drive.target_torque(60)
    bench.wait(200)
    return bench


@pytest.fixture(scope="module")
def shared() -> OneDrive:
    """One lab for the many codes; every case leaves it as `running` made it."""
    return running()


def test_the_table_is_the_whole_table() -> None:
    assert set(CODES) == set(ERRORS)
    with pytest.raises(KeyError):
        OneDrive().drive.fail(0x1234)


@pytest.mark.parametrize("code", sorted(CODES), ids=lambda code: f"{code:04X}")
def test_an_error_shows_reacts_and_can_be_reset(shared: OneDrive, code: int) -> None:
    bench, (register, reaction) = shared, CODES[code]
    drive = bench.drive
    bench.errors.clear()
    drive.fail(code)
    assert bench.errors == [(code, register)]
    assert bench.read(0x1001) == register
    assert bench.read(0x1003, 1) == code | register << 16
    if reaction == "W":
        assert drive.enabled
        assert bench.word & WARNING
        assert bench.read(0x603F) == 0
    else:
        assert bench.read(0x603F) == code
        ramps = reaction in "AF"
        assert drive.state is (State.FAULT_REACTION_ACTIVE if ramps else State.FAULT)
        assert bench.powered is ramps
        bench.wait(400)
        assert drive.state is State.FAULT
        assert not bench.powered
        if code in NEEDS_COMMUNICATION_RESET:
            assert bench.reset_fault() is State.FAULT
            drive.communication_reset()
        if code in NEEDS_DEVICE_RESET:
            drive.communication_reset()
            assert bench.reset_fault() is State.FAULT
        else:
            assert bench.reset_fault() is State.SWITCH_ON_DISABLED
            assert bench.errors[-1] == (0, 0)
            assert bench.read(0x1001) == bench.read(0x603F) == 0
            assert bench.read(0x1003, 1) == code | register << 16, "the history stays"
            assert bool(bench.word & REFERENCED) is (code not in LOSES_POSITION)
    again = code in NEEDS_DEVICE_RESET or code in LOSES_POSITION or reaction == "W"
    if again:
        drive.reset()
        assert drive.state is State.SWITCH_ON_DISABLED
        assert bench.read(0x1003) == bench.read(0x1001) == 0
        bench.write(0x3001, 5, 71000)
        bench.write(0x6098, 0, 37)
        bench.enable(6)
        drive.controlword(0x1F)
        drive.controlword(0x0F)
        bench.write(0x6060, 0, CST)
    else:
        bench.enable(CST)
    drive.target_torque(61)
    drive.target_torque(60)
    bench.wait(30)


@pytest.mark.parametrize(
    ("index", "option", "code", "ramp"),
    [
        (0x605E, 0, 0x8611, None),
        (0x605E, 1, 0x8611, 0x6084),
        (0x605E, 2, 0x8611, 0x6085),
        (0x6007, 2, 0x8250, None),
        (0x6007, 3, 0x8250, 0x6085),
    ],
)
def test_option_codes_choose_the_ramp(index: int, option: int, code: int, ramp: int | None) -> None:
    bench = running()
    bench.write(0x6084, 0, 1000)
    bench.write(0x6085, 0, 4000)
    bench.write(index, 0, option)
    speed = bench.rpm
    assert speed > 150.0
    bench.drive.fail(code)
    assert bench.powered is (ramp is not None)
    if ramp is not None:
        slowing = bench.read(ramp)
        half = 0.5e3 * speed / slowing
        bench.wait(half)
        assert bench.read(0x606B) == pytest.approx(speed / 2, abs=0.03 * speed)
        bench.wait(half + 400)
        assert not bench.powered
    assert bench.drive.state is State.FAULT


def test_the_history_holds_the_five_newest_and_is_cleared_by_zero() -> None:
    bench = OneDrive()
    codes = [0x2310, 0x4380, 0x7320, 0x8611, 0x8A80, 0x1000]
    for code in codes:
        bench.drive.fail(code)
    assert bench.read(0x1003) == 5
    found = [bench.read(0x1003, n) & 0xFFFF for n in range(1, 6)]
    assert found == codes[:0:-1]
    with pytest.raises(AbortError) as refused:
        bench.write(0x1003, 0, 1)
    assert refused.value.code == RANGE
    bench.write(0x1003, 0, 0)
    assert [bench.read(0x1003, n) for n in range(6)] == [0] * 6
    assert bench.drive.state is State.FAULT


def test_the_overload_warning_goes_with_the_history() -> None:
    bench = OneDrive()
    bench.drive.fail(0xFF01)
    assert bench.word & WARNING
    bench.write(0x1003, 0, 0)
    assert not bench.word & WARNING


def test_the_register_shows_all_errors_that_are_present() -> None:
    bench = OneDrive()
    for code in (0x2310, 0x8611):
        bench.drive.fail(code)
    assert bench.read(0x1001) == 0x82
    assert bench.read(0x603F) == 0x8611
    assert bench.reset_fault() is State.SWITCH_ON_DISABLED
    assert bench.read(0x1001) == 0


@pytest.mark.parametrize(
    ("code", "set_value", "bad", "near", "good"),
    [
        (0x3210, "set_supply", 59.0, 57.0, 55.0),
        (0x3220, "set_supply", 7.5, 8.2, 9.0),
        (0x4210, "set_temperature", 96.0, 90.0, 80.0),
    ],
)
def test_a_value_out_of_range_must_come_back_before_the_reset(
    code: int, set_value: str, bad: float, near: float, good: float
) -> None:
    bench = OneDrive()
    bench.enable(CST)
    change = getattr(bench.drive, set_value)
    change(bad)
    assert [error for error, _ in bench.errors] == [code]
    assert not bench.powered
    change(bad)
    assert len(bench.errors) == 1, "once"
    for value in (bad, near):
        change(value)
        assert bench.reset_fault() is State.FAULT
    change(good)
    assert bench.reset_fault() is State.SWITCH_ON_DISABLED


def test_supply_and_temperature_are_shown() -> None:
    bench = OneDrive()
    bench.drive.set_supply(24.1)
    bench.drive.set_temperature(41.5)
    assert bench.read(0x2200, 1) == 241
    assert bench.read(0x3201, 1) == 415
    assert bench.word & 0x10
    bench.drive.set_supply(1.0)
    assert not bench.word & 0x10, "no voltage"
