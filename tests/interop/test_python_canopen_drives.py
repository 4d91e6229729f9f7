"""python-canopen's CiA 402 profile brings our drives to work, and drives them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import canopen
import pytest
from canopen_client import CST, Drive, Networks, eventually
from door_client import inject
from running_lab import DRIVES

pytestmark = pytest.mark.realtime

PERIOD = 0.01
TORQUE_CONSTANT = 71_000
"""uNm/A"""


def enabled(drive: Drive) -> bool:
    return drive.number(0x6041) & 0x6F == 0x27


@contextmanager
def exchanging(drives: list[Drive]) -> Iterator[None]:
    """In cyclic synchronous torque and operational, exchanging PDOs by SYNC."""
    networks = {id(drive.network): drive.network for drive in drives}.values()
    for drive in drives:
        drive.sdo[0x3001][5].raw = TORQUE_CONSTANT
        drive.op_mode = CST
        drive.map_torque(transmission=1)
    for network in networks:
        network.sync.start(PERIOD)
    for drive in drives:
        drive.rpdo[1].start(PERIOD)
        drive.command("OPERATIONAL")
    yield
    for network in networks:
        network.sync.stop()


@pytest.fixture
def drives(networks: Networks) -> Iterator[list[Drive]]:
    """All eight."""
    made = [Drive(networks[name], number) for name, found in DRIVES.items() for number in found]
    for drive in made:
        drive.reset()
    with exchanging(made):
        yield made
    for drive in made:
        drive.leave()


def test_eight_drives_reach_operation_enabled_in_cst(drives: list[Drive]) -> None:
    for drive in drives:
        assert drive.sdo[0x6076].raw == 8000 * TORQUE_CONSTANT // 1000
        for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
            drive.state = state
            assert drive.state == state
    for drive in drives:
        assert enabled(drive)
        assert drive.op_mode == CST
        assert drive.sdo[0x6041].raw & 0x1210 == 0x1210  # follows, operational, supplied
    # Torque goes out and comes back, on every drive its own.
    for drive in drives:
        drive.rpdo[1][0x6071].raw = 20 + 5 * drive.id
    for drive in drives:
        wanted = 20 + 5 * drive.id
        assert eventually(lambda d=drive, w=wanted: abs(d.tpdo[1][0x6077].raw - w) <= 3)
    for drive in drives:
        drive.rpdo[1][0x6071].raw = 0
        drive.state = "SWITCH ON DISABLED"
        assert not enabled(drive)


def test_every_state_that_can_be_asked_for(drive: Drive) -> None:
    """By event-driven PDOs, one drive through all of python-canopen's transition table."""
    drive.op_mode = CST
    drive.map_torque(transmission=255)
    drive.command("OPERATIONAL")
    for state in (
        "SWITCH ON DISABLED",
        "READY TO SWITCH ON",
        "SWITCH ON DISABLED",
        "OPERATION ENABLED",
        "SWITCHED ON",
        "READY TO SWITCH ON",
        "SWITCHED ON",
        "SWITCH ON DISABLED",
        "OPERATION ENABLED",
        "READY TO SWITCH ON",
        "OPERATION ENABLED",
        "QUICK STOP ACTIVE",
        "OPERATION ENABLED",
        "QUICK STOP ACTIVE",
        "SWITCH ON DISABLED",
    ):
        drive.state = state
        assert drive.state == state


def test_by_sdo_alone(drive: Drive) -> None:
    """Without any PDO the client falls back to SDO for everything."""
    assert drive.nmt.state == "PRE-OPERATIONAL"
    drive.op_mode = CST
    drive.state = "OPERATION ENABLED"
    assert enabled(drive)
    drive.state = "SWITCH ON DISABLED"


def test_a_fault_is_seen_and_reset(drive: Drive, lab: Path) -> None:
    with exchanging([drive]):
        drive.state = "OPERATION ENABLED"
        inject(lab, "drive_error", channel="can0", node=1, code=0x2310)
        assert drive.emergency() == (0x2310, 0x02)
        assert eventually(lambda: drive.state == "FAULT")
        assert drive.is_faulted()
        assert drive.number(0x603F) == 0x2310
        drive.reset_from_fault()
        assert drive.emergency() == (0, 0)
        assert drive.state == "OPERATION ENABLED"
        assert drive.number(0x603F) == 0


def test_all_modes_that_0x6502_promises_can_be_chosen(drive: Drive) -> None:
    for mode in (
        "PROFILED POSITION",
        "PROFILED VELOCITY",
        "HOMING",
        "CYCLIC SYNCHRONOUS POSITION",
        "CYCLIC SYNCHRONOUS VELOCITY",
        CST,
    ):
        assert drive.is_op_mode_supported(mode)
        drive.op_mode = mode
        assert drive.op_mode == mode
    assert not drive.is_op_mode_supported("INTERPOLATED POSITION")


def test_a_remapped_tpdo_is_on_the_wire_as_mapped(drive: Drive) -> None:
    """Another identifier, another order, every third SYNC."""
    network: canopen.Network = drive.network
    drive.command("PRE-OPERATIONAL")
    tpdo = drive.tpdo[1]
    tpdo.read()
    assert (tpdo.cob_id, tpdo.trans_type, len(tpdo.map)) == (0x181, 255, 1)
    tpdo.cob_id, tpdo.trans_type, tpdo.rtr_allowed = 0x1F1, 3, False
    tpdo.clear()
    tpdo.add_variable(0x6064)
    tpdo.add_variable(0x3001, 2)
    tpdo.save()
    tpdo.read()
    assert [(v.index, v.subindex, v.length) for v in tpdo.map] == [(0x6064, 0, 32), (0x3001, 2, 32)]
    heard: list[bytes] = []
    strays: list[bytes] = []
    network.subscribe(0x1F1, lambda _, data, __: heard.append(bytes(data)))
    network.subscribe(0x181, lambda _, data, __: strays.append(bytes(data)))
    drive.command("OPERATIONAL")
    for _ in range(9):
        network.sync.transmit()
        drive.number(0x1000)  # an answer: what came before is over
    assert eventually(lambda: len(heard) == 3)
    position, limit = struct.unpack("<iI", heard[-1])
    assert limit == drive.sdo[0x3001][2].raw
    assert abs(position - drive.sdo[0x6064].raw) <= 2
    assert strays == []
    network.unsubscribe(0x1F1)


def test_a_remapped_rpdo_is_taken_apart_as_mapped(drive: Drive) -> None:
    """Torque before controlword, then at the next SYNC and not before."""
    network: canopen.Network = drive.network
    drive.command("PRE-OPERATIONAL")
    rpdo = drive.rpdo[2]
    rpdo.read()
    rpdo.clear()
    for index in (0x60B2, 0x6071, 0x6065):
        rpdo.add_variable(index)
    rpdo.cob_id, rpdo.trans_type = 0x301, 1
    rpdo.save()
    drive.command("OPERATIONAL")
    network.send_message(0x301, struct.pack("<hhI", -7, 11, 12345))
    assert drive.number(0x6065) == 2000
    network.sync.transmit()
    assert eventually(lambda: drive.number(0x6065) == 12345)
    assert drive.sdo[0x60B2].raw == -7
    assert drive.sdo[0x6071].raw == 11
    # A frame that is too short is an error of its own, and changes nothing.
    network.send_message(0x301, struct.pack("<hh", 1, 1))
    assert drive.emergency() == (0x8210, 0x10)
    assert drive.sdo[0x6071].raw == 11
    assert drive.number(0x1003, 1) & 0xFFFF == 0x8210
