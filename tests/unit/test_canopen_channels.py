"""What goes out on all channels at once: joined, or channel by channel, to the same effect; and
what comes in on them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import count

import can
import numpy as np
import pytest
from numpy.typing import NDArray
from unit.fake_can import Tap

from tonus.config import load
from tonus.config.schema.bus import CanopenBus
from tonus.drivers.canopen.channel import Channel
from tonus.drivers.canopen.channels import Batch, Channels
from tonus.drivers.canopen.identifiers import SYNC
from tonus.drivers.canopen.reception import Reception
from tonus.drivers.events import EventLog
from tonus.drivers.fieldbus import RAW_FRAME
from tonus.sim.lab.engine import Lab

_FRAMES = [(0, 0x201, 4), (0, 0x202, 4), (1, 0x203, 2), (3, 0x204, 8)]
_DATA = [b"\1\2\3\4", b"\5\6\7\x88", b"\x99\xff", bytes(range(8))]


class _Bench:
    """Four channels of a lab whose wires are in compiled code, or not."""

    def __init__(self, *, regular: bool, apart: bool = False) -> None:
        """``apart``: buses that cannot be joined."""
        config, scenario = load("config/can.yaml")
        assert isinstance(config.fieldbus, CanopenBus)
        self.now = 0
        self.lab = Lab(config, scenario.lab, seed=1, clock=lambda: self.now)
        for channel in self.lab.channels.values():
            if not regular:
                channel.planner = None
        self.lab.open()
        try:
            names = [each.name for each in config.fieldbus.channels]
            self.listeners = [can.Bus(interface="tonus", channel=name) for name in names]
            buses = [can.Bus(name, "tonus", error_frames=not apart) for name in names]
        finally:
            self.lab.close()
        self.wait(50)
        self.tap, self.events = Tap(), EventLog()
        fieldbus, clock, tap, events = config.fieldbus, lambda: self.now, self.tap, self.events
        reception = Reception(len(buses), 8)
        self.channels = [
            Channel(n, bus, fieldbus, 1000, 3, clock, tap, events, reception)
            for n, bus in enumerate(buses)
        ]
        self.together = Channels(self.channels, clock, tap, reception)

    def close(self) -> None:
        for bus in (*self.listeners, *(channel.bus for channel in self.channels)):
            bus.shutdown()

    def wait(self, ms: int) -> None:
        self.now += ms * 1_000_000
        self.lab.advance(self.now)
        for bus in self.listeners:
            while bus.recv(0) is not None:
                pass

    def heard(self) -> list[list[tuple[float, int, bytes]]]:
        """After a millisecond, by channel."""
        self.now += 1_000_000
        return [
            [
                (message.timestamp, message.arbitration_id, bytes(message.data))
                for message in iter(lambda bus=bus: bus.recv(0), None)
            ]
            for bus in self.listeners
        ]


def _play(*, regular: bool) -> list[object]:
    bench = _Bench(regular=regular)
    batch, seen = Batch(_FRAMES), []
    assert all(channel.regular is regular for channel in bench.lab.channels.values())
    for tick in range(3):
        bench.together.sync(tick)
        batch.fill([bytes(reversed(data)) if tick % 2 else data for data in _DATA])
        bench.together.send(batch)
        seen.append(bench.heard())
    syncs = [(channel.syncs.count, channel.syncs.ticks.tolist()) for channel in bench.channels]
    free = [channel._free_ns for channel in bench.channels]
    bench.close()
    return [seen, bench.tap.seen, syncs, free]


def test_joined_channels_send_what_each_would_send_by_itself() -> None:
    joined, alone = _play(regular=True), _play(regular=False)
    assert joined == alone
    first = joined[0][0]  # type: ignore[index]
    assert [identifier for _, identifier, _ in first[0]] == [SYNC, 0x201, 0x202]
    assert [data for _, _, data in first[3]] == [b"", bytes(range(8))]
    assert [entry[1:] for entry in joined[1][4:8]] == [  # type: ignore[index]
        (channel, identifier, data, True)
        for (channel, identifier, _), data in zip(_FRAMES, _DATA, strict=True)
    ]


def test_a_queue_without_room_keeps_all_back_and_each_channel_tries_by_itself() -> None:
    bench = _Bench(regular=True)
    batch = Batch(_FRAMES)
    batch.fill(_DATA)
    for _ in range(20):
        bench.together.send(batch)
    bench.close()
    names = {event.name for event in bench.events.take()}
    assert names == {"transmit_refused"}
    sent = [entry[1] for entry in bench.tap.seen]
    assert sent.count(3) == 20, "a channel with room has lost nothing"
    assert sent.count(0) == 32


def test_a_host_that_comes_has_nothing_of_what_ended_before_it() -> None:
    """Though the lab has handed it out to nobody yet."""
    bench = _Bench(regular=True)
    message = can.Message(arbitration_id=0x7A0, is_extended_id=False)
    bench.listeners[0].send(message)
    bench.now += 1_000_000
    bench.lab.simulate(bench.now)
    late = bench.lab.channels["can0"].attach(listens=True)
    bench.lab.advance(bench.now)
    assert late.received is not None
    assert len(late.received) == 0
    assert bench.channels[0].bus.recv(0) is not None
    bench.close()


class _Other(can.BusABC):
    """A bus on wires: it takes frames one by one, and keeps their times."""

    def __init__(self) -> None:
        super().__init__(channel="other")
        self.sent_ns: list[int] = []

    def receive_frames(self, limit: int) -> NDArray[np.void]:
        del limit
        return np.zeros(0, RAW_FRAME)

    def send_frame(self, identifier: int, data: bytes, sent_ns: int = 0) -> None:
        del identifier, data
        self.sent_ns.append(sent_ns)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise NotImplementedError


class _InSoftware(_Other):
    """As a lab's process has it."""

    def send_frames(self, frames: Sequence[tuple[int, bytes]], sent_ns: int) -> None:
        self.sent_ns += [sent_ns] * len(frames)


@pytest.mark.parametrize(("kind", "times"), [(_InSoftware, 1), (_Other, 4)])
def test_a_sync_is_of_one_time_on_all_channels_where_the_bus_keeps_to_it(
    kind: type[_Other], times: int
) -> None:
    """On wires it is on its way when it is sent, and the answers are as old as that."""
    config, _ = load("config/can.yaml")
    assert isinstance(config.fieldbus, CanopenBus)
    fieldbus, clock, events = config.fieldbus, count(1_000_000, 7_000).__next__, EventLog()
    buses, reception = [kind() for _ in range(4)], Reception(4, 8)
    channels = [
        Channel(n, bus, fieldbus, 1000, 3, clock, None, events, reception)
        for n, bus in enumerate(buses)
    ]
    together = Channels(channels, clock, None, reception)
    together.sync(0)
    sent_ns = [bus.sent_ns for bus in buses]
    assert [len(each) for each in sent_ns] == [1] * 4
    assert len({each[0] for each in sent_ns}) == times
    assert [channel.syncs.of(0)[1] for channel in channels] == [each[0] for each in sent_ns]
    together.send(Batch(_FRAMES))
    assert len({time for bus in buses for time in bus.sent_ns[1:]}) == (1 if times == 1 else 3)


class _Foreigner:
    """Sends on a channel of the bench what belongs to nobody."""

    def __init__(self, bench: _Bench, channel: int) -> None:
        self._bus = bench.listeners[channel]

    def send(self, identifier: int, data: bytes) -> None:
        self._bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))


@pytest.mark.parametrize("apart", [False, True])
def test_what_comes_in_is_recorded_and_handled_channel_by_channel(apart: bool) -> None:
    bench = _Bench(regular=True, apart=apart)
    bench.together.drain()
    bench.tap.seen.clear()
    handled: list[tuple[int, bytes]] = []
    for number, channel in enumerate(bench.channels):
        channel.handlers[0x7A0] = lambda data, number=number: handled.append((number, data))  # type: ignore[misc]
    for number in (3, 0, 2):
        for identifier in (0x7A0, 0x7A1):
            _Foreigner(bench, number).send(identifier, bytes([number, identifier & 0xF]))
    bench.now += 1_000_000
    bench.events.take()
    bench.together.drain()
    bench.close()
    seen = [(channel, identifier, data) for _, channel, identifier, data, _ in bench.tap.seen]
    assert seen == [(n, 0x7A0 + i, bytes([n, i])) for n in (0, 2, 3) for i in (0, 1)]
    assert all(0 < stamp < bench.now for stamp, *_ in bench.tap.seen)
    assert handled == [(n, bytes([n, 0])) for n in (0, 2, 3)]
    where = {event.where for event in bench.events.take()}
    assert where == {f"{bench.channels[n].name}/0x7A1" for n in (0, 2, 3)}


def test_a_channel_that_cannot_be_received_from_keeps_no_other_back() -> None:
    bench = _Bench(regular=True, apart=True)
    bench.together.drain()
    bench.events.take()
    handled: list[bytes] = []
    bench.channels[2].handlers[0x7A0] = handled.append
    for tick, deaf in enumerate((True, True, False, True)):
        _Foreigner(bench, 2).send(0x7A0, bytes([tick]))
        bench.now += 1_000_000
        frames = bench.channels[1]._frames
        bench.channels[1]._frames = _Deaf() if deaf else frames  # type: ignore[assignment]
        bench.together.drain()
        bench.channels[1]._frames = frames
    bench.close()
    assert handled == [b"\0", b"\1", b"\2", b"\3"]
    told = [(event.name, event.where) for event in bench.events.take()]
    assert told == [("bus_deaf", bench.channels[1].name)] * 2, "once an episode"


class _Deaf:
    """A bus whose device is gone."""

    def receive_frames(self, limit: int) -> None:
        raise can.CanOperationError("no such device")


class _Together(_InSoftware):
    """A bus whose like are received from in one call."""

    def __init__(self) -> None:
        super().__init__()
        self.arrived: NDArray[np.void] | Exception | None = None
        self.refusal: Exception | None = None

    def join(self, buses: Sequence[can.BusABC]) -> _Together:
        del buses
        return self

    def receive_joined(self, limit: int) -> NDArray[np.void] | None:
        del limit
        if isinstance(self.arrived, Exception):
            raise self.arrived
        return self.arrived

    def send_joined(self, frames: NDArray[np.void], sent_ns: int) -> bool:
        if self.refusal is not None:
            raise self.refusal
        assert (frames["stamp_ns"] == sent_ns).all()
        return True


class _Joined:
    """Four channels on them."""

    def __init__(self) -> None:
        config, _ = load("config/can.yaml")
        assert isinstance(config.fieldbus, CanopenBus)
        self.fieldbus, self.tap, self.events = config.fieldbus, Tap(), EventLog()
        self.buses = [_Together() for _ in range(4)]
        reception, clock = Reception(4, 8), count(10_000_000, 1000).__next__
        self.channels = [
            Channel(n, bus, self.fieldbus, 1000, 3, clock, self.tap, self.events, reception)
            for n, bus in enumerate(self.buses)
        ]
        self.together = Channels(self.channels, clock, self.tap, reception)

    def receive(self, *counts: int) -> None:
        """So many frames of nobody on each channel."""
        rows = [
            (9_000_000, 0x7A0, 1, 0, number, number)
            for number, of_channel in enumerate(counts)
            for _ in range(of_channel)
        ]
        self.buses[0].arrived = np.array(rows, RAW_FRAME)
        self.together.drain()

    def told(self) -> list[tuple[str, str]]:
        return [(event.name, event.where) for event in self.events.take()]


@pytest.fixture
def joined() -> Iterator[_Joined]:
    made = _Joined()
    yield made
    for bus in made.buses:
        bus.shutdown()


def test_frames_that_come_in_one_call_are_each_of_its_channel(joined: _Joined) -> None:
    handled: list[tuple[int, bytes]] = []
    for number, channel in enumerate(joined.channels):
        channel.handlers[0x7A0] = lambda data, number=number: handled.append((number, data))  # type: ignore[misc]
    joined.receive(2, 0, 1, 0)
    assert handled == [(0, b"\0"), (0, b"\0"), (2, b"\2")]
    assert [entry[:3] for entry in joined.tap.seen] == [
        (9_000_000, number, 0x7A0) for number in (0, 0, 2)
    ]
    joined.together.sync(1)
    # Their stamps are by our clock: an answer is told from what was there before its SYNC.
    assert {channel.syncs.bit_ns for channel in joined.channels} == {1000}
    handled.clear()
    joined.receive()
    joined.buses[0].arrived = None  # each is asked by itself, and has nothing
    joined.together.drain()
    assert handled == []
    assert joined.told() == []


def test_a_flood_is_found_on_its_channel_among_all(joined: _Joined) -> None:
    master = joined.fieldbus.master
    for channel in joined.channels:
        channel.handlers[0x7A0] = lambda _: None
    most = joined.channels[0].frames_per_drain
    for _ in range(master.flood_ticks):
        joined.receive(1, most - 1, most, 0)
    assert joined.told() == [("bus_flooded", joined.channels[2].name)]


def test_a_lab_that_is_gone_is_deaf_on_every_channel_once(joined: _Joined) -> None:
    names = [channel.name for channel in joined.channels]
    for _ in range(3):
        joined.buses[0].arrived = can.CanOperationError("the lab has closed channel can0")
        joined.together.drain()
    assert joined.told() == [("bus_deaf", name) for name in names]
    joined.receive(0, 0, 0, 0)
    joined.buses[0].arrived = can.CanOperationError("again")
    joined.together.drain()
    assert joined.told() == [("bus_deaf", name) for name in names]


def test_what_cannot_go_together_goes_by_itself(joined: _Joined) -> None:
    joined.together.sync(1)
    assert [bus.sent_ns for bus in joined.buses] == [[]] * 4
    joined.buses[0].refusal = can.CanOperationError("the transmit queue of channel can0 is full")
    joined.together.sync(2)
    assert [len(bus.sent_ns) for bus in joined.buses] == [1] * 4
