"""What a frame costs in the emulated EtherCAT segment, and what each slave adds."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

from tests.bench.measure import Figure, microseconds
from tonus.sim.devices.epos4.drive import Epos4
from tonus.sim.devices.timers import Callback
from tonus.sim.ethercat.frames import Command, Datagram, build, parse, physical
from tonus.sim.ethercat.segment import Segment
from tonus.sim.ethercat.slaves.identity import EPOS4
from tonus.sim.ethercat.slaves.slave import Slave

sys.path.insert(0, str(Path(__file__).parents[1]))  # where the tests' own helpers lie
from ethercat_bench import LOGICAL, STATION, SegmentBench

COUNTS = (1, 8, 32)
_BYTES = 12
"""Outputs and inputs of a drive."""
_ROUNDS = 20


class _Still:
    """A lab in which nothing happens, so that only frames cost."""

    now_ns = 0

    def advance(self, to_ns: int) -> None:
        """Time stands still."""

    def call_at(self, at_ns: int, callback: Callback) -> None:
        """Nothing will happen."""


def segment() -> list[Figure]:
    """Frames of a cycle for one, eight and thirty-two drives."""
    cycles = {count: _cost(count, clocks=False) for count in COUNTS}
    timed = {count: _cost(count, clocks=True) for count in COUNTS}
    slope = (cycles[32] - cycles[1]) / 31
    state = _state()
    straight, by_parts = both_ways()
    return [
        Figure(
            "EtherCAT: an LRW through eight emulated drives",
            straight,
            "us",
            "the same, one drive after the other",
            by_parts,
            note=f"1 drive {cycles[1]:.1f}, 32 drives {cycles[32]:.1f} us; drives not computed",
        ),
        Figure("EtherCAT: what one more drive adds to an LRW", slope, "us"),
        Figure(
            "EtherCAT: the same with the reference clock's time (FRMW)",
            timed[8],
            "us",
            note=f"1 drive {timed[1]:.1f}, 32 drives {timed[32]:.1f} us",
        ),
        Figure("EtherCAT: a state read (FPRD)", state, "us"),
    ]


def _drives(count: int) -> tuple[SegmentBench, Segment]:
    """A segment of drives in OP, and the bench of a lab whose samples they use."""
    bench = SegmentBench()
    made = Segment("bench", _Still(), hop_ns=800)

    def make(axis: int) -> Callable[[int], Slave]:
        device = Epos4(axis % 8, axis + 1, bench.lab.samples, bench.lab)
        return lambda number: Slave(device, EPOS4, number, made, bench.lab)

    for axis in range(count):
        made.attach(make(axis))
    bench.segment, bench.slaves, bench.count = made, made.slaves, count
    bench._mail = [0] * count
    bench.operate(*range(count))
    return bench, made


def _cost(count: int, *, clocks: bool) -> float:
    _, made = _drives(count)
    datagrams = [Datagram(Command.LRW, LOGICAL, bytes(_BYTES * count))]
    if clocks:
        datagrams.append(Datagram(Command.FRMW, physical(STATION, 0x910), bytes(8)))
    frame = build(datagrams)
    answer = made.answer(frame, 0)
    assert answer is not None
    assert parse(answer)[0].counter == 3 * count
    return microseconds(lambda: made.answer(frame, 0), 3000)


def both_ways() -> tuple[float, float]:
    """us of an LRW through eight drives, all at once and, as maps that are not plain need it, one
    after the other; in alternation, so that both meet the same noise."""
    frame = build([Datagram(Command.LRW, LOGICAL, bytes(_BYTES * 8))])
    _, straight = _drives(8)
    _, by_parts = _drives(8)
    with patch("tonus.sim.ethercat.plan._straighten", lambda _: None):
        by_parts.answer(frame, 0)  # it remembers how
    rounds = [
        [microseconds(lambda made=made: made.answer(frame, 0), 200, 1) for made in both]
        for both in [(straight, by_parts)] * _ROUNDS
    ]
    first, second = (min(of_one) for of_one in zip(*rounds, strict=True))
    return first, second


def _state() -> float:
    _, made = _drives(8)
    frame = build([Datagram(Command.FPRD, physical(STATION + 3, 0x130), bytes(6))])
    return microseconds(lambda: made.answer(frame, 0), 3000)
