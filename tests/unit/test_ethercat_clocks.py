"""Distributed clocks: what a master measures, how the clocks follow, when a drive acts."""

from __future__ import annotations

import struct
from unittest.mock import patch

import pytest
from ethercat_bench import (
    INIT,
    LOGICAL,
    MS,
    OP,
    PRE_OP,
    SAFE_OP,
    STATION,
    US,
    SegmentBench,
)

from tonus.sim.ethercat.frames import Command, Datagram, physical
from tonus.sim.ethercat.slaves.clock import DistributedClock

ERROR = 0x10
TIGHT = 10
"""ns; what a controller's own clock resolves"""


def test_a_latch_tells_the_delays_of_the_cable() -> None:
    bench = SegmentBench(hop_ns=700, clock_spread_ppm=0.0)
    bench.address()
    bench.one(Command.BWR, 0, 0x900, 4)
    for slave in range(10):
        near, far, *others = struct.unpack("<IIII", bench.read(slave, 0x900, 16))
        assert others == [0, 0]
        if slave < 9:
            assert (far - near) % (1 << 32) == 2 * 700 * (9 - slave)
        else:
            assert far == 0
        assert bench.number(slave, 0x918, 8) & 0xFFFFFFFF == near


def test_delays_are_those_of_the_slaves_that_answer() -> None:
    bench = SegmentBench(hop_ns=700, clock_spread_ppm=0.0)
    bench.address()
    bench.segment.cable.cut(3)
    bench.one(Command.BWR, 0, 0x900, 4)
    near, far = struct.unpack("<II", bench.read(0, 0x900, 8))
    assert (far - near) % (1 << 32) == 2 * 700 * 2


def align(bench: SegmentBench) -> None:
    bench.address()
    bench.one(Command.BWR, 0, 0x900, 4)
    reference = bench.number(0, 0x918, 8)
    for slave in range(10):
        local = bench.number(slave, 0x918, 8)
        hop = slave * bench.slaves[1].arrival_ns
        offset = reference + hop - local & (1 << 64) - 1
        bench.write(slave, 0x920, struct.pack("<QI", offset, hop))


def differences(bench: SegmentBench) -> list[int]:
    now = bench.now
    times = [slave.clock.system(now) for slave in bench.slaves]
    return [time - times[0] for time in times]


def follow(bench: SegmentBench, cycles: int) -> None:
    for _ in range(cycles):
        bench.now += MS - 10 * US
        bench.one(Command.FRMW, STATION, 0x910, 8)


def test_clocks_that_run_off_are_brought_together_and_kept() -> None:
    bench = SegmentBench(clock_spread_ppm=50.0)
    align(bench)
    bench.wait(100)
    apart = max(map(abs, differences(bench)))
    assert apart > 1000
    follow(bench, 500)
    assert max(map(abs, differences(bench))) <= TIGHT
    bench.slaves[3].set_drift(200e-6)
    follow(bench, 20)
    assert abs(differences(bench)[3]) > 100, "a step of the drift is seen"
    assert abs(struct.unpack("<I", bench.read(3, 0x92C, 4))[0] & 0x7FFFFFFF) > 100
    follow(bench, 500)
    assert max(map(abs, differences(bench))) <= TIGHT


def test_the_delay_register_is_taken_off_when_a_clock_follows() -> None:
    # Not visible to a master with a hop of nanoseconds, so it is made long: 100 us.
    bench = SegmentBench(hop_ns=100_000, clock_spread_ppm=20.0)
    align(bench)
    follow(bench, 600)
    assert max(map(abs, differences(bench))) <= TIGHT
    bench.write(5, 0x928, bytes(4))
    follow(bench, 600)
    assert differences(bench)[5] == pytest.approx(-500_000, abs=50)


def test_a_difference_is_told_with_its_sign() -> None:
    bench = SegmentBench(clock_spread_ppm=0.0)
    align(bench)
    for step, sign in ((-5000, 1), (5000, 0)):
        offset = bench.slaves[2].clock.offset
        bench.write(2, 0x920, struct.pack("<Q", offset + step & (1 << 64) - 1))
        bench.one(Command.FRMW, STATION, 0x910, 8)
        word = struct.unpack("<I", bench.read(2, 0x92C, 4))[0]
        assert (word >> 31, word & 0x7FFFFFFF) == (sign, pytest.approx(5000, abs=700))
        follow(bench, 200)


def test_zeros_are_not_a_time() -> None:
    bench = SegmentBench()
    align(bench)
    before = differences(bench)
    for _ in range(50):
        bench.one(Command.BWR, 0, 0x910, 4)
        bench.one(Command.BWR, 0, 0x910, 8)
    assert all(abs(a - b) < 50 for a, b in zip(before, differences(bench), strict=True))


def test_a_reference_may_be_told_in_32_bits() -> None:
    bench = SegmentBench(clock_spread_ppm=0.0)
    align(bench)
    for _ in range(200):
        bench.now += MS
        time = bench.slaves[0].system_time(bench.now + 10 * US) + 4000 & 0xFFFFFFFF
        bench.one(Command.FPWR, STATION + 1, 0x910, struct.pack("<I", time))
    assert differences(bench)[1] == pytest.approx(4000, abs=TIGHT)


def test_a_clock_never_runs_back_or_jumps_while_it_follows() -> None:
    clock = DistributedClock(0.0, 0)
    before, now = clock.local(0), 0
    for _ in range(100):
        now += MS
        clock.compare(10**12, now)
        assert 0.85 * MS < clock.local(now) - before < 1.15 * MS
        before = clock.local(now)


# -- SYNC0 -------------------------------------------------------------------------------------


def test_a_drive_takes_and_acts_at_sync0_and_not_when_the_frame_passes() -> None:
    bench = SegmentBench()
    bench.operate(0, sync_ns=MS)
    drive = bench.slaves[0].device
    pulse = bench.slaves[0].sync.next
    at = bench.slaves[0].clock.when(pulse, bench.now)
    bench.wait((at - bench.now) / MS - 0.5)
    words = bench.lab.samples.values.item(0)
    bench.cycle([(0x06, 0)])
    assert drive.statusword() & 0x6F == 0x40, "the controlword waits"
    bench.lab.advance(at - 50)
    assert drive.statusword() & 0x6F == 0x40
    bench.lab.advance(at + 50)
    assert drive.statusword() & 0x6F == 0x21
    bench.now = at + 100 * US
    found, counter = bench.cycle([(0x06, 0)])
    assert counter == 3
    assert found[0][0] & 0x6F == 0x40, "inputs were taken before it acted"
    assert found[0][1] == words
    bench.wait(1)
    assert bench.cycle([(0x06, 0)])[0][0][0] & 0x6F == 0x21


def test_sync0_keeps_to_its_cycle_in_system_time() -> None:
    bench = SegmentBench(clock_spread_ppm=100.0)
    start = bench.operate(0, 1, sync_ns=MS)
    for _ in range(50):
        bench.frame(
            Datagram(Command.LRW, LOGICAL, bytes(24)),
            Datagram(Command.FRMW, physical(STATION, 0x910), bytes(8)),
        )
        bench.wait(1)
    for slave in bench.slaves[:2]:
        assert (slave.sync.next - start) % MS == 0
        assert 0 < slave.sync.next - slave.clock.system(bench.now) <= MS
        assert slave.sync.pulses > 45
        missed = slave.device.objects.number(0x1C32, 11)
        assert missed <= 8, "but while it was brought up, outputs came with every pulse"


def test_missed_outputs_are_counted() -> None:
    bench = SegmentBench()
    bench.operate(0, sync_ns=MS)
    before = struct.unpack("<H", bench.upload(0, 0x1C32, 11))[0]
    bench.wait(20)
    after = struct.unpack("<H", bench.upload(0, 0x1C32, 11))[0]
    assert after - before == 20


def test_op_waits_for_the_first_pulse_and_gives_up_when_none_comes() -> None:
    bench = SegmentBench()
    bench.pre_op(0)
    bench.map(0)
    now = bench.number(0, 0x910, 8)
    bench.write(0, 0x9A0, struct.pack("<I", MS))
    bench.write(0, 0x990, struct.pack("<Q", now + 50 * MS))
    bench.write(0, 0x981, b"\3")
    assert bench.request(0, SAFE_OP) == (SAFE_OP, 0)
    assert bench.request(0, OP) == (SAFE_OP, 0)
    bench.wait(55)
    assert bench.standing(0) == (OP, 0)
    assert bench.request(0, INIT) == (INIT, 0)
    assert bench.request(0, PRE_OP) == (PRE_OP, 0)
    bench.write(0, 0x981, b"\0")
    bench.write(0, 0x990, struct.pack("<Q", now))
    bench.write(0, 0x981, b"\3")
    assert bench.request(0, SAFE_OP) == (SAFE_OP, 0)
    assert bench.request(0, OP) == (SAFE_OP, 0)
    bench.wait(1100)
    assert bench.standing(0) == (SAFE_OP | ERROR, 0x2D), "its start time had passed"


def test_sync0_that_is_taken_away_in_op_is_an_error() -> None:
    bench = SegmentBench()
    bench.operate(0, sync_ns=MS)
    bench.write(0, 0x981, b"\0")
    assert bench.standing(0) == (SAFE_OP | ERROR, 0x2C)


def test_a_system_time_that_is_set_past_the_next_pulse_ends_the_pulses() -> None:
    bench = SegmentBench()
    bench.operate(0, sync_ns=MS)
    offset = bench.slaves[0].clock.offset
    bench.write(0, 0x920, struct.pack("<Q", offset + 10**15 & (1 << 64) - 1))
    pulses = bench.slaves[0].sync.pulses
    bench.wait(20)
    assert bench.slaves[0].sync.pulses == pulses


def test_drives_with_one_sync0_sample_the_same_instant() -> None:
    bench = SegmentBench(clock_spread_ppm=10.0)
    bench.operate(0, 1, 2, 3, sync_ns=MS)
    instants: list[int] = []
    samples, sample = bench.lab.samples, bench.lab.samples.at
    samples.at = lambda now_ns: (instants.append(now_ns), sample(now_ns))[1]
    samples.values[samples.error : samples.error + 4] = 0x1000, 0x2000, 0x3000, 0x4000
    for slave in bench.slaves[:4]:
        slave.input_area[:] = bytes(len(slave.input_area))
    bench.wait(1)
    assert len(set(instants)) == 1
    for axis, slave in enumerate(bench.slaves[:4]):
        words = [samples.values[place] for place in slave.process_data.places]
        assert None not in slave.process_data.places
        assert bytes(slave.input_area) == struct.pack(f"<{slave.process_data.letters}", *words), (
            axis
        )


def test_sync0_of_all_at_once_does_what_it_does_slave_by_slave() -> None:
    """Outputs that change and that do not, and one frame in four that does not come."""
    together, alone = SegmentBench(), SegmentBench()
    for bench in (together, alone):
        bench.operate(0, 1, 2, 3, sync_ns=MS)
    with patch("tonus.sim.ethercat.segment.plan", lambda *_: None):
        alone.segment.restated()
        seen = [_course(alone)]
    seen.append(_course(together))
    assert any(planned is not None for planned in together.segment._pulses.values())
    assert seen[0] == seen[1]


def _course(bench: SegmentBench) -> list[bytes]:
    """What four drives show and do in 40 cycles on the way to Operation Enabled and beyond."""
    found = []
    for cycle in range(40):
        word = (6, 7, 15, 15)[min(cycle // 3, 3)]
        for number, slave in enumerate(bench.slaves[:4]):
            if cycle % 4 != 3:
                outputs = struct.pack("<Hh", word, number * 10 * (cycle // 5))
                slave.outputs_came(outputs, bench.lab.now_ns)
        bench.wait(1)
        for slave in bench.slaves[:4]:
            missed = slave.device.objects.number(0x1C32, 11)
            found.append(bytes(slave.controller.memory) + bytes([slave.sync.pulses & 0xFF, missed]))
        found.append(bench.lab.plant.state.tobytes())
    return found
