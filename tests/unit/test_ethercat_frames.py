"""Every datagram command with its working counter, and how logical addresses fall on slaves."""

from __future__ import annotations

import struct

import pytest
from ethercat_bench import LOGICAL, OP, STATION, SegmentBench

from tonus.sim.ethercat.frames import Command, Datagram, build, parse, physical
from tonus.sim.ethercat.slaves.sii import checksum

RAM = 0x2000
"""process memory no sync manager guards"""


@pytest.fixture
def bench() -> SegmentBench:
    bench = SegmentBench()
    bench.address()
    return bench


def ram(bench: SegmentBench) -> list[bytes]:
    return [bytes(slave.controller.memory[RAM : RAM + 2]) for slave in bench.slaves]


def fill(bench: SegmentBench) -> None:
    for place, slave in enumerate(bench.slaves):
        slave.controller.memory[RAM : RAM + 2] = bytes((1 << place % 8, place))


@pytest.mark.parametrize(
    ("command", "place", "counter", "moved"),
    [
        (Command.NOP, 0, 0, 0),
        (Command.APRD, -3, 1, 10),
        (Command.APRD, -10, 0, 10),
        (Command.APWR, -3, 1, 10),
        (Command.APRW, -3, 3, 10),
        (Command.FPRD, STATION + 3, 1, 0),
        (Command.FPRD, 0x2000, 0, 0),
        (Command.FPWR, STATION + 3, 1, 0),
        (Command.FPRW, STATION + 3, 3, 0),
        (Command.BRD, 0, 10, 10),
        (Command.BRD, 7, 10, 10),
        (Command.BWR, 0, 10, 10),
        (Command.BRW, 0, 30, 10),
        (Command.ARMW, -3, 10, 10),
        (Command.ARMW, -10, 9 + 1, 10),
        (Command.FRMW, STATION + 3, 10, 0),
        (15, 0, 0, 0),
    ],
)
def test_a_command_counts_whom_it_reached(
    bench: SegmentBench, command: int, place: int, counter: int, moved: int
) -> None:
    fill(bench)
    before = ram(bench)
    answer = bench.frame(Datagram(command, physical(place, RAM), b"\x80\xaa"))
    assert answer is not None
    (one,) = answer
    assert one.counter == counter
    assert one.address & 0xFFFF == place + moved & 0xFFFF, "the address counts the slaves"
    after = ram(bench)
    if command in (Command.APRD, Command.FPRD, Command.BRD, Command.NOP, 15):
        assert after == before
    if command in (Command.APWR, Command.FPWR, Command.APRW, Command.FPRW):
        assert after[3] == b"\x80\xaa"
        assert after[:3] + after[4:] == before[:3] + before[4:]
    if command == Command.BWR:
        assert after == [b"\x80\xaa"] * 10
    if command == Command.BRD:
        assert one.data == b"\xff\xaf", "a broadcast collects"
    if command in (Command.APRW, Command.FPRW, Command.APRD, Command.FPRD) and counter:
        assert one.data == before[3]
    if command == Command.FRMW:
        # Those before the reference have what was sent, those behind it what it has read.
        assert after == [b"\x80\xaa"] * 3 + [before[3]] * 7


def test_a_broadcast_that_reads_and_writes_hands_on_what_it_collects(bench: SegmentBench) -> None:
    fill(bench)
    data, _ = bench.one(Command.BRW, 0, RAM, b"\0\0")
    assert data == b"\xff\x0f"
    assert ram(bench)[:3] == [b"\0\0", b"\x01\x00", b"\x03\x01"]


def test_the_counter_is_added_to_and_every_datagram_of_a_frame_is_served(
    bench: SegmentBench,
) -> None:
    given = Datagram(Command.BRD, physical(0, 0), b"\0", counter=0xFFFE)
    answer = bench.frame(given, Datagram(Command.FPRD, physical(STATION, 0x010), bytes(2)))
    assert answer is not None
    assert [one.counter for one in answer] == [8, 1]
    assert answer[1].data == struct.pack("<H", STATION)


def test_an_answer_has_the_frames_length_index_and_a_marked_source(bench: SegmentBench) -> None:
    frame = build([Datagram(Command.BRD, physical(0, 0), b"\0", index=0x5A)], bytes(6))
    answer = bench.segment.exchange(frame, bench.now)
    assert answer is not None
    assert len(answer) == len(frame)
    assert answer[6] == 0x02
    assert parse(answer)[0].index == 0x5A


@pytest.mark.parametrize("length", [0, 5, 14, 16, 20, 27])
def test_what_is_cut_off_is_not_served(bench: SegmentBench, length: int) -> None:
    frame = build([Datagram(Command.BWR, physical(0, 0x120), b"\x02\0")])[:length]
    answer = bench.segment.exchange(frame, bench.now)
    assert answer is None or len(answer) == length
    assert all(slave.controller.word(0x120) == 0 for slave in bench.slaves)


def test_what_is_not_ethercat_is_not_answered(bench: SegmentBench) -> None:
    assert bench.segment.exchange(b"\xff" * 12 + b"\x08\x00" + bytes(50), 0) is None


@pytest.mark.parametrize(
    ("start", "size", "counter"), [(0x0FFF, 2, 0), (0x2FFF, 1, 1), (0x2FFF, 2, 0), (0xFFFF, 4, 0)]
)
def test_addresses_end_where_the_memory_does(
    bench: SegmentBench, start: int, size: int, counter: int
) -> None:
    got = bench.one(Command.FPRD, STATION, start, size)[1]
    assert got == (1 if start == 0x0FFF else counter)
    assert bench.one(Command.FPWR, STATION, start, size)[1] == counter


def test_registers_of_the_slave_cannot_be_written(bench: SegmentBench) -> None:
    before = bytes(bench.slaves[0].controller.memory[:0x1000])
    for start in (0x000, 0x110, 0x130, 0x918, 0x440):
        bench.one(Command.FPWR, STATION, start, b"\xff" * 8)
    bench.one(Command.FPWR, STATION, 0x805, b"\x08")
    bench.one(Command.FPWR, STATION, 0x807, b"\x01")
    after = bytes(bench.slaves[0].controller.memory[:0x1000])
    changed = {place for place in range(0x1000) if before[place] != after[place]}
    assert not changed


def test_an_alias_is_an_address_once_it_is_switched_on(bench: SegmentBench) -> None:
    bench.write(2, 0x502, struct.pack("<HI", 0x0201, 4) + b"\x77\x07")
    bench.write(2, 0x502, struct.pack("<H", 0x0400))
    assert bench.number(2, 0x012, 2) == 0x0777
    assert bench.one(Command.FPRD, 0x0777, 0x000, 1)[1] == 0
    bench.write(2, 0x103, b"\x01")
    assert bench.one(Command.FPRD, 0x0777, 0x000, 1)[1] == 1


# -- logical addresses -------------------------------------------------------------------------


def test_bytes_are_mapped_and_counted_once_a_slave(bench: SegmentBench) -> None:
    for slave in (0, 1):
        bench.fmmu(slave, 0, LOGICAL + 4 * slave, 2, RAM, 2)
        bench.fmmu(slave, 1, LOGICAL + 4 * slave + 2, 1, RAM + 16, 1)
        bench.fmmu(slave, 2, LOGICAL + 4 * slave + 3, 1, RAM + 17, 1)
        bench.slaves[slave].controller.memory[RAM + 16 : RAM + 18] = bytes((0xA0 + slave, 0xB0))
    given = bytes(range(1, 9))
    data, counter = bench.logical(Command.LRW, LOGICAL, given)
    assert counter == 6, "two slaves, each 1 for inputs and 2 for outputs"
    assert data == bytes((1, 2, 0xA0, 0xB0, 5, 6, 0xA1, 0xB0))
    assert [part.hex() for part in ram(bench)[:3]] == ["0102", "0506", "0000"]
    assert bench.logical(Command.LRD, LOGICAL, bytes(8)) == (
        bytes((0, 0, 0xA0, 0xB0, 0, 0, 0xA1, 0xB0)),
        2,
    )
    assert bench.logical(Command.LWR, LOGICAL, b"\7" * 8) == (b"\7" * 8, 2)
    assert ram(bench)[1] == b"\7\7"


def test_a_datagram_may_meet_a_part_of_a_mapping(bench: SegmentBench) -> None:
    bench.fmmu(0, 0, LOGICAL, 8, RAM, 3)
    bench.slaves[0].controller.memory[RAM : RAM + 8] = b"abcdefgh"
    assert bench.logical(Command.LRW, LOGICAL + 6, b"1234") == (b"gh34", 3)
    assert bytes(bench.slaves[0].controller.memory[RAM : RAM + 8]) == b"abcdef12"
    assert bench.logical(Command.LRW, LOGICAL - 2, b"1234") == (b"12ab", 3)
    assert bench.logical(Command.LRW, LOGICAL + 8, b"12") == (b"12", 0)


def test_outputs_are_taken_before_inputs_replace_them_where_a_map_overlaps(
    bench: SegmentBench,
) -> None:
    for slave in (0, 1):
        bench.fmmu(slave, 0, LOGICAL, 1, RAM + 16, 1)
        bench.fmmu(slave, 1, LOGICAL, 1, RAM, 2)
        bench.slaves[slave].controller.memory[RAM + 16] = 0x50 + slave
    data, counter = bench.logical(Command.LRW, LOGICAL, b"\x11")
    assert (data, counter) == (b"\x51", 6)
    assert [slave.controller.memory[RAM] for slave in bench.slaves[:2]] == [0x11, 0x50]


def test_bits_are_mapped_one_by_one(bench: SegmentBench) -> None:
    memory = bench.slaves[0].controller.memory
    # Three logical bits 6, 7 and 8 on the physical bits 2, 3 and 4.
    bench.fmmu(0, 0, LOGICAL, 2, RAM, 2, bits=(6, 0, 2))
    memory[RAM] = 0b1110_0011
    assert bench.logical(Command.LWR, LOGICAL, b"\x40\x01")[1] == 1
    assert memory[RAM] == 0b1111_0111
    assert bench.logical(Command.LWR, LOGICAL, b"\xbf\xfe")[1] == 1
    assert memory[RAM] == 0b1110_1011
    # Four slaves give a bit each to one byte, and leave the others alone.
    for slave in range(1, 5):
        bench.fmmu(slave, 0, LOGICAL + 9, 1, RAM, 1, bits=(slave, slave, 7))
        bench.slaves[slave].controller.memory[RAM] = 0x80 if slave % 2 else 0x7F
    data, counter = bench.logical(Command.LRD, LOGICAL + 9, b"\xff")
    assert (data, counter) == (bytes((0b1110_1011,)), 4)


def test_a_mailbox_state_can_be_polled_with_the_process_data() -> None:
    bench = SegmentBench()
    bench.pre_op(0)
    bench.fmmu(0, 3, LOGICAL, 1, 0x80D, 1, bits=(0, 0, 3))
    assert bench.logical(Command.LRD, LOGICAL, b"\0") == (b"\0", 1)
    bench.post(0, struct.pack("<HBHB4x", 2 << 12, 0x40, 0x1018, 1))
    assert bench.logical(Command.LRD, LOGICAL, b"\0") == (b"\1", 1)


def test_the_plan_follows_every_change_of_the_map(bench: SegmentBench) -> None:
    bench.fmmu(0, 0, LOGICAL, 1, RAM, 1)
    bench.slaves[0].controller.memory[RAM : RAM + 2] = b"\x01\x02"
    assert bench.logical(Command.LRD, LOGICAL, b"\0") == (b"\x01", 1)
    bench.fmmu(0, 0, LOGICAL, 1, RAM + 1, 1)
    assert bench.logical(Command.LRD, LOGICAL, b"\0") == (b"\x02", 1)
    bench.manager(0, 3, RAM, 4, 0x24)
    assert bench.logical(Command.LRD, LOGICAL, b"\0") == (b"\0", 0), (
        "a slave locks it below SAFE-OP"
    )
    bench.segment.cable.cut(0)
    assert bench.logical(Command.LRD, LOGICAL, b"\0") == (b"\0", 0)


def test_process_data_are_locked_below_safe_op_and_counted_in_op() -> None:
    bench = SegmentBench()
    bench.operate(0, 1)
    words = [(0x06, 0), (0x06, 0)]
    found, counter = bench.cycle(words)
    assert counter == 6
    # Taken before the controlword acts, and handed out with the frame after.
    assert [status & 0x6F for status, _, _ in bench.cycle(words)[0]] == [0x40, 0x40]
    found, counter = bench.cycle(words)
    assert [status & 0x6F for status, _, _ in found] == [0x21, 0x21], "ready to switch on"
    assert bench.request(1, 2) == (2, 0)
    assert bench.cycle(words)[1] == 3
    assert bench.standing(0)[0] == OP


# -- EEPROM ------------------------------------------------------------------------------------


def eeprom(bench: SegmentBench, slave: int, word: int) -> bytes:
    bench.write(slave, 0x502, struct.pack("<HI", 0x0100, word))
    return bench.read(slave, 0x508, 8)


def test_the_eeprom_tells_who_a_slave_is(bench: SegmentBench) -> None:
    bench.write(0, 0x500, b"\x02")
    bench.write(0, 0x500, b"\x00")
    assert bench.number(0, 0x502, 2) & 0x40, "it reads eight bytes at a time"
    vendor, product = struct.unpack("<II", eeprom(bench, 0, 8))
    revision, serial = struct.unpack("<II", eeprom(bench, 0, 12))
    assert (vendor, product, revision) == (0xFB, 0x65510000, 0x01700000)
    assert serial == 0x50080001
    head = eeprom(bench, 0, 0) + eeprom(bench, 0, 4)
    assert head[14] == checksum(head[:14])
    assert struct.unpack("<HHHH", eeprom(bench, 0, 0x18)) == (0x1000, 48, 0x1030, 48)


def test_the_eeprom_is_written_with_leave_only_and_not_while_the_slave_has_it(
    bench: SegmentBench,
) -> None:
    order = struct.pack("<HI", 0x0201, 4) + b"\x34\x12"
    bench.write(0, 0x502, struct.pack("<HI", 0x0200, 4) + b"\x34\x12")
    assert bench.number(0, 0x502, 2) & 0x6000 == 0x6000, "refused without the enable bit"
    bench.write(0, 0x500, b"\x01")
    bench.write(0, 0x502, order)
    bench.write(0, 0x500, b"\x00")
    assert eeprom(bench, 0, 4)[:2] == b"\0\0"
    bench.write(0, 0x502, order)
    assert eeprom(bench, 0, 4)[:2] == b"\x34\x12"
