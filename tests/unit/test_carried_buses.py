"""Channels of a lab in another process whose frames travel by one connection."""

from __future__ import annotations

import asyncio
import threading
from contextlib import suppress
from pathlib import Path
from statistics import median
from typing import Any

import can
import numpy as np
import pytest
from numpy.typing import NDArray
from unit.served_lab import drain, message, served, until

from tonus.config.schema.faults import FAULT
from tonus.sim.can import packet
from tonus.sim.can.carried import CarriedBuses
from tonus.sim.can.plugin import SocketBus
from tonus.sim.can.wire.inbox import FRAMES
from tonus.sim.lab.engine import Lab

_NAMES = ("can0", "can1", "can2", "can3")
_LIMIT = 1000
Seen = list[tuple[int, int, bytes]]


class _Carried:
    """A client of four channels, and one that listens to each by itself."""

    def __init__(self) -> None:
        self.buses = self._open()
        self.plain = self._open()
        joined = self.buses[0].join(self.buses)
        assert joined is not None
        self.joined = joined
        self.seen: list[Seen] = [[] for _ in _NAMES]
        self.expected: list[Seen] = [[] for _ in _NAMES]

    @staticmethod
    def _open() -> list[SocketBus]:
        buses = [can.Bus(interface="tonus", channel=name) for name in _NAMES]
        found = [bus for bus in buses if isinstance(bus, SocketBus)]
        assert len(found) == len(buses)
        return found

    def take(self) -> None:
        for number, bus in enumerate(self.plain):
            for one in drain(bus):
                stamp_ns = round(one.timestamp * 1e9)
                identifier = one.arbitration_id | packet.ERROR * one.is_error_frame
                self.expected[number].append((stamp_ns, identifier, bytes(one.data)))
        frames = self.joined.receive_joined(_LIMIT)
        if frames is None:
            for number, bus in enumerate(self.buses):
                self._add(bus.receive_frames(_LIMIT), number)
        else:
            for number in range(len(_NAMES)):
                self._add(frames[frames["channel"] == number], number)

    def _add(self, frames: NDArray[np.void], number: int) -> None:
        decoded = packet.decode(frames.tobytes())
        self.seen[number] += [(stamp, each, data) for stamp, each, _, _, data in decoded]

    def close(self) -> None:
        for bus in (*self.buses, *self.plain):
            bus.shutdown()

    async def agreed(self) -> None:
        def done() -> bool:
            self.take()
            return self.joined.agreed

        await until(done)


def _frames(sent_ns: int, *frames: tuple[int, int, bytes]) -> NDArray[np.void]:
    """Channel, identifier and data of each."""
    rows = [
        (sent_ns, identifier, len(data), 0, channel, int.from_bytes(data, "little"))
        for channel, identifier, data in frames
    ]
    return np.array(rows, FRAMES)


def test_all_comes_and_goes_as_on_connections_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through the change from one to the other, too: nodes answer all the while."""

    async def use(lab: Lab) -> None:
        clock, carried = lab.clock, _Carried()
        await asyncio.sleep(0.02)
        for bus in carried.buses:
            bus.send_frame(0, b"\x82\0")  # the boot-up messages cross the agreement
        assert not carried.joined.send_joined(_frames(clock(), (0, 0x100, b"")), clock())
        await carried.agreed()
        times: list[int] = []
        for burst in range(20):
            now = clock()
            times.append(now)
            batch = [(channel, 0x100 + burst, bytes((burst, channel))) for channel in range(4)]
            batch += [(channel, 0x180 + burst, bytes(8)) for channel in (0, 3)]
            assert carried.joined.send_joined(_frames(now, *batch), now)
            carried.buses[burst % 4].send_frame(0x200 + burst, b"\7", now)
            await asyncio.sleep(0.001)
        await until(lambda: _has(carried, 0x200 + 19))
        carried.take()
        # Neither hears itself; what the nodes say both do.
        own = [each for seen in carried.seen for each in seen if 0x100 <= each[1] < 0x300]
        assert not own
        for number in range(4):
            others = [each for each in carried.expected[number] if not 0 < each[1] < 0x300]
            answers = [each for each in others if each[1]]
            assert len(answers) >= 4
            assert carried.seen[number] == answers
            sent = [each for each in carried.expected[number] if 0x100 <= each[1] < 0x180]
            assert [each for _, each, _ in sent] == [0x100 + burst for burst in range(20)]
            assert [data for *_, data in sent] == [bytes((burst, number)) for burst in range(20)]
            late_us = [(stamp - at) / 1000 for (stamp, *_), at in zip(sent, times, strict=True)]
            # A frame of two bytes takes some 65 us, and may wait for one of a node.
            assert min(late_us) > 60
            assert median(late_us) < 350
        carried.close()

    served(tmp_path, monkeypatch, use)


def _has(carried: _Carried, identifier: int) -> bool:
    carried.take()
    return any(each[1] == identifier for seen in carried.expected for each in seen)


def test_the_error_state_is_that_of_the_channel_on_which_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def use(lab: Lab) -> None:
        carried = _Carried()
        await carried.agreed()
        lab.inject(FAULT.validate_python({"kind": "disconnect", "channel": "can2"}))
        now = lab.clock()
        assert carried.joined.send_joined(_frames(now, (2, 0x123, b"")), now)

        def passive() -> bool:
            carried.take()
            return carried.buses[2].state is can.BusState.PASSIVE

        await until(passive)
        others = [carried.buses[number].state for number in (0, 1, 3)]
        assert others == [can.BusState.ACTIVE] * 3
        carried.close()

    served(tmp_path, monkeypatch, use)


@pytest.mark.parametrize("first", [0, 3])
def test_what_was_sent_stays_sent_when_the_connections_close(
    first: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whichever is closed first, and before the lab has read anything."""

    async def use(lab: Lab) -> None:
        carried = _Carried()
        await carried.agreed()
        now = lab.clock()
        batch = [(channel, 0x110, bytes((channel,))) for channel in range(4)]
        assert carried.joined.send_joined(_frames(now, *batch), now)
        carried.buses[2].send_frame(0x111, b"")
        for bus in carried.buses[first:] + carried.buses[:first]:
            bus.shutdown()
        heard: list[set[int]] = [set() for _ in _NAMES]

        def all_heard() -> bool:
            for number, bus in enumerate(carried.plain):
                heard[number] |= {one.arbitration_id for one in drain(bus)}
            return all(0x110 in each for each in heard) and 0x111 in heard[2]

        await until(all_heard)

        await until(lambda: all(_hosts(lab, name) == 1 for name in _NAMES))
        for bus in carried.plain:
            bus.shutdown()

    served(tmp_path, monkeypatch, use)


def test_of_a_connection_that_has_left_nothing_is_sent_any_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def use(lab: Lab) -> None:
        carried = _Carried()
        await carried.agreed()
        carried.take()
        carried.buses[2].shutdown()
        await until(lambda: _hosts(lab, "can2") == 1)
        for burst in range(5):
            now = lab.clock()
            both = [(channel, 0x100 + burst, b"") for channel in (0, 2)]
            assert carried.joined.send_joined(_frames(now, *both), now)
            await asyncio.sleep(0.002)
        await until(lambda: _has(carried, 0x104))
        assert [each[1] for each in carried.expected[0]] == list(range(0x100, 0x105))
        assert carried.expected[2] == []
        carried.close()

    served(tmp_path, monkeypatch, use)


def _hosts(lab: Lab, name: str) -> int:
    return len([port for port in lab.channels[name].ports if port.received is not None])


def test_what_nobody_takes_is_missed_on_its_channel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def use(lab: Lab) -> None:
        carried = _Carried()
        await carried.agreed()

        def missed() -> list[int]:
            for _ in range(10):
                carried.plain[1].send_frame(0x100, b"")
            channels = lab.statistics()["channels"]
            return [channels[name]["missed"] for name in _NAMES]

        await until(lambda: missed()[1] > 20)
        assert missed()[1] > sum(missed()) / 2
        carried.close()

    served(tmp_path, monkeypatch, use)


def test_the_lab_has_each_frame_in_its_order_when_a_queue_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More than a queue takes in a millisecond, while the loop stands."""

    async def use(lab: Lab) -> None:
        carried = _Carried()
        await carried.agreed()
        now, sent = lab.clock(), 0
        with suppress(can.CanOperationError):  # what its socket takes, and no more
            while sent < 1000:
                data = bytes((sent // 64,))
                batch = [(channel, 0x100 + sent % 64, data) for channel in (1, 1, 1, 2)]
                assert carried.joined.send_joined(_frames(now, *batch), now)
                sent += 1
        threading.Event().wait(0.003)
        expected = [(0x100 + number % 64, number // 64) for number in range(sent)]

        def heard(channel: int) -> list[tuple[int, int]]:
            carried.take()
            seen = carried.expected[channel]
            return [(each, data[0]) for _, each, data in seen if 0x100 <= each < 0x140]

        await until(lambda: len(heard(1)) == 3 * sent and len(heard(2)) == sent)
        assert 20 < sent < 1000
        assert heard(2) == expected
        assert heard(1) == [each for each in expected for _ in range(3)]
        assert lab.statistics()["channels"]["can1"]["overflows"] == 0
        carried.close()

    served(tmp_path, monkeypatch, use)


@pytest.mark.parametrize("cut", [0, 2])
def test_a_channel_that_is_full_holds_up_no_other(
    cut: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody acknowledges on it. Until 2026-11-30 the others stood still after 11 ms."""

    async def use(lab: Lab) -> None:
        carried, sent = _Carried(), [0] * len(_NAMES)
        await carried.agreed()
        lab.inject(FAULT.validate_python({"kind": "disconnect", "channel": _NAMES[cut]}))
        for burst in range(200):
            now, frame = lab.clock(), (0x100, bytes((burst, 1)))
            batch = [(number, *frame) for number in range(len(_NAMES))]
            if not carried.joined.send_joined(_frames(now, *batch), now):
                for number, bus in enumerate(carried.buses):
                    with suppress(can.CanOperationError):
                        bus.send_frames([frame], now)
                        sent[number] += 1
            await asyncio.sleep(0.001)
            carried.take()

        def heard(number: int) -> list[int]:
            return [data[0] for _, each, data in carried.expected[number] if each == 0x100]

        others = [number for number in range(len(_NAMES)) if number != cut]
        await until(lambda: (carried.take(), len(heard(others[-1])) == 200)[1])
        assert all(heard(number) == list(range(200)) for number in others)
        assert heard(cut) == []
        assert sent[others[0]] > 100, "each by itself"
        assert sent[cut] < sent[others[0]], "it is told that its own is full"
        carried.close()

    served(tmp_path, monkeypatch, use)


@pytest.mark.parametrize("first", [0, 2])
def test_what_waits_for_a_full_queue_stays_sent_too(
    first: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All connections are closed while the carrier's packets wait for room; the lab goes on."""

    async def use(lab: Lab) -> None:
        carried = _Carried()
        await carried.agreed()
        now, sent = lab.clock(), 0
        with suppress(can.CanOperationError):
            while sent < 1000:
                batch = [(channel, 0x100 + sent % 64, b"") for channel in (1, 1, 1, 2)]
                assert carried.joined.send_joined(_frames(now, *batch), now)
                sent += 1
        for bus in carried.buses[first:] + carried.buses[:first]:
            bus.shutdown()
        heard = [0, 0]

        def all_heard() -> bool:
            for place, number in enumerate((1, 2)):
                found = [one.arbitration_id for one in drain(carried.plain[number])]
                heard[place] += len([each for each in found if 0x100 <= each < 0x140])
            return heard == [3 * sent, sent]

        await until(all_heard)
        await until(lambda: all(_hosts(lab, name) == 1 for name in _NAMES))
        carried.plain[0].send_frame(0x123, b"")
        done = lab.channels["can0"].frames
        await until(lambda: lab.channels["can0"].frames > done)
        for bus in carried.plain:
            bus.shutdown()

    served(tmp_path, monkeypatch, use)


def test_frames_that_no_controller_sends_are_thrown_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def use(lab: Lab) -> None:
        carried = _Carried()
        await carried.agreed()
        now = lab.clock()
        bad = [(0, 0x900, b""), (9, 0x101, b""), (1, packet.WISHES, b"\1"), (2, 0x1FFF_FFFF, b"")]
        for one in bad:
            assert carried.joined.send_joined(_frames(now, one, (3, 0x102, b"")), now)

        def all_heard() -> bool:
            carried.take()
            return [each[1] for each in carried.expected[3]].count(0x102) == len(bad)

        await until(all_heard)
        kinds = {each[1] for seen in carried.expected for each in seen if each[1] < 0x600}
        assert kinds == {0x102}
        carried.close()

    served(tmp_path, monkeypatch, use)


@pytest.mark.parametrize(
    "special",
    [
        {"can_filters": [{"can_id": 1, "can_mask": 1}]},
        {"receive_own_messages": True},
        {"gather_ms": 3},
        {"error_frames": False},
    ],
)
def test_a_bus_that_wants_anything_special_stays_by_itself(
    special: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def use(lab: Lab) -> None:
        del lab
        buses = [can.Bus("can0", "tonus"), can.Bus("can1", "tonus", **special)]
        assert isinstance(buses[0], SocketBus)
        assert buses[0].join(buses) is None
        again = [can.Bus(interface="tonus", channel=name) for name in ("can0", "can1")]
        assert isinstance(again[0], SocketBus)
        assert isinstance(again[0].join(again), CarriedBuses)
        assert again[0].join(again) is None, "it has asked already"
        for bus in (*buses, *again):
            bus.shutdown()
        await asyncio.sleep(0)

    served(tmp_path, monkeypatch, use)


@pytest.mark.parametrize("wishes", [[(3, 0), (3, 1)], [(2, 0), (2, 0)], [(2, 0), (3, 1)]])
def test_without_all_connections_there_is_no_carrier(
    wishes: list[tuple[int, int]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """How many each connection tells of, and which it is."""

    async def use(lab: Lab) -> None:
        buses = [can.Bus(interface="tonus", channel=name) for name in ("can0", "can1")]
        plain = [can.Bus(interface="tonus", channel=name) for name in ("can0", "can1")]
        seen: list[list[int]] = [[], []]
        for bus, (connections, number) in zip(buses, wishes, strict=True):
            assert isinstance(bus, SocketBus)
            bus.send_packed(packet.Wishes(False, 0, connections, number, b"abcd").packed())
        for burst in range(10):
            for bus in plain:
                bus.send(message(0x100 + burst))
            await asyncio.sleep(0.002)

        def all_heard() -> bool:
            for number, bus in enumerate(buses):
                seen[number] += [one.arbitration_id for one in drain(bus)]
            return min(map(len, seen)) >= 10

        await until(all_heard)
        assert seen == [list(range(0x100, 0x10A))] * 2
        assert lab.now_ns
        for bus in (*buses, *plain):
            bus.shutdown()

    served(tmp_path, monkeypatch, use)
