"""Two ends of a ring as one port: every slave is heard while one cable is out, and one lost frame
makes nobody silent."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from ethercat_bench import LOGICAL, STATION, SegmentBench

from tonus.drivers.ethercat.frames import INDEX_AT
from tonus.drivers.ethercat.ring import injected_ring
from tonus.drivers.ethercat.status import StatusFrames
from tonus.sim.ethercat.frames import Command, Datagram, build, parse
from tonus.sim.ethercat.ring import Ring

SLAVES = 10
STATIONS = [STATION + place for place in range(SLAVES)]
NEAR, FAR = 0, 1
RAM = 0x2000
"""process memory no sync manager guards"""


class Cable:
    """A ring's two ends at the master's cards."""

    def __init__(self) -> None:
        self.bench = SegmentBench(ring=True)
        self.bench.address()
        self.lost: set[int] = set()
        """copies that do not come back, by the end they went in at"""
        self._ring = Ring(self.bench.segment)

    def through(self, frame: bytes, at_ns: int, end: int) -> tuple[bytes, int] | None:
        self.bench.now = at_ns
        answer = self._ring.through(frame, at_ns, end)
        return None if end in self.lost else answer

    def states(self) -> StatusFrames:
        port = injected_ring(self.through, lambda: self.bench.now + 10_000)
        return StatusFrames(port, STATIONS)


@pytest.fixture
def cable() -> Cable:
    return Cable()


@pytest.fixture
def states(cable: Cable) -> StatusFrames:
    return cable.states()


def _heard(states: StatusFrames) -> list[bool] | None:
    states.look()
    found = states.looked()
    return None if found is None else [status is not None for status in found]


def test_in_a_closed_ring_all_are_heard_and_nothing_is_open(states: StatusFrames) -> None:
    assert _heard(states) == [True] * SLAVES
    assert states.open_after is None


@pytest.mark.parametrize("place", range(SLAVES))
def test_one_broken_cable_is_found_and_silences_nobody(
    cable: Cable, states: StatusFrames, place: int
) -> None:
    cable.bench.segment.cable.cut(place)
    assert _heard(states) == [True] * SLAVES
    assert states.open_after == place
    cable.bench.segment.cable.mend()
    assert _heard(states) == [True] * SLAVES
    assert states.open_after is None


def test_two_broken_cables_silence_those_between_them(cable: Cable, states: StatusFrames) -> None:
    cable.bench.segment.cable.cut(3)
    cable.bench.segment.cable.cut(6)
    assert _heard(states) == [True] * 3 + [False] * 3 + [True] * 4
    assert states.open_after == 3


def test_a_slave_without_power_is_the_only_silent_one(cable: Cable, states: StatusFrames) -> None:
    cable.bench.segment.cable.switch(4, on=False)
    assert _heard(states) == [place != 4 for place in range(SLAVES)]
    assert states.open_after == 4


@pytest.mark.parametrize(("end", "heard"), [(NEAR, False), (FAR, True)])
def test_a_copy_that_is_lost_in_a_closed_ring_makes_nobody_silent(
    cable: Cable, states: StatusFrames, end: int, heard: bool
) -> None:
    cable.lost = {end}
    assert _heard(states) == ([True] * SLAVES if heard else None)
    cable.lost = set()
    assert _heard(states) == [True] * SLAVES


@pytest.mark.parametrize("end", [NEAR, FAR])
def test_a_copy_that_is_lost_in_an_open_ring_makes_nobody_silent(
    cable: Cable, states: StatusFrames, end: int
) -> None:
    cable.bench.segment.cable.cut(5)
    cable.lost = {end}
    assert _heard(states) is None
    cable.lost = set()
    assert _heard(states) == [True] * SLAVES


def test_late_copies_of_an_earlier_frame_are_no_pair(cable: Cable) -> None:
    """Both have been at no slave: for a pair they would say that all are silent."""
    late: list[tuple[bytes, int]] = []
    looks = 0

    def through(frame: bytes, at_ns: int, end: int) -> tuple[bytes, int] | None:
        answer = cable.through(frame, at_ns, end)
        if end == FAR and answer is not None:
            late.append(answer)
        return late.pop(0) if looks else None

    states = StatusFrames(injected_ring(through, lambda: cable.bench.now + 10_000), STATIONS)
    assert _heard(states) is None
    looks += 1
    assert _heard(states) is None
    assert not late


def test_an_end_that_is_out_leaves_the_other(cable: Cable, states: StatusFrames) -> None:
    cable.bench.segment.cable.cut(0)
    cable.lost = {NEAR}
    assert _heard(states) == [True] * SLAVES
    assert states.open_after == 0


def test_a_state_is_set_on_both_sides_of_a_break(cable: Cable, states: StatusFrames) -> None:
    cable.bench.segment.cable.cut(5)
    states.control(dict.fromkeys(range(SLAVES), 0x02))
    asked = [slave.controller.memory[0x120] for slave in cable.bench.slaves]
    assert asked == [0x02] * SLAVES


@pytest.mark.parametrize(
    "changed",
    [
        lambda frame: frame[:INDEX_AT] + bytes((frame[INDEX_AT] ^ 0x40,)) + frame[INDEX_AT + 1 :],
        lambda frame: frame[: INDEX_AT + 1],
        lambda frame: frame[: len(frame) // 2],
    ],
    ids=["another index", "a header", "half"],
)
def test_a_stranger_or_a_part_of_a_frame_is_no_answer_and_hides_none(
    cable: Cable, changed: Callable[[bytes], bytes]
) -> None:
    damaged = {FAR}

    def through(frame: bytes, at_ns: int, end: int) -> tuple[bytes, int] | None:
        answer = cable.through(frame, at_ns, end)
        return answer and (changed(answer[0]) if end in damaged else answer[0], answer[1])

    states = StatusFrames(injected_ring(through, lambda: cable.bench.now + 10_000), STATIONS)
    assert _heard(states) == [True] * SLAVES
    damaged.add(NEAR)
    assert _heard(states) is None


@pytest.mark.parametrize("place", range(SLAVES + 1))
def test_process_data_pass_every_slave_on_either_side_of_a_broken_cable(
    cable: Cable, place: int
) -> None:
    bench = cable.bench
    for number, slave in enumerate(bench.slaves):
        bench.fmmu(number, 0, LOGICAL + number, 1, RAM, 1)
        slave.controller.memory[RAM] = number + 1
    bench.segment.cable.cut(place)
    back = Ring(bench.segment).around(
        build([Datagram(Command.LRD, LOGICAL, bytes(SLAVES))]), bench.now
    )
    assert back is not None
    found = parse(back)[0]
    assert (found.data, found.counter) == (bytes(range(1, SLAVES + 1)), SLAVES)
