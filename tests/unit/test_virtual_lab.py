"""A lab moved on by its test: its buses and python-canopen wait in its time, and nowhere else."""

from __future__ import annotations

import struct
import threading
import time  # noqa: TID251 - the test compares with the real clock
from collections.abc import Iterator

import can
import canopen
import numpy as np
import pytest
from canopen.profiles.p402 import BaseNode402

import tonus
from tonus.config import load
from tonus.sim.errors import LabError
from tonus.tools.errors import ToolError
from tonus.tools.testing.lab import VirtualLab

CONFIG = load("config/can.yaml")[0]


@pytest.fixture
def lab() -> Iterator[VirtualLab]:
    made = VirtualLab(CONFIG)
    yield made
    made.close()


def request(bus: can.BusABC, index: int, sub: int = 0) -> None:
    data = struct.pack("<BHB4x", 0x40, index, sub)
    bus.send(can.Message(arbitration_id=0x601, is_extended_id=False, data=data))


def test_receiving_waits_in_the_labs_time(lab: VirtualLab) -> None:
    bus = lab.bus("can0")
    lab.advance(50.0)
    assert lab.now == 0.05
    while bus.recv(timeout=0) is not None:
        pass
    request(bus, 0x6041)
    answer = bus.recv(timeout=0.1)
    assert answer is not None
    assert answer.arbitration_id == 0x581
    assert 0.05 < answer.timestamp <= lab.now < 0.06
    before = lab.now
    assert bus.recv(timeout=0.1) is None
    assert lab.now == pytest.approx(before + 0.1)


def test_waiting_for_ever_ends_in_words(lab: VirtualLab) -> None:
    lab.advance(50.0)
    bus = lab.bus("can0")
    with pytest.raises(can.CanOperationError, match="give recv a timeout"):
        bus.recv()


def test_two_labs_with_the_same_steps_are_the_same() -> None:
    def played() -> tuple[float, np.ndarray]:
        lab = VirtualLab(CONFIG, seed=3)
        node = lab.canopen("can0").add_node(1, canopen.ObjectDictionary())
        lab.advance(20.0)
        node.sdo.upload(0x6041, 0)
        lab.advance(20.0)
        found = lab.now, lab.truth.copy()
        lab.close()
        return found

    first, second = played(), played()
    assert first[0] == second[0]
    assert first[1].tobytes() == second[1].tobytes()


def test_python_canopen_reads_configures_and_enables_a_drive(lab: VirtualLab) -> None:
    network = lab.canopen("can0")
    node = BaseNode402(1, canopen.ObjectDictionary())
    network.add_node(node)
    lab.advance(50.0)
    assert int.from_bytes(node.sdo.upload(0x6041, 0), "little") == 0x50  # switch on disabled
    node.nmt.state = "RESET"
    node.nmt.wait_for_bootup(1.0)
    node.sdo.download(0x1017, 0, (100).to_bytes(2, "little"))
    before = lab.now
    assert node.nmt.wait_for_heartbeat(1.0) == "PRE-OPERATIONAL"
    assert lab.now - before <= 0.101


def test_what_does_not_answer_takes_virtual_time_only(lab: VirtualLab) -> None:
    node = lab.canopen("can0").add_node(1, canopen.ObjectDictionary())
    lab.advance(50.0)
    lab.fault("unplug", channel="can0", node=1)
    node.sdo.RESPONSE_TIMEOUT = 20.0
    began, before = time.monotonic(), lab.now
    with pytest.raises(canopen.SdoCommunicationError):
        node.sdo.upload(0x6041, 0)
    assert lab.now - before == pytest.approx(20.0, abs=0.01)
    assert time.monotonic() - began < 20.0


def test_python_canopen_is_as_it_was_afterwards(lab: VirtualLab) -> None:
    lab.canopen("can0")
    assert canopen.nmt.threading is not threading
    other = VirtualLab(load("config/direct.yaml")[0])
    with pytest.raises(ToolError, match="another open lab has a CANopen network"):
        other.canopen("can0")
    other.close()
    lab.close()
    for module in (canopen.nmt, canopen.emcy, canopen.pdo.base):
        assert module.threading is threading
    assert canopen.nmt.time is time


def test_the_truth_is_that_of_the_last_millisecond(lab: VirtualLab) -> None:
    lab.advance(10.5)
    truth = lab.truth
    assert truth["tension"].shape == (8,)
    height = float(truth["position"][2])
    lab.advance(100.0)
    assert float(truth["position"][2]) == height  # a copy
    before = lab.truth.tobytes()
    lab.advance(0.2)
    assert lab.truth.tobytes() == before


def test_faults_by_class_and_by_kind(lab: VirtualLab) -> None:
    lab.fault(tonus.faults.Unplug(channel="can0", node=1))
    lab.fault("unplug", channel="can0", node=7, at=0.010)
    assert [each["fault"]["node"] for each in lab.faults] == [1]
    lab.advance(11.0)
    assert [each["fault"]["node"] for each in lab.faults] == [1, 7]
    with pytest.raises(ToolError, match=r"fault unplug: node: field required"):
        lab.fault("unplug", channel="can0")
    with pytest.raises(
        ToolError, match=r"fault unplugged: there is no such kind; did you mean unplug"
    ):
        lab.fault("unplugged")
    with pytest.raises(ToolError, match="belong into its constructor"):
        lab.fault(tonus.faults.Unplug(channel="can0", node=1), at=1.0)
    with pytest.raises(LabError):
        lab.fault("unplug", channel="can0", node=99)
