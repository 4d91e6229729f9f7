"""States of a slave: every refused transition with its AL status code, watchdog, power, cable."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest
from ethercat_bench import INIT, LOGICAL, MS, OP, PRE_OP, SAFE_OP, STATION, SegmentBench

from tonus.sim.devices.cia402.states import State as DriveState
from tonus.sim.ethercat.frames import Command
from tonus.sim.ethercat.slaves.states import Facts, Standing, State, next_standing

ERROR, ACKNOWLEDGE, BOOT = 0x10, 0x10, 3
SOUND = Facts(mailbox=True, outputs=True, inputs=True, sync=True)


@pytest.fixture
def bench() -> SegmentBench:
    return SegmentBench()


@pytest.mark.parametrize("state", [INIT, PRE_OP, SAFE_OP, OP])
@pytest.mark.parametrize("request_", range(16))
def test_every_request_in_every_state(state: int, request_: int) -> None:
    now = Standing(State(state), False, 0)
    after = next_standing(now, request_, SOUND)
    if request_ not in (INIT, PRE_OP, BOOT, SAFE_OP, OP):
        assert after == Standing(State(state), True, 0x12)
    elif request_ == BOOT:
        assert after == Standing(State(state), True, 0x13)
    elif request_ <= state or request_ == 2 * state:
        assert after == Standing(State(request_), False, 0)
    else:
        assert after == Standing(State(state), True, 0x11)


@pytest.mark.parametrize("request_", range(16))
def test_an_error_wants_to_be_acknowledged_before_anything_else_goes_up(request_: int) -> None:
    now = Standing(State.SAFE_OP, True, 0x1B)
    ignored = request_ in (SAFE_OP, OP)
    assert (next_standing(now, request_, SOUND) == now) == ignored
    if request_ in (INIT, PRE_OP, SAFE_OP, OP):
        after = next_standing(now, request_ | ACKNOWLEDGE, SOUND)
        assert after == Standing(State(request_), False, 0)


def prepare_init(bench: SegmentBench) -> None:
    bench.address()


def prepare_pre_op(bench: SegmentBench) -> None:
    bench.pre_op(0)
    bench.map(0)


def prepare_dc(bench: SegmentBench) -> None:
    prepare_pre_op(bench)
    assert bench.download(0, 0x1C32, 1, b"\2\0") == 0


@pytest.mark.parametrize(
    ("prepare", "spoil", "request_", "status", "code"),
    [
        (prepare_init, lambda b: None, SAFE_OP, INIT, 0x11),
        (prepare_init, lambda b: None, OP, INIT, 0x11),
        (prepare_init, lambda b: None, BOOT, INIT, 0x13),
        (prepare_init, lambda b: None, 5, INIT, 0x12),
        (prepare_init, lambda b: None, PRE_OP, INIT, 0x16),
        (prepare_init, lambda b: b.manager(0, 0, 0x1000, 48, 0x26), PRE_OP, INIT, 0x16),
        (prepare_pre_op, lambda b: None, OP, PRE_OP, 0x11),
        (prepare_pre_op, lambda b: b.manager(0, 1, 0x1030, 40, 0x22), SAFE_OP, PRE_OP, 0x16),
        (prepare_pre_op, lambda b: b.manager(0, 2, 0x1060, 6, 0x64), SAFE_OP, PRE_OP, 0x1D),
        (prepare_pre_op, lambda b: b.manager(0, 2, 0x1070, 4, 0x64), SAFE_OP, PRE_OP, 0x1D),
        (prepare_pre_op, lambda b: b.manager(0, 2, 0x1060, 4, 0x20), SAFE_OP, PRE_OP, 0x1D),
        (prepare_pre_op, lambda b: b.manager(0, 2, 0x1060, 4, 0x64, 0), SAFE_OP, PRE_OP, 0x1D),
        (prepare_pre_op, lambda b: b.manager(0, 3, 0x10F0, 7, 0x20), SAFE_OP, PRE_OP, 0x1E),
        (prepare_pre_op, lambda b: b.write(0, 0x981, b"\3"), SAFE_OP, PRE_OP, 0x30),
        (prepare_dc, lambda b: None, SAFE_OP, PRE_OP, 0x30),
    ],
)
def test_a_step_up_is_refused_for_what_stands_against_it(
    bench: SegmentBench,
    prepare: Callable[[SegmentBench], None],
    spoil: Callable[[SegmentBench], None],
    request_: int,
    status: int,
    code: int,
) -> None:
    prepare(bench)
    spoil(bench)
    assert bench.request(0, request_) == (status | ERROR, code)
    assert bench.request(0, status) == (status | ERROR, code), "it stays until acknowledged"
    assert bench.request(0, status | ACKNOWLEDGE) == (status, 0)


def test_down_is_always_possible(bench: SegmentBench) -> None:
    for state in (SAFE_OP, PRE_OP, INIT):
        bench.operate(0)
        assert bench.request(0, state) == (state, 0)
        assert bench.request(0, INIT) == (INIT, 0)


def test_a_slave_without_outputs_comes_to_op_without_them(bench: SegmentBench) -> None:
    bench.pre_op(8)
    words = tuple(0x91300120 | n << 8 for n in range(8))
    bench.map(8, tpdo=words)
    assert bench.request(8, SAFE_OP) == (SAFE_OP, 0)
    assert bench.request(8, OP) == (OP, 0)
    bench.wait(500)
    assert bench.standing(8) == (OP, 0), "no outputs, no watchdog"


# -- watchdog ----------------------------------------------------------------------------------


def enable(bench: SegmentBench) -> None:
    for word in (0x06, 0x07, 0x0F, 0x0F):
        bench.cycle([(word, 0)])
        bench.wait(1)
    assert bench.slaves[0].device.state is DriveState.OPERATION_ENABLED


def test_outputs_that_stay_away_end_op(bench: SegmentBench) -> None:
    bench.operate(0)
    enable(bench)
    bench.wait(98)
    assert bench.standing(0) == (OP, 0)
    assert bench.read(0, 0x440, 1) == b"\1"
    bench.wait(2)
    assert bench.standing(0) == (SAFE_OP | ERROR, 0x1B)
    assert bench.read(0, 0x440, 1) == b"\0"
    assert bench.read(0, 0x442, 1) == b"\1"
    assert bench.slaves[0].device.objects.number(0x603F, 0) == 0x8280
    found = bench.fetch(0)
    assert found is not None
    assert struct.unpack_from("<HH", found[1]) == (1 << 12, 0x8280)
    assert bench.cycle([(0x0F, 0)])[1] == 3, "the working counter says nothing about states"
    assert bench.request(0, OP) == (SAFE_OP | ERROR, 0x1B)
    assert bench.request(0, OP | ACKNOWLEDGE) == (OP, 0)
    bench.write(0, 0x442, b"\0")
    assert bench.read(0, 0x442, 1) == b"\0"


def test_the_watchdogs_time_is_the_masters_choice(bench: SegmentBench) -> None:
    bench.operate(0)
    bench.write(0, 0x420, struct.pack("<H", 200))
    bench.cycle([(0, 0)])
    bench.wait(19)
    assert bench.standing(0)[0] == OP
    bench.wait(1.1)
    assert bench.standing(0) == (SAFE_OP | ERROR, 0x1B)
    bench.write(0, 0x420, b"\0\0")
    assert bench.request(0, OP | ACKNOWLEDGE) == (OP, 0)
    bench.wait(3000)
    assert bench.standing(0) == (OP, 0), "0 switches it off"


def test_only_the_last_byte_of_the_outputs_counts(bench: SegmentBench) -> None:
    bench.operate(0)
    for _ in range(12):
        bench.wait(10)
        bench.logical(Command.LWR, LOGICAL, b"\0\0\0")
    assert bench.standing(0) == (SAFE_OP | ERROR, 0x1B)


def test_a_master_that_leaves_op_with_the_drive_at_work_is_told(bench: SegmentBench) -> None:
    bench.operate(0)
    enable(bench)
    assert bench.request(0, SAFE_OP) == (SAFE_OP, 0)
    assert bench.slaves[0].device.objects.number(0x603F, 0) == 0x8180


# -- power and cable ---------------------------------------------------------------------------


def test_a_slave_without_supply_cuts_the_rest_off_and_starts_anew(bench: SegmentBench) -> None:
    bench.operate(0, 1, 2)
    bench.segment.cable.switch(1, on=False)
    assert bench.one(Command.BRD, 0, 0x130, 2) == (b"\x08\0", 1)
    assert bench.number(0, 0x110, 2) == 0x0001 | 0x10 | 0x200 | 0x400 | 0x5000, "port 1 is closed"
    assert bench.read(0, 0x311, 1) == b"\1"
    bench.wait(150)
    bench.segment.cable.switch(1, on=True)
    assert bench.one(Command.BRD, 0, 0x000, 1)[1] == 10
    assert bench.standing(2) == (SAFE_OP | ERROR, 0x1B), "its watchdog has run on"
    assert bench.one(Command.FPRD, STATION + 1, 0x130, 2)[1] == 0, "it has lost its address"
    data, counter = bench.one(Command.APRD, -1, 0x130, 2)
    assert (data, counter) == (b"\x01\0", 1)


def test_a_cut_leaves_those_before_it(bench: SegmentBench) -> None:
    bench.segment.cable.cut(4)
    assert bench.one(Command.BRD, 0, 0x000, 1)[1] == 4
    bench.segment.cable.mend(4)
    assert bench.one(Command.BRD, 0, 0x000, 1)[1] == 10


def test_a_ring_reaches_everyone_from_both_ends() -> None:
    bench = SegmentBench(ring=True)
    assert bench.one(Command.BRD, 0, 0x000, 1)[1] == 10
    assert bench.segment.cable.exit(0) == 1, "through all slaves and out at the far end"
    assert bench.one(Command.BRD, 0, 0x000, 1, port=1)[1] == 0, "passed on the wrong way round"
    assert bench.segment.cable.exit(1) == 0
    bench.segment.cable.cut(4)
    assert bench.one(Command.BRD, 0, 0x000, 1)[1] == 4
    assert bench.one(Command.BRD, 0, 0x000, 1, port=1)[1] == 6
    assert bench.segment.cable.exit(0) == 0
    assert bench.one(Command.APWR, -1, 0x010, b"\x34\x12", port=1)[1] == 1
    assert bench.slaves[5].controller.word(0x010) == 0x1234, "counted from the break"


def test_time_is_an_argument_and_nothing_runs_back(bench: SegmentBench) -> None:
    bench.operate(0)
    bench.wait(1)
    before = bench.lab.now_ns
    bench.now -= MS
    bench.cycle([(0, 0)])
    assert bench.lab.now_ns == before
