"""python-canopen hears our drives' emergencies, each with its register, and their end."""

from __future__ import annotations

from pathlib import Path

import pytest
from canopen_client import CST, Drive, eventually
from door_client import inject

pytestmark = pytest.mark.realtime

# Code and error register, from the maker's table; python-canopen knows the codes' families only.
ERRORS = {
    0x1000: 0x01,
    0x2310: 0x02,
    0x2320: 0x02,
    0x6180: 0x01,
    0x6320: 0x01,
    0x6380: 0x01,
    0x7320: 0x20,
    0x7388: 0x20,
    0x738C: 0x20,
    0x7390: 0x20,
    0x8110: 0x10,
    0x8111: 0x10,
    0x8150: 0x10,
    0x81FE: 0x10,
    0x8210: 0x10,
    0x8250: 0x10,
    0x8611: 0x80,
    0xFF0B: 0x01,
    0xFF10: 0x20,
}
FAMILIES = {
    0x1000: "Generic Error",
    0x2310: "Current",
    0x6320: "Device Software",
    0x8611: "Monitoring",
    0xFF0B: "Device Specific",
}


def in_fault(drive: Drive) -> bool:
    return drive.number(0x6041) & 0x4F == 0x08


def reset_fault(drive: Drive) -> None:
    drive.sdo[0x6040].raw = 0x00
    drive.sdo[0x6040].raw = 0x80


def test_the_errors_are_many() -> None:
    assert len(ERRORS) >= 15


@pytest.mark.parametrize("code", ERRORS, ids=lambda code: f"{code:04X}")
def test_an_error_is_told_kept_and_reset(drive: Drive, lab: Path, code: int) -> None:
    drive.op_mode = CST
    drive.state = "OPERATION ENABLED"
    inject(lab, "drive_error", channel="can0", node=1, code=code)
    told, register = drive.emergency()
    assert told == code
    assert register & ~0x01 == ERRORS[code] & ~0x01  # whether bit 0 goes along is open
    assert register & ERRORS[code] == ERRORS[code]
    assert [entry.code for entry in drive.emcy.active] == [code]
    if code in FAMILIES:
        assert drive.emcy.active[0].get_desc() == FAMILIES[code]
    assert drive.number(0x603F) == code
    assert drive.number(0x1001) == register
    assert drive.number(0x1003, 0) == 1
    assert drive.number(0x1003, 1) & 0xFFFF == code
    assert eventually(lambda: in_fault(drive))
    reset_fault(drive)
    assert drive.emergency() == (0, 0)
    assert drive.emcy.active == []
    assert drive.number(0x6041) & 0x6F == 0x40
    assert drive.number(0x603F) == 0
    assert drive.number(0x1001) == 0
    assert drive.number(0x1003, 1) & 0xFFFF == code  # the history stays
    drive.sdo[0x1003][0].raw = 0
    assert drive.number(0x1003, 0) == 0


def test_the_history_keeps_five_newest_first(drive: Drive, lab: Path) -> None:
    codes = [0x2310, 0x7320, 0x8611, 0x8250, 0x6180, 0xFF0B]
    for number, code in enumerate(codes, start=1):
        inject(lab, "drive_error", channel="can0", node=1, code=code)
        assert drive.emergency()[0] == code
        assert drive.number(0x1003, 0) == min(number, 5)
    kept = [drive.number(0x1003, place) & 0xFFFF for place in range(1, 6)]
    assert kept == codes[:0:-1]


def test_a_reset_bit_that_is_held_resets_once(drive: Drive, lab: Path) -> None:
    inject(lab, "drive_error", channel="can0", node=1, code=0x2310)
    drive.emergency()
    reset_fault(drive)
    assert drive.emergency() == (0, 0)
    inject(lab, "drive_error", channel="can0", node=1, code=0x2310)
    assert drive.emergency()[0] == 0x2310
    drive.sdo[0x6040].raw = 0x80
    assert in_fault(drive)
    reset_fault(drive)
    assert drive.emergency() == (0, 0)


def test_a_warning_stops_nothing(drive: Drive, lab: Path) -> None:
    drive.op_mode = CST
    drive.state = "OPERATION ENABLED"
    inject(lab, "drive_error", channel="can0", node=1, code=0xFF01)
    assert drive.emergency()[0] == 0xFF01
    assert drive.number(0x6041) & 0xEF == 0xA7  # enabled, with the warning bit
    assert drive.number(0x1003, 1) & 0xFFFF == 0xFF01


def test_a_defect_outlives_a_fault_reset(drive: Drive, lab: Path) -> None:
    """Only a reset of the device mends it."""
    inject(lab, "drive_error", channel="can0", node=1, code=0x5280)
    assert drive.emergency()[0] == 0x5280
    reset_fault(drive)
    assert in_fault(drive)
    drive.reset()
    assert not in_fault(drive)


def test_a_lost_bus_needs_its_reset_first(drive: Drive, lab: Path) -> None:
    inject(lab, "drive_error", channel="can0", node=1, code=0x8120)
    assert drive.emergency() == (0x8120, 0x10)
    reset_fault(drive)
    assert in_fault(drive)
    drive.command("RESET COMMUNICATION")
    reset_fault(drive)
    assert drive.emergency() == (0, 0)
    assert not in_fault(drive)
