"""A logical datagram does to all slaves at once what it does to one after the other."""

from __future__ import annotations

from functools import cache
from unittest.mock import patch

from ethercat_bench import LOGICAL, SegmentBench
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tonus.sim.ethercat.frames import Command, Datagram, build

SLAVES = (0, 1, 2)
RAM = 0x2000
OUTPUTS, INPUTS = 4, 8
"""bytes of each drive's process data"""
USUAL = tuple(
    tuple(
        (LOGICAL + first + size * slave, size, where, 0, way)
        for first, size, where, way in ((0, OUTPUTS, "outputs", 2), (12, INPUTS, "inputs", 1))
    )
    for slave in SLAVES
)
"""As a master lays it out: outputs of all, then inputs of all."""

Mapping = tuple[int, int, str, int, int]
"""Logical address, bytes, area of the slave and place in it, way."""


def mapping() -> st.SearchStrategy[Mapping]:
    return st.tuples(
        st.integers(LOGICAL - 2, LOGICAL + 36),
        st.sampled_from([1, OUTPUTS, INPUTS, 11]),
        st.sampled_from(["outputs", "inputs", "ram", "registers"]),
        st.sampled_from([0, 0, 0, 1]),
        st.sampled_from([1, 2, 3]),
    )


@st.composite
def rows(draw: st.DrawFn) -> tuple[tuple[Mapping, ...], ...]:
    """Process data in any order, and one thing that no master would do."""
    ways = draw(st.permutations([(slave, way) for slave in SLAVES for way in (1, 2)]))
    if draw(st.booleans()):
        ways = sorted(ways, key=lambda each: -each[1])
    oddity = draw(st.sampled_from(["none", "gap", "overlap", "short", "more"]))
    odd = draw(st.integers(0, len(ways) - 1))
    at = LOGICAL
    found: dict[int, list[Mapping]] = {slave: [] for slave in SLAVES}
    for number, (slave, way) in enumerate(ways):
        size, where = (INPUTS, "inputs") if way == 1 else (OUTPUTS, "outputs")
        place = 0
        if number == odd:
            at += {"gap": 1, "overlap": -OUTPUTS}.get(oddity, 0)
            place = int(oddity == "short")  # the first byte is left out
        found[slave].append((at, size - place, where, place, way))
        at += size - place
        if number == odd and oddity == "more":
            found[slave].append(draw(mapping()))
    return tuple(tuple(own) for own in found.values())


@cache
def benches() -> tuple[SegmentBench, SegmentBench]:
    made = SegmentBench(), SegmentBench()
    for bench in made:
        bench.operate(*SLAVES)
    return made


def lay_out(bench: SegmentBench, maps: tuple[tuple[Mapping, ...], ...]) -> None:
    for slave, own in zip(SLAVES, maps, strict=True):
        kind = bench.slaves[slave].kind
        areas = {"outputs": kind.outputs, "inputs": kind.inputs, "ram": RAM, "registers": 0x130}
        for number in range(3):
            bench.write(slave, 0x600 + 16 * number, bytes(16))
        for number, (logical, size, where, place, way) in enumerate(own):
            bench.fmmu(slave, number, logical, size, areas[where] + place, way)


def seen(bench: SegmentBench, command: Command, start: int, data: bytes) -> list[object]:
    """All that a datagram does: the answer, every slave's memory and outputs, who acts on it."""
    bench.now += 250_000
    frame = build([Datagram(command, start, data)])
    answer = bench.segment.answer(frame, bench.now)
    slaves = bench.slaves
    found: list[object] = [answer, list(bench.segment._touched)]
    found += [bytes(slave.controller.memory) for slave in slaves]
    found += [(bytes(slave._outputs), slave.fresh) for slave in slaves]
    bench.segment.settle()
    return found + [bytes(slave.controller.memory) for slave in slaves]


@settings(max_examples=300, deadline=None)
@example(USUAL, [(Command.LRW, 0, 36)], b"\1" * 48)
@given(
    rows(),
    st.lists(
        st.tuples(
            st.sampled_from([Command.LRW, Command.LRW, Command.LRD, Command.LWR]),
            st.sampled_from([0, 0, 0, -2, 3]),
            st.sampled_from([36, 42, 48, 17]),
        ),
        min_size=1,
        max_size=3,
    ),
    st.binary(min_size=48, max_size=48),
)
def test_straight_is_slave_by_slave(
    maps: tuple[tuple[Mapping, ...], ...],
    datagrams: list[tuple[Command, int, int]],
    data: bytes,
) -> None:
    straight, by_parts = benches()
    for bench in (straight, by_parts):
        lay_out(bench, maps)
    for command, offset, size in datagrams:
        given_data = data[:size]
        found = seen(straight, command, LOGICAL + offset, given_data)
        with patch("tonus.sim.ethercat.plan._straighten", lambda _: None):
            expected = seen(by_parts, command, LOGICAL + offset, given_data)
        assert found == expected


def test_the_usual_map_is_straight() -> None:
    """Or the comparison above compares nothing."""
    bench, _ = benches()
    lay_out(bench, USUAL)
    seen(bench, Command.LRW, LOGICAL, bytes(36))
    (plan,) = bench.segment._plans.values()
    assert plan.straight is not None
    assert [area.nbytes for _, area in plan.straight.areas] == [OUTPUTS] * len(SLAVES)
