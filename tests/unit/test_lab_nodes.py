"""Nodes of the lab on their buses: boot-up, NMT, SDO, PDO, heartbeats, emergencies."""

from __future__ import annotations

import struct

import can
import pytest
from lab_bench import Bench

from tonus.config.schema.faults import CellBreak, DriveError, Unplug
from tonus.config.schema.lab import LabScript
from tonus.sim.devices.cia402.states import State
from tonus.sim.errors import LabError
from tonus.sim.lab.engine import Lab


def heartbeats(messages: list[can.Message], node: int) -> list[bytes]:
    return [bytes(m.data) for m in messages if m.arbitration_id == 0x700 + node]


def emergencies(messages: list[can.Message], node: int) -> list[tuple[int, int]]:
    return [struct.unpack_from("<HB", m.data) for m in messages if m.arbitration_id == 0x80 + node]


def test_every_node_boots_with_its_message() -> None:
    with Bench() as bench:
        bench.wait(2)
        for spec in bench.config.fieldbus.channels:
            nodes = [d.node_id for d in spec.drives] + [c.node_id for c in spec.force_cells]
            seen = {m.arbitration_id: bytes(m.data) for m in bench.read(spec.name)}
            assert seen == {0x700 + node: b"\0" for node in nodes}


def test_identity_and_name() -> None:
    with Bench() as bench:
        assert bench.upload("can0", 1, 0x1018, 1) == struct.pack("<I", 0xFB)
        assert bench.upload("can0", 1, 0x1018, 2) == struct.pack("<I", 0x65510000)
        assert bench.upload("can0", 17, 0x1000, 0) == struct.pack("<I", 0x00020194)
        first = bench.request("can0", 1, struct.pack("<BHB4x", 0x40, 0x1008, 0))
        assert first == struct.pack("<BHBI", 0x41, 0x1008, 0, 5)
        assert bench.request("can0", 1, bytes((0x60,)) + bytes(7)) == b"\x05EPOS4\0\0"


@pytest.mark.parametrize(
    ("index", "sub", "value", "size", "code"),
    [
        (0x6041, 0, 0, 2, 0x06010002),
        (0x6076, 0, 1, 4, 0x06010002),
        (0x5FFF, 0, 0, 2, 0x06020000),
        (0x3001, 9, 0, 4, 0x06090011),
        (0x605A, 0, 5, 2, 0x06090030),
        (0x60C2, 1, 101, 1, 0x06090030),
        (0x6060, 0, 2, 1, 0x06090030),
        (0x6098, 0, 35, 1, 0x06090030),
        (0x6071, 0, 0, 4, 0x06070010),
        (0x6080, 0, 1, 2, 0x06070013),
        (0x1010, 1, 1, 4, 0x08000020),
        (0x1600, 0, 1, 1, 0x06040043),
        (0x1600, 1, 0x60400010, 4, 0x06010003),
        (0x1400, 2, 245, 1, 0x06090030),
        (0x1400, 1, 0x80000000, 4, 0x06090030),
        (0x1400, 1, 0x00000222, 4, 0x06090030),
    ],
)
def test_refusals(index: int, sub: int, value: int, size: int, code: int) -> None:
    with Bench() as bench:
        assert bench.write("can0", 1, index, sub, value, size) == code


def test_a_mapping_is_refused_for_what_is_wrong_with_it() -> None:
    with Bench() as bench:

        def write(index: int, sub: int, value: int, size: int) -> int:
            return bench.write("can0", 1, index, sub, value, size)

        assert write(0x1400, 1, 0x80000201, 4) == 0
        assert write(0x1600, 0, 0, 1) == 0
        assert write(0x1600, 1, 0x60410010, 4) == 0x06040041, "read only"
        assert write(0x1600, 1, 0x60400020, 4) == 0x06040041, "wrong length"
        assert write(0x1600, 1, 0x12340010, 4) == 0x06020000, "no such object"
        for place in (1, 2, 3):
            assert write(0x1600, place, 0x607A0020, 4) == 0
        assert write(0x1600, 0, 3, 1) == 0x06040042, "96 bits"
        assert write(0x1600, 0, 13, 1) == 0x06090030
        assert write(0x1600, 0, 2, 1) == 0
        assert write(0x1600, 2, 0, 4) == 0x06010003, "it is active"
        assert write(0x1400, 1, 0x201, 4) == 0


def test_torque_becomes_current_two_syncs_later() -> None:
    with Bench() as bench:
        bench.configure_all()
        bench.enable()
        assert bench.upload("can0", 1, 0x6076, 0) == struct.pack("<I", 568000)
        reference = bench.lab.plant.current_reference
        bench.tick(0x0F, 250)
        assert reference[0] == 0.0, "it waits for the next SYNC"
        bench.tick(0x0F, 250)
        assert reference[0] == pytest.approx(2.0), "250 per mille of 8 A"
        for _ in range(20):
            bench.tick(0x0F, 250)
        words = {m.arbitration_id: bytes(m.data) for m in bench.read("can0")}
        status, position, torque = struct.unpack("<Hih", words[0x181])
        assert status == 0x1237
        assert position > 0, "a positive torque winds in"
        assert torque == pytest.approx(250, abs=2)
        bench.tick(0x0F, 3000)
        bench.tick(0x0F, 3000)
        assert reference[0] == 16.0, "the current limit"
        assert bench.lab.drives[0].statusword() & 0x0800


def test_a_short_pdo_is_an_error_and_a_stop() -> None:
    with Bench() as bench:
        bench.configure_all()
        bench.enable()
        bench.read("can0")
        bench.send("can0", 0x201, b"\x0f\x00")
        bench.wait(1)
        assert emergencies(bench.read("can0"), 1) == [(0x8210, 0x10)]
        assert bench.lab.drives[0].state is State.FAULT_REACTION_ACTIVE
        assert bench.lab.drives[1].enabled


def test_without_its_masters_heartbeat_a_drive_stops_itself() -> None:
    with Bench() as bench:
        bench.configure_all()
        for spec in bench.config.fieldbus.channels:
            for drive in spec.drives:
                assert bench.write(spec.name, drive.node_id, 0x1016, 1, 127 << 16 | 100, 4) == 0
        bench.enable()
        for _ in range(300):
            bench.tick(0x0F, 30)
        assert all(drive.enabled for drive in bench.lab.drives), "heartbeats came"
        bench.read("can0")
        for _ in range(90):
            bench.tick(0x0F, 30, beat=False)
        assert all(drive.enabled for drive in bench.lab.drives)
        for _ in range(20):
            bench.tick(0x0F, 30, beat=False)
        assert not any(drive.enabled for drive in bench.lab.drives)
        assert emergencies(bench.read("can0"), 1) == [(0x8130, 0x10)]
        bench.wait(1500)
        assert all(drive.state is State.FAULT for drive in bench.lab.drives)
        assert not bench.lab.plant.powered.any()
        # Pre-operational by 0x1029; a reset of communication comes before the fault reset.
        assert bench.upload("can0", 1, 0x603F, 0) == struct.pack("<H", 0x8130)
        for word in (0x00, 0x80):
            bench.write("can0", 1, 0x6040, 0, word, 2)
        assert bench.lab.drives[0].state is State.FAULT
        bench.send("can0", 0x000, b"\x82\x01")
        bench.wait(2)
        for word in (0x00, 0x80):
            bench.write("can0", 1, 0x6040, 0, word, 2)
        assert bench.lab.drives[0].state is State.SWITCH_ON_DISABLED


def test_quick_stop_holds_the_drum() -> None:
    with Bench() as bench:
        bench.configure_all()
        bench.enable()
        for _ in range(400):
            bench.tick(0x0F, 60)
        assert bench.lab.plant.tension.min() > 10.0
        for _ in range(1000):
            bench.tick(0x02, 0)
        assert all(drive.state is State.QUICK_STOP_ACTIVE for drive in bench.lab.drives)
        assert abs(bench.lab.plant.motor_rate).max() < 0.2
        assert bench.lab.plant.tension.min() > 5.0, "held, not let go"


def test_heartbeats_keep_their_period_and_tell_the_state() -> None:
    with Bench() as bench:
        bench.wait(2)
        assert bench.write("can0", 17, 0x1017, 0, 10, 2) == 0
        bench.read("can0")
        bench.wait(100)
        beats = heartbeats(bench.read("can0"), 17)
        assert 9 <= len(beats) <= 11
        assert set(beats) == {b"\x7f"}
        for command, state in ((1, b"\x05"), (2, b"\x04"), (0x80, b"\x7f")):
            bench.send("can0", 0x000, bytes((command, 17)))
            bench.wait(1)
            bench.read("can0")
            bench.wait(20)
            assert set(heartbeats(bench.read("can0"), 17)) == {state}
        bench.send("can0", 0x000, b"\x81\x11")
        bench.wait(2)
        assert b"\x00" in heartbeats(bench.read("can0"), 17)
        bench.wait(100)
        assert not bench.read("can0"), "the period is the default again: none"


def test_a_stopped_node_answers_no_sdo() -> None:
    with Bench() as bench:
        bench.send("can0", 0x000, b"\x02\x01")
        bench.wait(1)
        bench.read("can0")
        bench.send("can0", 0x601, struct.pack("<BHB4x", 0x40, 0x1000, 0))
        bench.wait(5)
        assert not [m for m in bench.read("can0") if m.arbitration_id == 0x581]


def test_an_unplugged_node_is_silent_until_it_is_back() -> None:
    with Bench() as bench:
        bench.configure_all()
        bench.enable()
        bench.lab.unplug("can0", 17)
        bench.read("can0")
        bench.tick(0x0F)
        assert not [m for m in bench.read("can0") if m.arbitration_id == 0x191]
        bench.lab.replug("can0", 17)
        bench.tick(0x0F)
        assert [m for m in bench.read("can0") if m.arbitration_id == 0x191]


def test_the_script_begins_when_all_drives_are_enabled() -> None:
    script = LabScript(
        faults=(
            Unplug(at=0.05, kind="unplug", channel="can1", node=3),
            DriveError(at=0.10, kind="drive_error", channel="can0", node=7, code=0x4210),
            CellBreak(at=0.10, kind="cell_break", channel="can3", node=25),
        )
    )
    with Bench(script=script) as bench:
        bench.configure_all()
        bench.wait(500)
        bench.enable()
        for name in bench.buses:
            bench.read(name)
        for _ in range(45):
            bench.tick(0x0F)
        assert [m for m in bench.read("can1") if m.arbitration_id == 0x183]
        for _ in range(60):
            bench.tick(0x0F)
        last = bench.read("can1")[-20:]
        assert not [m for m in last if m.arbitration_id == 0x183]
        assert emergencies(bench.read("can0"), 7) == [(0x4210, 0x08)]
        assert bench.lab.drives[6].state is State.FAULT
        forces = [bytes(m.data) for m in bench.read("can3") if m.arbitration_id == 0x199]
        assert struct.unpack("<i", forces[-1]) == (50000,), "the end of its range"


def test_a_script_may_be_extended_while_it_plays() -> None:
    late = DriveError(at=0.10, kind="drive_error", channel="can0", node=7, code=0x4210)
    with Bench() as bench:
        with pytest.raises(LabError, match="has not begun"):
            bench.lab.extend_script([late])
        bench.configure_all()
        bench.wait(500)
        bench.enable()
        begun = bench.lab.script_start_ns
        assert begun is not None
        bench.lab.extend_script([late])
        while bench.lab.now_ns < begun + 99_000_000:
            bench.tick(0x0F)
        assert bench.lab.drives[6].state is State.OPERATION_ENABLED
        bench.wait(2)
        assert bench.lab.drives[6].state is State.FAULT
        with pytest.raises(LabError, match="are over"):
            bench.lab.extend_script([late])
        with pytest.raises(LabError, match="no node 99"):
            bench.lab.extend_script([Unplug(at=9.0, kind="unplug", channel="can0", node=99)])


def test_a_script_that_does_not_fit_is_refused() -> None:
    script = LabScript(faults=(Unplug(at=0.0, kind="unplug", channel="can0", node=99),))
    with pytest.raises(LabError, match="no node 99"):
        Bench(script=script)


def test_one_channel_with_all_devices_overloads_at_1_khz() -> None:
    overrides = {"fieldbus.load_limit": 1.0}
    config_name = "config/can.yaml"
    with Bench(config_name, overrides=overrides) as bench:
        bus = bench.config.fieldbus
        drives = tuple(d for c in bus.channels for d in c.drives)
        cells = tuple(c for spec in bus.channels for c in spec.force_cells)
        one = bus.channels[0].model_copy(update={"drives": drives, "force_cells": cells})
        config = bench.config.model_copy(
            update={"fieldbus": bus.model_copy(update={"channels": (one,)})}
        )
    now = [0]
    lab = Lab(config, LabScript(), seed=1, clock=lambda: now[0])
    lab.open()
    bus = can.Bus(interface="tonus", channel="can0")
    for node in (*range(1, 9), *range(17, 26)):
        for index, sub, value, size in ((0x1800, 2, 1, 1),):
            data = struct.pack("<BHBI", 0x23 | (4 - size) << 2, index, sub, value)
            bus.send(can.Message(arbitration_id=0x600 + node, is_extended_id=False, data=data))
            now[0] += 1_000_000
            lab.advance(now[0])
    bus.send(can.Message(arbitration_id=0, is_extended_id=False, data=b"\1\0"))
    refused = 0
    for _ in range(200):
        now[0] += 1_000_000
        for identifier in (0x80, *(0x200 + n for n in range(1, 9))):
            try:
                data = b"" if identifier == 0x80 else b"\0\0\0\0"
                message = can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
                bus.send(message)
            except can.CanOperationError:
                refused += 1
    before = lab.channels["can0"].busy_ns
    now[0] += 1_000_000
    lab.advance(now[0])
    # A frame counts in full when it begins, so a window may hold a little more than its length.
    assert lab.channels["can0"].busy_ns - before > 850_000, "the bus never rests"
    assert refused + lab.channels["can0"].overflows > 50
    bus.shutdown()
    lab.close()


def test_waiting_in_virtual_time_is_an_error_and_not_a_hang() -> None:
    with Bench() as bench:
        bench.wait(2)
        bench.read("can0")
        with pytest.raises(can.CanOperationError, match="poll"):
            bench.buses["can0"].recv()
        room = bench.config.lab.bus.queue_depth
        for _ in range(room):
            bench.send("can0", 0x7FF)
        with pytest.raises(can.CanOperationError, match="full"):
            bench.send("can0", 0x7FF)


def _recording(seed: int, step_us: int) -> bytes:
    """All frames of a short run as bytes, with the lab brought forward in steps of that size."""
    with Bench(seed=seed) as bench:
        bench.configure_all()
        out = bytearray()
        for number in range(60):
            for spec in bench.config.fieldbus.channels:
                bench.send(spec.name, 0x080)
                for drive in spec.drives:
                    word = (0x00, 0x06, 0x0F)[min(number // 5, 2)]
                    bench.send(spec.name, 0x200 + drive.node_id, struct.pack("<Hh", word, 40))
            for _ in range(1000 // step_us):
                bench.wait(step_us * 1e-3)
            for name in bench.buses:
                for m in bench.read(name):
                    out += struct.pack("<dI", m.timestamp, m.arbitration_id) + m.data
        return bytes(out)


def test_equal_seeds_give_equal_frames_however_time_is_stepped() -> None:
    first = _recording(1, 1000)
    assert first == _recording(1, 1000)
    assert first == _recording(1, 50)
    assert first != _recording(2, 1000)
