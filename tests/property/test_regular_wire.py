"""Compiled or object by object: whatever happens on the buses, every bit of it is the same."""

from __future__ import annotations

import struct
from contextlib import suppress
from typing import Any

import can
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lab_bench import Bench

from tonus.config.schema.faults import (
    Babble,
    Corruption,
    Delay,
    DriveError,
    Duplicate,
    Fault,
    Loss,
    PowerCycle,
    Replug,
    Unplug,
)
from tonus.sim.can.plugin import LocalBus, TonusBus
from tonus.sim.can.wire.inbox import FRAMES

_ON = (0x06, 0x07, 0x0F)
_MOST = 1000
_CHANNEL = st.sampled_from(["can0", "can3"])
_NODE = st.sampled_from([1, 7, 17])
_TIMES = {"probability": 0.5, "duration": 0.004}
_FAULTS = st.one_of(
    st.builds(lambda c: Loss(channel=c, **_TIMES), _CHANNEL),
    st.builds(lambda c: Corruption(channel=c, **_TIMES), _CHANNEL),
    st.builds(lambda c: Delay(channel=c, delay_us=700, **_TIMES), _CHANNEL),
    st.builds(lambda c: Duplicate(channel=c, **_TIMES), _CHANNEL),
    st.builds(lambda c: Babble(channel=c, identifier=0x85, duration=0.002), _CHANNEL),
    st.builds(lambda n: Unplug(channel="can0", node=n), _NODE),
    st.builds(lambda n: Replug(channel="can0", node=n), _NODE),
    st.builds(lambda n: PowerCycle(channel="can0", node=n), _NODE),
    st.just(DriveError(channel="can0", node=1, code=0x8611)),
)
_FRAME = st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans(), st.booleans())
_STEP = st.one_of(
    st.tuples(st.just("cycle"), st.lists(st.integers(-_MOST, _MOST), min_size=8, max_size=8)),
    st.tuples(st.just("word"), st.sampled_from([0x00, *_ON, 0x02, 0x80])),
    st.tuples(st.just("fault"), _FAULTS),
    st.tuples(st.just("frame"), _FRAME),
    st.tuples(st.just("wait"), st.integers(1, 1_200)),
    st.tuples(st.just("statistics"), st.none()),
    st.tuples(st.just("host"), st.booleans()),
    st.tuples(st.just("latency"), st.booleans()),
)
_CYCLES = [("cycle", [10 * axis - 40 for axis in range(8)])]


class Play:
    """The steps on a lab of its own; ``seen`` is all that a bus' user can know."""

    def __init__(self, bench: Bench, *, compiled: bool) -> None:
        self.bench = bench
        self.seen: list[Any] = []
        self.regular = 0
        """times that compiled code had all channels at the end of a cycle"""
        self._word = _ON[-1]
        self._guests: list[can.BusABC] = []
        if not compiled:
            for channel in bench.lab.channels.values():
                channel.planner = None
        bench.configure_all()
        for word in _ON:
            self._word = word
            for _ in range(3):
                self.cycle([0] * 8)

    def cycle(self, torques: list[int]) -> None:
        """A master's millisecond."""
        channels = self.bench.config.fieldbus.channels
        buses = [self.bench.buses[spec.name] for spec in channels]
        sent: list[list[tuple[int, bytes]]] = []
        for spec in channels:
            sent.append([(0x80, b"")])
            for drive in spec.drives:
                data = struct.pack("<Hh", self._word, torques[drive.axis])
                sent[-1].append((0x200 + drive.node_id, data))
        # One way or the other, as it comes: all at once where that goes, or frame by frame.
        if torques[0] % 2 or not self._send_joined(buses, sent):
            for bus, frames in zip(buses, sent, strict=True):
                assert isinstance(bus, LocalBus)
                with suppress(can.CanOperationError):
                    for identifier, data in frames:
                        bus.send_frame(identifier, data)
        self.wait(1000)
        self.regular += all(channel.regular for channel in self.bench.lab.channels.values())

    def _send_joined(self, buses: list[can.BusABC], sent: list[list[tuple[int, bytes]]]) -> bool:
        rows = [
            (0, identifier, len(data), 0, number, int.from_bytes(data, "little"))
            for number, frames in enumerate(sent)
            for identifier, data in frames
        ]
        assert isinstance(buses[0], LocalBus)
        together = buses[0].join(buses)
        assert together is not None
        return together.send_joined(np.array(rows, FRAMES), self.bench.now)

    def wait(self, us: int) -> None:
        self.bench.now += us * 1000
        for bus in (*self.bench.buses.values(), *self._guests):
            assert isinstance(bus, TonusBus)
            self.seen.append(bus.receive_frames(1000).tobytes())
        lab = self.bench.lab
        self.seen.append((lab.next_event_ns(), [drive.statusword() for drive in lab.drives]))

    def step(self, kind: str, value: Any) -> None:
        bench, lab = self.bench, self.bench.lab
        if kind == "cycle":
            self.cycle(value)
        elif kind == "word":
            self._word = value
        elif kind == "fault":
            fault: Fault = value
            lab.inject(fault)
        elif kind == "frame":
            identifier, data, extended, remote = value
            with suppress(can.CanOperationError):
                bench.buses["can0"].send(
                    can.Message(
                        arbitration_id=identifier,
                        is_extended_id=extended,
                        is_remote_frame=remote,
                        data=None if remote else data,
                        dlc=len(data),
                    )
                )
        elif kind == "wait":
            self.wait(value)
        elif kind == "statistics":
            self.seen.append(lab.statistics())
        elif kind == "latency":
            lab.measure_latency(on=value)
        elif value:
            self._guests.append(can.Bus(interface="tonus", channel="can0"))
        elif self._guests:
            self._guests.pop().shutdown()

    def end(self) -> list[Any]:
        for _ in range(5):
            self.cycle([0] * 8)
        plant = self.bench.lab.plant
        self.seen.append(self.bench.lab.statistics())
        for guest in self._guests:
            guest.shutdown()
        return [*self.seen, plant.state.tobytes(), self.bench.lab.samples.values.tobytes()]


def played(steps: list[tuple[str, Any]], *, compiled: bool) -> tuple[list[Any], int]:
    with Bench() as bench:
        play = Play(bench, compiled=compiled)
        for kind, value in steps:
            play.step(kind, value)
        return play.end(), play.regular


@pytest.fixture(scope="module", autouse=True)
def once_without_faults() -> None:
    """Otherwise nothing below says anything."""
    seen, regular = played(_CYCLES * 20, compiled=True)
    assert regular > 20
    others, never = played(_CYCLES * 20, compiled=False)
    assert never == 0
    assert seen == others


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(_STEP, min_size=1, max_size=25))
def test_both_give_the_same(steps: list[tuple[str, Any]]) -> None:
    compiled, _ = played(steps, compiled=True)
    by_object, _ = played(steps, compiled=False)
    for number, (ours, theirs) in enumerate(zip(compiled, by_object, strict=True)):
        assert ours == theirs, f"differs at observation {number}"


def test_latencies_are_measured_without_a_frame_as_an_object() -> None:
    steps = [("latency", True), *_CYCLES * 20]
    ours, regular = played(steps, compiled=True)
    theirs, _ = played(steps, compiled=False)
    assert ours == theirs
    assert regular > 20
    measured = ours[-3]["channels"]["can0"]["latency"]
    assert measured["0x181"]["count"] == measured["0x080"]["count"] == 25


def test_a_set_point_that_is_limited_is_the_drives_own() -> None:
    """Where compiled code may not apply it."""
    steps = [("cycle", [_MOST * 30] * 8), ("cycle", [0] * 8), ("word", 0x06), *_CYCLES * 3]
    ours, regular = played(steps, compiled=True)
    theirs, _ = played(steps, compiled=False)
    assert ours == theirs
    assert regular > 5


def test_a_short_rpdo_is_refused_by_its_drive() -> None:
    steps = [*_CYCLES, ("frame", (0x201, b"\x0f\x00\x01", False, False)), *_CYCLES * 3]
    ours, _ = played(steps, compiled=True)
    theirs, _ = played(steps, compiled=False)
    assert ours == theirs
    assert np.frombuffer(ours[-1], np.int64).size > 0
