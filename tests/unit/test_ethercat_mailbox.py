"""Mailboxes: full, repeated, lost; CoE with segments, complete access, information, emergencies."""

from __future__ import annotations

import struct

import pytest
from ethercat_bench import INIT, PRE_OP, STATION, SegmentBench

from tonus.sim.devices.objects import Entry, Kind
from tonus.sim.ethercat.frames import Command

DRIVE, AMPLIFIER = 0, 8
LONG = bytes(range(32, 127)) * 3
UPLOAD = struct.pack("<HBHB4x", 2 << 12, 0x40, 0x1018, 1)
VENDOR = struct.pack("<HBHBI", 3 << 12, 0x43, 0x1018, 1, 0xFB)


@pytest.fixture
def bench() -> SegmentBench:
    bench = SegmentBench()
    bench.pre_op(DRIVE, AMPLIFIER)
    return bench


def toggle_repeat(bench: SegmentBench, slave: int) -> None:
    """As a master asks: status and activation of sync manager 1 written as one word."""
    status, active = bench.read(slave, 0x80D, 2)
    bench.write(slave, 0x80D, bytes((status, active ^ 2)))


# -- the box -----------------------------------------------------------------------------------


def test_a_full_box_is_read_once(bench: SegmentBench) -> None:
    assert bench.fetch(DRIVE) is None
    assert not bench.read(DRIVE, 0x80D, 1)[0] & 8
    assert bench.post(DRIVE, UPLOAD) == 1
    assert bench.read(DRIVE, 0x80D, 1)[0] & 8
    assert bench.fetch(DRIVE) == (3 | 1 << 4, VENDOR)
    assert bench.fetch(DRIVE) is None


def test_a_box_is_taken_from_its_start_to_its_end(bench: SegmentBench) -> None:
    kind = bench.slaves[DRIVE].kind
    box = struct.pack("<HHBB", 10, 0, 0, 3 | 1 << 4) + UPLOAD
    box = box.ljust(kind.mailbox_bytes, b"\0")

    def write(start: int, data: bytes) -> int:
        return bench.one(Command.FPWR, STATION, kind.receive_mailbox + start, data)[1]

    assert write(8, box[8:]) == 0, "not from its start"
    assert write(0, box + b"\0") == 0, "beyond its end"
    assert write(0, box[:20]) == 1
    assert bench.fetch(DRIVE) is None, "complete only with its last byte"
    assert write(20, box[20:]) == 1
    assert bench.one(Command.FPRD, STATION, kind.send_mailbox + 4, 4)[1] == 0
    assert bench.one(Command.FPRD, STATION, kind.send_mailbox, 16)[1] == 1
    assert bench.read(DRIVE, 0x80D, 1)[0] & 8, "read in part"
    assert bench.one(Command.FPRD, STATION, kind.send_mailbox + 16, 32)[1] == 1
    assert not bench.read(DRIVE, 0x80D, 1)[0] & 8
    assert bench.one(Command.FPRD, STATION, kind.receive_mailbox, 48)[1] == 0, "the wrong way"
    assert bench.one(Command.FPWR, STATION, kind.send_mailbox, bytes(48))[1] == 0


def test_messages_wait_behind_one_that_is_not_read(bench: SegmentBench) -> None:
    for index in (0x1018, 0x1018, 0x5FFF):
        assert bench.post(DRIVE, struct.pack("<HBHB4x", 2 << 12, 0x40, index, 1)) == 1
    found = [bench.fetch(DRIVE) for _ in range(4)]
    assert [f and f[0] >> 4 for f in found] == [1, 2, 3, None]
    assert found[2] is not None
    assert found[2][1] == struct.pack("<HBHBI", 2 << 12, 0x80, 0x5FFF, 1, 0x06020000)


def test_a_message_that_comes_again_is_not_carried_out_again(bench: SegmentBench) -> None:
    saved = bench.slaves[DRIVE].device.objects.find(0x210C, 1)
    write = struct.pack("<HBHBI", 2 << 12, 0x23, 0x210C, 1, 7)
    assert bench.post(DRIVE, write, counter=3) == 1
    assert bench.fetch(DRIVE) is not None
    saved.value = 0
    assert bench.post(DRIVE, write, counter=3) == 1, "taken, and thrown away"
    assert bench.fetch(DRIVE) is None
    assert saved.value == 0
    assert bench.post(DRIVE, write, counter=4) == 1
    assert bench.fetch(DRIVE) is not None
    assert saved.value == 7
    assert bench.post(DRIVE, write, counter=0) == 1, "a counter of 0 is none"
    assert bench.fetch(DRIVE) is not None


def test_a_new_connection_begins_to_count_anew(bench: SegmentBench) -> None:
    assert bench.post(DRIVE, UPLOAD, counter=1) == 1
    assert bench.fetch(DRIVE) is not None
    assert bench.request(DRIVE, INIT) == (INIT, 0)
    assert bench.post(DRIVE, UPLOAD, counter=1) == 0, "there is no mailbox in INIT"
    assert bench.request(DRIVE, PRE_OP) == (PRE_OP, 0)
    assert bench.post(DRIVE, UPLOAD, counter=1) == 1
    assert bench.fetch(DRIVE) == (3 | 1 << 4, VENDOR)


def test_the_last_message_is_repeated_when_it_was_lost(bench: SegmentBench) -> None:
    assert bench.post(DRIVE, UPLOAD) == 1
    assert bench.fetch(DRIVE) == (3 | 1 << 4, VENDOR)
    toggle_repeat(bench, DRIVE)
    assert bench.read(DRIVE, 0x80E, 2) == b"\x03\x02", "acknowledged"
    assert bench.fetch(DRIVE) == (3 | 1 << 4, VENDOR)
    assert bench.fetch(DRIVE) is None


def test_a_message_that_is_still_there_is_not_replaced_by_a_repetition(
    bench: SegmentBench,
) -> None:
    bench.ask(DRIVE, UPLOAD)
    assert bench.post(DRIVE, struct.pack("<HBHB4x", 2 << 12, 0x40, 0x1018, 2)) == 1
    toggle_repeat(bench, DRIVE)
    assert bench.read(DRIVE, 0x80F, 1) == b"\x02"
    found = bench.fetch(DRIVE)
    assert found is not None
    assert found[1][6:] == struct.pack("<I", 0x65510000)
    assert bench.fetch(DRIVE) is None


def test_what_a_slave_does_not_speak_is_refused(bench: SegmentBench) -> None:
    for protocol in (1, 2, 4, 5, 7, 15):
        assert bench.post(DRIVE, bytes(8), protocol) == 1
        found = bench.fetch(DRIVE)
        assert found is not None
        assert (found[0] & 0x0F, found[1]) == (0, struct.pack("<HH", 1, 2))
    assert bench.post(DRIVE, b"", 3) == 1
    found = bench.fetch(DRIVE)
    assert found is not None
    assert found[1] == struct.pack("<HH", 1, 6), "too short"
    head = struct.pack("<HHBB", 60, 0, 0, 3 | 2 << 4).ljust(48, b"\0")
    assert bench.one(Command.FPWR, STATION, 0x1000, head)[1] == 1
    found = bench.fetch(DRIVE)
    assert found is not None
    assert found[1] == struct.pack("<HH", 1, 8), "longer than the box"


# -- SDO ---------------------------------------------------------------------------------------


def with_texts(bench: SegmentBench, slave: int) -> None:
    objects = bench.slaves[slave].device.objects
    objects.add(0x2F00, 0, Entry("Text", Kind.STRING, "rw", LONG.decode()))


@pytest.mark.parametrize("slave", [DRIVE, AMPLIFIER])
def test_values_of_any_length_go_both_ways(bench: SegmentBench, slave: int) -> None:
    with_texts(bench, slave)
    assert bench.upload(slave, 0x2F00) == LONG
    for length in (1, 4, 5, 7, 31, 32, 33, 39, 40, 71, 72, 73, 112, 113, 280):
        assert bench.download(slave, 0x2F00, 0, LONG[:length]) == 0
        assert bench.slaves[slave].device.objects.find(0x2F00, 0).value == LONG[:length].decode()
        assert bench.upload(slave, 0x2F00) == LONG[:length]


def test_a_wrong_toggle_or_a_segment_of_nothing_ends_a_transfer(bench: SegmentBench) -> None:
    with_texts(bench, DRIVE)
    segment = struct.pack("<HB7x", 2 << 12, 0x60)

    def refused(answer: bytes, code: int) -> bool:
        return answer[:3] == struct.pack("<HB", 2 << 12, 0x80) and (
            struct.unpack_from("<I", answer, 6)[0] == code
        )

    assert refused(bench.ask(DRIVE, segment), 0x05040001)
    bench.ask(DRIVE, struct.pack("<HBHB4x", 2 << 12, 0x40, 0x2F00, 0))
    assert refused(bench.ask(DRIVE, segment[:2] + b"\x70" + bytes(7)), 0x05030000)
    assert refused(bench.ask(DRIVE, segment), 0x05040001), "and nothing is left of it"
    begin = struct.pack("<HBHBI", 2 << 12, 0x21, 0x2F00, 0, 40) + b"x" * 32
    bench.ask(DRIVE, begin)
    assert refused(bench.ask(DRIVE, struct.pack("<HB", 2 << 12, 0x01) + b"y" * 9), 0x06070010)
    bench.ask(DRIVE, begin)
    assert refused(bench.ask(DRIVE, struct.pack("<HB", 2 << 12, 0x0D) + b"y" * 7), 0x06070013)
    bench.ask(DRIVE, begin)
    assert bench.post(DRIVE, struct.pack("<HBHBI", 2 << 12, 0x80, 0x2F00, 0, 0x08000000)) == 1
    assert bench.fetch(DRIVE) is None, "the master's own abort is not answered"
    assert bench.slaves[DRIVE].device.objects.find(0x2F00, 0).value == LONG.decode()


def test_refusals_go_out_as_requests_with_their_code(bench: SegmentBench) -> None:
    # A response in its place would pass for success with a real master.
    answer = bench.ask(DRIVE, struct.pack("<HBHBI", 2 << 12, 0x2B, 0x6041, 0, 0))
    assert answer == struct.pack("<HBHBI", 2 << 12, 0x80, 0x6041, 0, 0x06010002)
    for index, sub, data, code in (
        (0x5FFF, 0, b"\0", 0x06020000),
        (0x3001, 9, b"\0", 0x06090011),
        (0x6071, 0, bytes(4), 0x06070010),
        (0x6080, 0, bytes(2), 0x06070013),
        (0x60C2, 1, b"\x65", 0x06090030),
        (0x1016, 1, bytes(4), 0x06020000),
    ):
        assert bench.download(DRIVE, index, sub, data) == code


def test_a_mapping_is_written_in_order_and_in_pre_op_only(bench: SegmentBench) -> None:
    def write(index: int, sub: int, value: int, size: int) -> int:
        return bench.download(DRIVE, index, sub, value.to_bytes(size, "little"))

    assert write(0x1600, 1, 0x60400010, 4) == 0x06010003
    assert write(0x1600, 0, 0, 1) == 0
    assert write(0x1600, 1, 0x60410010, 4) == 0x06040041, "an input"
    assert write(0x1600, 1, 0x5FFF0010, 4) == 0x06040041, "nothing"
    assert write(0x1600, 1, 0x60400020, 4) == 0x06040041, "the wrong length"
    assert write(0x1600, 0, 2, 1) == 0x06040041, "the second entry is empty"
    assert write(0x1600, 0, 1, 1) == 0
    assert write(0x1C12, 1, 0x1601, 2) == 0x06010003
    assert write(0x1C12, 0, 0, 1) == 0
    assert write(0x1C12, 1, 0x1604, 2) == 0x06090030
    assert write(0x1C12, 1, 0x1A00, 2) == 0x06090030
    assert write(0x1C12, 0, 2, 1) == 0x06090030, "one PDO at a time"
    assert write(0x1A00, 0, 0, 1) == 0
    for place in range(1, 13):
        assert write(0x1A00, place, 0x60640020, 4) == 0
    assert write(0x1A00, 0, 11, 1) == 0x06040042, "44 bytes"
    assert write(0x1A00, 0, 10, 1) == 0
    bench = SegmentBench()
    bench.operate(0)
    assert bench.download(0, 0x1600, 0, b"\0") == 0x08000022
    assert bench.download(0, 0x1C13, 1, b"\0\x1a") == 0x08000022


# -- complete access ---------------------------------------------------------------------------


def test_a_drive_has_no_complete_access_and_an_amplifier_has(bench: SegmentBench) -> None:
    content = struct.pack("<HBHB4x", 2 << 12, 0x50, 0x1018, 0)
    assert bench.ask(DRIVE, content)[6:] == struct.pack("<I", 0x06010004)
    head = struct.pack("<H", 4)
    identity = struct.pack("<IIII", 0xFFFF, 0x408, 1, 9)
    assert bench.upload(AMPLIFIER, 0x1018, 0, whole=True) == head + identity
    assert bench.upload(AMPLIFIER, 0x1018, 1, whole=True) == identity


def test_an_object_is_written_as_a_whole_or_not_at_all(bench: SegmentBench) -> None:
    words = [0x91300120 | n << 8 for n in range(3)]
    data = struct.pack("<HIII", 3, *words)
    assert bench.download(AMPLIFIER, 0x1A00, 0, data, whole=True) == 0
    assert bench.upload(AMPLIFIER, 0x1A00, 0, whole=True) == data
    assert bench.upload(AMPLIFIER, 0x1A00, 0) == b"\3"
    wrong = struct.pack("<HII", 2, words[0], 0x60400010)
    assert bench.download(AMPLIFIER, 0x1A00, 0, wrong, whole=True) == 0x06040041
    assert bench.upload(AMPLIFIER, 0x1A00, 0) == b"\0", "the list is left empty"
    assert bench.download(AMPLIFIER, 0x1018, 0, bytes(18), whole=True) == 0x06010002


# -- information and emergencies ---------------------------------------------------------------


def information(bench: SegmentBench, slave: int, request: bytes) -> bytes:
    """What all fragments of an answer hold, behind the opcode."""
    assert bench.post(slave, struct.pack("<H", 8 << 12) + request) == 1
    data, left = b"", 1
    while left:
        found = bench.fetch(slave)
        assert found is not None
        _, opcode, _, left = struct.unpack_from("<HBBH", found[1])
        assert bool(opcode & 0x80) == bool(left)
        data += found[1][6:]
    return data


def test_a_slave_tells_of_its_objects(bench: SegmentBench) -> None:
    objects = bench.slaves[DRIVE].device.objects
    listed = information(bench, DRIVE, struct.pack("<BBHH", 1, 0, 0, 1))
    indices = struct.unpack(f"<{len(listed) // 2}H", listed)[1:]
    assert list(indices) == sorted({index for index, _ in objects.entries})
    described = information(bench, DRIVE, struct.pack("<BBHH", 3, 0, 0, 0x6064))
    assert described == struct.pack("<HHBB", 0x6064, 4, 0, 7) + b"Position actual value"
    entry = information(bench, DRIVE, struct.pack("<BBHHBB", 5, 0, 0, 0x6064, 0, 7))
    assert entry == struct.pack("<HBBHHH", 0x6064, 0, 7, 4, 32, 0x87) + b"Position actual value"
    refused = information(bench, DRIVE, struct.pack("<BBHH", 3, 0, 0, 0x5FFF))
    assert refused == struct.pack("<I", 0x06020000)


def test_an_error_of_the_drive_is_an_emergency(bench: SegmentBench) -> None:
    bench.slaves[DRIVE].device.fail(0x8611)
    found = bench.fetch(DRIVE)
    assert found is not None
    assert found[1] == struct.pack("<HHB5x", 1 << 12, 0x8611, 0x80)


def test_emergencies_of_a_master_that_does_not_listen_do_not_grow_without_end(
    bench: SegmentBench,
) -> None:
    for _ in range(200):
        bench.slaves[DRIVE].device.fail(0x8611)
    count = 0
    while bench.fetch(DRIVE) is not None:
        count += 1
    assert 1 < count < 50
    assert bench.upload(DRIVE, 0x1018, 1) == struct.pack("<I", 0xFB)


def test_a_slave_without_outputs_has_an_empty_assignment(bench: SegmentBench) -> None:
    """A master reads 0x1C12 of every slave, and an abort there would look like a fault."""
    assert bench.upload(AMPLIFIER, 0x1C12, 0) == b"\0"
    assert bench.download(AMPLIFIER, 0x1C12, 0, b"\1") == 0x06010002
