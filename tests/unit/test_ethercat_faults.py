"""Faults of a segment: the door's plain orders, and the kinds of the schema."""

from __future__ import annotations

import json
import struct
from typing import Any

import pytest
from ethercat_bench import CHANNEL, MS, OP, PRE_OP, SAFE_OP, STATION, US, SegmentBench
from lab_bench import Bench

from tonus.config.schema.faults import FAULT, Loss, PowerLoss
from tonus.config.schema.lab import LabScript
from tonus.sim.errors import LabError
from tonus.sim.ethercat.frames import Command, Datagram, build, parse, physical
from tonus.sim.lab.door import Door

ERROR = 0x10


class Orders(SegmentBench):
    def __init__(self, **over: Any) -> None:
        super().__init__(**over)
        self.door = Door(self.lab)

    def order(self, **request: Any) -> dict[str, Any]:
        reply = self.door.request(json.loads(json.dumps(request)))
        json.dumps(reply, allow_nan=False)
        return reply

    def must(self, **request: Any) -> dict[str, Any]:
        reply = self.order(**request)
        assert reply["ok"], reply
        return reply

    def inject(self, kind: str, **fields: Any) -> dict[str, Any]:
        return self.must(op="inject", fault={"kind": kind, "channel": CHANNEL, **fields})

    def heard(self) -> int | None:
        """How many slaves answer, None: the frame is lost."""
        answer = self.frame(Datagram(Command.BRD, physical(0, 0), b"\0"))
        return None if answer is None else answer[0].counter


# -- the door's orders -------------------------------------------------------------------------


def test_so_many_frames_are_lost() -> None:
    bench = Orders()
    bench.must(op="fault", f={"drop": 2})
    assert [bench.heard() for _ in range(4)] == [None, None, 10, 10]
    assert not bench.segment.disturbance.active, "a quiet segment is not slowed down"


def test_a_share_of_the_frames_is_lost_and_the_same_one_with_the_same_seed() -> None:
    def lost(seed: int) -> list[bool]:
        bench = Orders(seed=seed)
        bench.must(op="fault", f={"drop_p": 0.3})
        return [bench.heard() is None for _ in range(400)]

    first = lost(1)
    assert 80 < sum(first) < 160
    assert lost(1) == first
    assert lost(2) != first


def test_a_mute_segment_answers_nothing_until_it_may() -> None:
    bench = Orders()
    assert bench.must(op="fault", f={"mute": 1})["f"]["mute"] is True
    assert [bench.heard() for _ in range(3)] == [None] * 3
    bench.must(op="fault", f={"mute": 0})
    assert bench.heard() == 10


def test_the_answer_to_a_mailbox_is_lost_and_the_slave_has_acted() -> None:
    bench = Orders()
    bench.pre_op(0)
    memory = bench.slaves[0].device.objects.find(0x210C, 1)
    bench.must(op="fault", f={"drop_mbxw": 1})
    with pytest.raises(AssertionError, match="no answer"):
        bench.post(0, struct.pack("<HBHBI", 2 << 12, 0x23, 0x210C, 1, 9))
    assert memory.value == 9
    bench.must(op="fault", f={"drop_mbx": 1})
    with pytest.raises(AssertionError, match="no answer"):
        bench.fetch(0)
    assert bench.fetch(0) is None, "the box is empty; the master has to ask for a repetition"


def test_a_slave_falls_to_a_state_with_a_code() -> None:
    bench = Orders()
    bench.operate(0, 1)
    bench.must(op="al", slave=1, state=4, code=27)
    assert bench.standing(1) == (SAFE_OP | ERROR, 27)
    assert bench.standing(0) == (OP, 0)
    told = bench.must(op="get")["slaves"]
    assert [told[1][key] for key in ("slave", "state", "error", "code")] == [1, 4, True, 27]
    assert not told[0]["error"]


def test_a_slave_refuses_what_it_is_told_to() -> None:
    bench = Orders()
    bench.pre_op(0)
    bench.map(0)
    bench.must(op="reject", slave=0, map={"4": 30})
    assert bench.request(0, SAFE_OP) == (PRE_OP | ERROR, 30)
    bench.must(op="reject", slave=0, map={})
    assert bench.request(0, SAFE_OP | 0x10) == (SAFE_OP, 0)


def test_only_the_first_slaves_answer() -> None:
    bench = Orders()
    bench.must(op="cut", n=4)
    assert bench.heard() == 4
    told = bench.must(op="get")["slaves"]
    assert [slave["reachable"] for slave in told] == [True] * 4 + [False] * 6
    bench.must(op="cut", n=2)
    assert bench.heard() == 2, "the last order counts"
    bench.must(op="cut", n=10)
    assert bench.heard() == 10


def test_a_drive_raises_an_error() -> None:
    bench = Orders()
    bench.pre_op(0)
    bench.must(op="drive_fault", slave=0, code=34321)
    found = bench.fetch(0)
    assert found is not None
    assert found[1] == struct.pack("<HHB5x", 1 << 12, 34321, 0x80), "an emergency tells it"
    assert bench.upload(0, 0x603F) == struct.pack("<H", 34321)


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"op": "fault", "f": {"drop": -1}}, "f.drop"),
        ({"op": "fault", "f": {"swallow": 1}}, "swallow"),
        ({"op": "fault"}, "f is missing"),
        ({"op": "al", "slave": 10, "state": 4}, "there are 0 to 9"),
        ({"op": "al", "slave": 0, "state": 5}, "there is no state 5"),
        ({"op": "reject", "slave": 0, "map": {"x": 1}}, "map"),
        ({"op": "cut", "n": "two"}, "n"),
        ({"op": "cut", "n": 2, "channel": "can0"}, "there is tonus0"),
        ({"op": "drive_fault", "slave": 8, "code": 34321}, "not a drive"),
        ({"op": "drive_fault", "slave": 0, "code": 1}, "no error 0x0001"),
    ],
)
def test_an_order_that_cannot_be_is_refused_in_words(request_: dict[str, Any], words: str) -> None:
    reply = Orders().order(**request_)
    assert not reply["ok"]
    assert words in reply["error"]


def test_a_lab_without_a_segment_has_no_such_orders() -> None:
    with Bench() as bench:
        reply = Door(bench.lab).request({"op": "cut", "n": 1})
    assert not reply["ok"]
    assert "there is no op 'cut'" in reply["error"]


# -- kinds of the schema -----------------------------------------------------------------------


def test_every_kind_says_where_it_can_happen() -> None:
    kinds = Orders().must(op="kinds")["kinds"]
    assert kinds["loss"]["where"] == [CHANNEL]
    assert kinds["babble"]["where"] == []
    assert kinds["cable_break"]["where"] == [CHANNEL]
    assert kinds["drive_error"]["where"] == [f"{CHANNEL}/{n}" for n in range(1, 9)]
    assert len(kinds["state_drop"]["where"]) == 10
    with Bench() as bench:
        on_can = Door(bench.lab).request({"op": "kinds"})["kinds"]
    assert on_can["state_drop"]["where"] == []
    assert len(on_can["unplug"]["where"]) == 17


def test_lost_and_corrupted_frames_are_as_many_as_asked_for() -> None:
    bench = Orders()
    bench.address()
    bench.inject("loss", frames=2)
    assert [bench.heard() for _ in range(3)] == [None, None, 10]
    bench.inject("corruption", frames=3)
    assert [bench.heard() for _ in range(4)] == [None, None, None, 10]
    assert bench.read(0, 0x300, 1) == b"\3", "the slave behind the cable counts them"
    bench.write(0, 0x300, b"\0")
    assert bench.read(0, 0x300, 1) == b"\0"


def test_a_late_answer_comes_later_and_a_double_one_twice() -> None:
    bench = Orders()
    frame = build([Datagram(Command.BRD, physical(0, 0), b"\0", index=7)])
    bench.inject("delay", frames=1, delay_us=500)
    assert bench.segment.exchange(frame, 0) is None
    assert bench.segment.poll(499 * US) == []
    ((port, late),) = bench.segment.poll(500 * US)
    assert (port, parse(late)[0].counter, parse(late)[0].index) == (0, 10, 7)
    bench.inject("duplicate", frames=1)
    first = bench.segment.exchange(frame, MS)
    assert bench.segment.poll(MS) == [(0, first)]
    assert bench.segment.poll(MS) == []


def test_a_lasting_fault_ends_by_time_by_count_or_by_order() -> None:
    bench = Orders()
    bench.inject("cable_break", behind=3, duration=0.05)
    assert bench.heard() == 3
    assert [item["fault"]["kind"] for item in bench.must(op="get")["faults"]] == ["cable_break"]
    bench.wait(51)
    assert bench.heard() == 10
    bench.inject("unplug", node=5)
    bench.inject("power_loss", node=9)
    assert bench.heard() == 4
    bench.inject("replug", node=5)
    assert bench.heard() == 8
    bench.must(op="clear", channel=CHANNEL)
    assert bench.heard() == 10
    assert bench.must(op="get")["faults"] == []
    bench.inject("disconnect")
    assert bench.heard() == 0
    bench.must(op="clear")
    assert bench.heard() == 10


def test_another_slave_may_be_there_than_the_one_that_should() -> None:
    bench = Orders()
    bench.pre_op(0)
    bench.inject("wrong_identity", node=1, product=0x65520000)
    assert bench.upload(0, 0x1018, 2) == struct.pack("<I", 0x65520000)
    bench.write(0, 0x502, struct.pack("<HI", 0x0100, 8))
    assert bench.read(0, 0x508, 8) == struct.pack("<II", 0xFB, 0x65520000)
    bench.must(op="clear")
    assert bench.upload(0, 0x1018, 2) == struct.pack("<I", 0x65510000)


def test_states_mailboxes_watchdogs_and_clocks_fail_on_demand() -> None:
    bench = Orders()
    bench.operate(0, 1)
    bench.inject("state_drop", node=2, state="pre_op", code=0x1A)
    assert bench.standing(1) == (PRE_OP | ERROR, 0x1A)
    bench.inject("watchdog", node=1)
    assert bench.standing(0) == (SAFE_OP | ERROR, 0x1B)
    bench.inject("state_refusal", node=1, state="op", code=0x2D)
    assert bench.request(0, OP | 0x10) == (SAFE_OP | ERROR, 0x2D)
    bench.inject("mailbox_abort", node=1, index=0x1018, code=0x06060000, times=2)
    for code in (0x06060000, 0x06060000, 0):
        answer = bench.ask(0, struct.pack("<HBHB4x", 2 << 12, 0x40, 0x1018, 1))
        assert (struct.unpack_from("<I", answer, 6)[0] if answer[2] == 0x80 else 0) == code
    before = bench.slaves[2].clock.drift
    bench.inject("clock_drift", node=3, drift_ppm=500.0)
    assert bench.slaves[2].clock.drift == 500e-6
    bench.must(op="clear")
    assert bench.slaves[2].clock.drift == before
    assert bench.request(0, OP | 0x10) == (OP, 0)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"kind": "babble"}, "only CAN has that"),
        ({"kind": "stuck"}, "only CAN has that"),
        ({"kind": "loss", "identifier": 5}, "no identifier"),
        ({"kind": "cable_break", "behind": 10}, "less than the 10"),
        ({"kind": "unplug", "node": 11}, "there are 10"),
        ({"kind": "drive_error", "node": 9, "code": 0x8611}, "not a drive"),
        ({"kind": "drive_error", "node": 1, "code": 3}, "no error 0x0003"),
        ({"kind": "cell_break", "node": 1}, "not a load cell"),
        ({"kind": "loss", "channel": "can0"}, "there are tonus0"),
    ],
)
def test_a_fault_that_does_not_fit_is_refused(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(LabError, match=words):
        Orders().lab.inject(FAULT.validate_python({"channel": CHANNEL, **fields}))


def test_ethercats_faults_are_refused_on_can() -> None:
    with Bench() as bench, pytest.raises(LabError, match="CAN channel"):
        bench.lab.inject(PowerLoss(kind="power_loss", channel="can0", node=1))


def test_a_scenarios_faults_begin_when_all_drives_are_enabled() -> None:
    script = LabScript(faults=(Loss(kind="loss", channel=CHANNEL, at=0.01, frames=1),))
    bench = SegmentBench(script=script)
    drives = tuple(range(8))
    bench.operate(*drives, sync_ns=MS)
    lost = []
    for tick in range(40):
        word = (0x06, 0x07, 0x0F)[min(tick // 3, 2)]
        outputs = struct.pack("<Hh", word, 0) * 8
        frame = Datagram(Command.LRW, 0x10000, outputs + bytes(64))
        lost.append(bench.frame(frame) is None)
        bench.wait(1)
    assert all(drive.enabled for drive in bench.lab.drives)
    assert lost.count(True) == 1
    assert lost.index(True) > 15


def test_an_input_is_released_by_clearing() -> None:
    bench = Orders()
    drive = bench.lab.drives[1]
    for _ in range(2):
        bench.inject("drive_input", node=2, input="sto")
    assert len(bench.lab.faults()) == 1
    assert drive.objects.number(0x3202, 1) == 0
    bench.must(op="clear")
    assert drive.objects.number(0x3202, 1) == 3
    assert not bench.lab.faults()


def test_a_broken_cell_is_an_emergency_and_a_status() -> None:
    bench = Orders()
    bench.pre_op(9)
    bench.inject("cell_break", node=10)
    found = bench.fetch(9)
    assert found is not None
    assert struct.unpack_from("<HH", found[1]) == (1 << 12, 0x5010)
    assert bench.upload(9, 0x6150, 1) == b"\3"
    assert bench.read(9, 0x010, 2) == struct.pack("<H", STATION + 9)
