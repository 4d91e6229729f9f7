"""python-canopen watches our nodes boot, beat, reset, remember and fall silent."""

from __future__ import annotations

import itertools
import queue
import struct
import time  # noqa: TID251 - another process keeps this lab's time
from pathlib import Path

import canopen
import pytest
from canopen_client import Drive, Networks, eventually
from door_client import inject
from running_lab import CELLS, DRIVES

pytestmark = pytest.mark.realtime

OPERATIONAL, STOPPED, PRE_OPERATIONAL = 5, 4, 127
MASTER = 127


def until(drive: Drive, state: int) -> None:
    """Wait for a heartbeat that says so."""
    while drive.beats.get(timeout=3) != state:
        pass


def test_every_node_of_every_channel_boots_and_answers(networks: Networks) -> None:
    for name, network in networks.items():
        heard: queue.SimpleQueue[int] = queue.SimpleQueue()
        expected = sorted((*DRIVES[name], *CELLS[name]))
        for number in expected:
            network.subscribe(
                0x700 + number,
                lambda can_id, data, _, heard=heard: heard.put((can_id - 0x700, bytes(data))),
            )
        network.send_message(0x000, b"\x81\x00")
        booted = sorted(heard.get(timeout=3) for _ in expected)
        assert booted == [(number, b"\0") for number in expected]
        network.scanner.reset()
        network.scanner.search(limit=40)
        assert eventually(lambda n=network, e=expected: sorted(n.scanner.nodes) == e)
        for number in expected:
            network.unsubscribe(0x700 + number)


def test_a_heartbeat_tells_every_state(drive: Drive) -> None:
    drive.sdo.download(0x1017, 0, b"\x0a\0")
    until(drive, PRE_OPERATIONAL)
    drive.command("OPERATIONAL")
    until(drive, OPERATIONAL)
    drive.command("STOPPED")
    until(drive, STOPPED)
    with pytest.raises(canopen.SdoCommunicationError):
        drive.number(0x1000)
    drive.command("PRE-OPERATIONAL")
    until(drive, PRE_OPERATIONAL)
    assert drive.number(0x1000) == 0x00020192


def test_heartbeats_come_at_their_period(drive: Drive) -> None:
    stamps: list[float] = []
    drive.network.subscribe(0x701, lambda _, __, stamp: stamps.append(stamp))
    drive.sdo.download(0x1017, 0, b"\x14\0")
    assert eventually(lambda: len(stamps) > 12)
    gaps = [after - before for before, after in itertools.pairwise(stamps)]
    assert all(abs(gap - 0.020) < 0.0005 for gap in gaps)  # stamped on the wire, by the lab


def test_reset_communication_takes_back_the_mapping_and_not_the_motor(drive: Drive) -> None:
    drive.sdo.download(0x1017, 0, b"\x0a\0")
    drive.sdo.download(0x6065, 0, struct.pack("<I", 4321))
    drive.map_torque(transmission=1)
    assert drive.number(0x1A00, 0) == 3
    drive.command("RESET COMMUNICATION")
    assert drive.number(0x1A00, 0) == 1
    assert drive.number(0x1A00, 1) == 0x60410010
    assert drive.number(0x1800, 2) == 255
    assert drive.number(0x1400, 1) & 0x7FFFFFFF == 0x201
    assert drive.number(0x1017, 0) == 0
    assert drive.number(0x6065, 0) == 4321
    while not drive.beats.empty():
        drive.beats.get()
    with pytest.raises(queue.Empty):
        drive.beats.get(timeout=0.05)


def test_reset_node_takes_back_everything_that_was_not_saved(drive: Drive) -> None:
    drive.sdo.download(0x6065, 0, struct.pack("<I", 4321))
    drive.sdo[0x3001][5].raw = 71_000
    drive.command("RESET")
    assert drive.number(0x6065) == 2000
    assert drive.number(0x6076) == 0


def test_what_was_saved_is_there_after_a_reset_until_it_is_restored(drive: Drive) -> None:
    drive.map_torque(transmission=1)
    drive.sdo.download(0x6065, 0, struct.pack("<I", 4321))
    drive.sdo.download(0x1010, 1, b"save")
    drive.sdo.download(0x6065, 0, struct.pack("<I", 99))
    drive.command("RESET")
    assert drive.number(0x6065) == 4321
    assert drive.number(0x1A00, 0) == 3
    drive.command("RESET COMMUNICATION")
    assert drive.number(0x1A00, 0) == 3
    drive.sdo.download(0x1011, 1, b"load")
    assert drive.number(0x6065) == 4321  # not before the next reset
    drive.command("RESET")
    assert drive.number(0x6065) == 2000


def test_the_saved_mapping_is_restored_as_well(drive: Drive) -> None:
    drive.map_torque(transmission=1)
    drive.sdo.download(0x1010, 1, b"save")
    drive.sdo.download(0x1011, 1, b"load")
    drive.command("RESET")
    assert drive.number(0x1A00, 0) == 1


def test_power_stays_off_after_a_reset_in_operation(drive: Drive) -> None:
    drive.map_torque(transmission=255)
    drive.command("OPERATIONAL")
    drive.state = "OPERATION ENABLED"
    drive.reset()
    assert drive.number(0x6041) & 0x6F == 0x40
    assert drive.number(0x6040) == 0
    # A set-point of before the reset enables nothing: the node is not operational.
    drive.network.send_message(0x201, struct.pack("<Hh", 0x0F, 100))
    assert drive.number(0x6041) & 0x26F == 0x040


def test_a_silent_master_is_missed(drive: Drive) -> None:
    """Heartbeat consumer: 0x8130, out of operational, and no reset before communication's."""
    drive.sdo.download(0x1016, 1, struct.pack("<I", MASTER << 16 | 50))
    drive.command("OPERATIONAL")
    drive.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
    beating = drive.network.send_periodic(0x700 + MASTER, b"\x05", 0.01)
    drive.state = "OPERATION ENABLED"
    time.sleep(0.2)
    assert drive.number(0x6041) & 0x6F == 0x27
    assert drive.emergencies.empty()
    beating.stop()
    assert drive.emergency() == (0x8130, 0x10)
    assert eventually(lambda: drive.number(0x6041) & 0x6F == 0x08)
    assert drive.number(0x6041) & 0x200 == 0  # 0x1029 is 0: pre-operational
    for word in (0x00, 0x80, 0x00):
        drive.sdo[0x6040].raw = word
    assert drive.number(0x6041) & 0x6F == 0x08
    drive.command("RESET COMMUNICATION")
    for word in (0x00, 0x80, 0x00):
        drive.sdo[0x6040].raw = word
    assert drive.emergency() == (0, 0)
    assert drive.number(0x6041) & 0x6F == 0x40


def test_a_node_that_is_pulled_falls_silent_and_comes_back(drive: Drive, lab: Path) -> None:
    drive.sdo.download(0x1017, 0, b"\x0a\0")
    until(drive, PRE_OPERATIONAL)
    inject(lab, "unplug", channel="can0", node=1)
    with pytest.raises(canopen.SdoCommunicationError):
        drive.number(0x1000)
    inject(lab, "replug", channel="can0", node=1)
    assert drive.number(0x1000) == 0x00020192
    until(drive, PRE_OPERATIONAL)
