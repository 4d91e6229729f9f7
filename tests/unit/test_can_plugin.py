"""The lab's bus as python-can knows a bus: in this process, and behind a socket."""

from __future__ import annotations

import asyncio
import threading
from itertools import pairwise
from pathlib import Path

import can
import pytest
from lab_bench import Bench
from unit.served_lab import drain, message, served, until

from tonus.config.schema.faults import FAULT
from tonus.sim.can import packet
from tonus.sim.can.plugin import LocalBus, SocketBus
from tonus.sim.lab.engine import Lab


def test_every_kind_of_frame_arrives_as_it_was_sent() -> None:
    sent = [
        message(0x7FF, bytes(range(8))),
        message(0x123),
        message(0x1ABCDEF0, b"\1\2", is_extended_id=True),
        can.Message(arbitration_id=0x321, is_extended_id=False, is_remote_frame=True, dlc=5),
    ]
    with Bench() as bench, can.Bus(interface="tonus", channel="can0") as other:
        assert isinstance(other, LocalBus)
        bench.wait(2)
        drain(other)
        for one in sent:
            bench.buses["can0"].send(one)
            bench.wait(1)
        seen = drain(other)
        assert all(
            a.equals(b, timestamp_delta=None, check_channel=False)
            for a, b in zip(sent, seen, strict=True)
        )


def test_ones_own_messages_come_back_when_asked_for_and_say_so() -> None:
    with Bench() as bench:
        bench.wait(2)
        with can.Bus(interface="tonus", channel="can0", receive_own_messages=True) as bus:
            bus.send(message(0x123))
            bench.send("can0", 0x124)
            bench.wait(1)
            assert [(m.arbitration_id, m.is_rx) for m in drain(bus)] == [
                (0x123, False),
                (0x124, True),
            ]
        assert [m.arbitration_id for m in bench.read("can0")][-1:] == [0x123]


def test_filters_hold_back_messages_and_no_error_frame() -> None:
    with Bench() as bench:
        bench.wait(2)
        only = [{"can_id": 0x100, "can_mask": 0x700, "extended": False}]
        with (
            can.Bus(interface="tonus", channel="can0", can_filters=only) as bus,
            can.Bus(interface="tonus", channel="can0", error_frames=False) as deaf,
        ):
            bench.lab.inject(
                FAULT.validate_python({"kind": "corruption", "channel": "can0", "frames": 1})
            )
            for identifier in (0x123, 0x1FF, 0x200):
                bench.send("can0", identifier)
            bench.wait(1)
            seen = drain(bus)
            assert [m.arbitration_id for m in seen if not m.is_error_frame] == [0x123, 0x1FF]
            assert len([m for m in seen if m.is_error_frame]) == 1
            assert not [m for m in drain(deaf) if m.is_error_frame]


def test_a_bounded_receive_queue_misses_the_newest_and_counts() -> None:
    with Bench() as bench, can.Bus(interface="tonus", channel="can0", rx_queue_size=3) as bus:
        bench.wait(2)
        assert len(drain(bus)) == 3
        assert bench.lab.statistics()["channels"]["can0"]["missed"] == 1


def test_another_bit_rate_is_refused() -> None:
    with Bench(), pytest.raises(can.CanInitializationError, match="runs at 1000000 bit/s, not 5"):
        can.Bus(interface="tonus", channel="can0", bitrate=500_000)


@pytest.mark.parametrize(
    "bad",
    [can.Message(is_fd=True, data=bytes(12)), can.Message(is_error_frame=True)],
)
def test_what_classic_can_does_not_carry_is_refused(bad: can.Message) -> None:
    with Bench() as bench, pytest.raises(can.CanOperationError, match="classic"):
        bench.buses["can0"].send(bad)


def test_a_cyclic_message_keeps_the_labs_time() -> None:
    with Bench() as bench, can.Bus(interface="tonus", channel="can0") as bus:
        bench.wait(2)
        bench.read("can0")
        first, second = message(0x80, b"\1"), message(0x80, b"\2")
        task = bus.send_periodic([first, second], 0.010, duration=0.1)
        bench.wait(55)
        seen = bench.read("can0")
        assert [m.data[0] for m in seen] == [1, 2, 1, 2, 1, 2]
        assert [b.timestamp - a.timestamp for a, b in pairwise(seen)] == pytest.approx(
            [0.01] * 5, abs=5e-6
        )
        task.modify_data([message(0x80, b"\3"), message(0x80, b"\4")])
        bench.wait(20)
        assert [m.data[0] for m in bench.read("can0")] == [3, 4]
        bench.wait(100)
        assert len(bench.read("can0")) == 2, "its duration is over"
        task.start()
        bench.wait(25)
        assert len(bench.read("can0")) == 3
        task.stop()
        bench.wait(50)
        assert not bench.read("can0")


def test_a_modifier_counts_in_a_cyclic_message() -> None:
    def count(one: can.Message) -> None:
        one.data[0] += 1

    with Bench() as bench, can.Bus(interface="tonus", channel="can0") as bus:
        bench.wait(2)
        bench.read("can0")
        bus.send_periodic(message(0x80, b"\0"), 0.002, modifier_callback=count)
        bench.wait(9)
        assert [m.data[0] for m in bench.read("can0")] == [1, 2, 3, 4, 5]


# -- behind a socket ---------------------------------------------------------------------------


def test_a_notifier_on_a_loop_hears_all_in_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def use(lab: Lab) -> None:
        seen: list[can.Message] = []
        with can.Bus(interface="tonus", channel="can0", receive_own_messages=True) as bus:
            assert isinstance(bus, SocketBus)
            notifier = can.Notifier(bus, [seen.append], loop=asyncio.get_running_loop())
            bus.send(message(0, b"\x82\0"))
            for number in range(20):
                bus.send(message(0x100 + number, bytes((number,))))
            await until(lambda: len(seen) >= 25)
            notifier.stop()
        own = [m for m in seen if not m.is_rx]
        assert [m.arbitration_id for m in own] == [0, *range(0x100, 0x114)]
        assert {m.arbitration_id for m in seen if m.is_rx} == {0x701, 0x707, 0x711, 0x717}
        stamps = [m.timestamp for m in seen]
        assert stamps == sorted(stamps)
        assert min(b - a for a, b in pairwise(stamps)) >= 47e-6 * 0.999, "one at a time"

    served(tmp_path, monkeypatch, use)


def test_state_and_error_frames_cross_the_socket(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def use(lab: Lab) -> None:
        with can.Bus(interface="tonus", channel="can0") as bus:
            seen: list[can.Message] = []

            def state(wanted: can.BusState) -> bool:
                seen.extend(drain(bus))
                return bus.state is wanted

            await until(lambda: bool(lab.channels["can0"].ports[-1].received is not None))
            assert state(can.BusState.ACTIVE)
            lab.inject(FAULT.validate_python({"kind": "disconnect", "channel": "can0"}))
            bus.send(message(0x123))
            await until(lambda: state(can.BusState.PASSIVE))
            lone = [m for m in seen if m.is_error_frame]
            assert lone
            assert all(m.arbitration_id & 0x020 for m in lone), "not acknowledged"
            lab.inject(FAULT.validate_python({"kind": "clear"}))
            await until(lambda: state(can.BusState.ACTIVE))

    served(tmp_path, monkeypatch, use)


def test_frames_without_messages_are_the_same_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One listener takes frames, few at a time, and now and then a message; the other messages."""

    async def use(lab: Lab) -> None:
        names = ("can0", "can0", "can0")
        sender, plain, quick = (can.Bus(interface="tonus", channel=name) for name in names)
        assert isinstance(sender, SocketBus)
        assert isinstance(quick, SocketBus)
        channel = lab.channels["can0"]
        await until(lambda: sum(port.received is not None for port in channel.ports) >= 3)
        expected: list[tuple[int, int, bytes]] = []
        found: list[tuple[int, int, bytes]] = []
        for burst in range(30):
            for number in range(burst % 7):
                sender.send_frame(0x100 + number, bytes((burst, number)))
            heard: list[can.Message] = []

            def all_heard(wanted: int = burst % 7, heard: list[can.Message] = heard) -> bool:
                heard.extend(drain(plain))
                return len(heard) >= wanted

            await until(all_heard)
            expected += [(round(m.timestamp * 1e9), m.arbitration_id, bytes(m.data)) for m in heard]
            message = quick.recv(0) if burst % 3 == 0 else None
            if message is not None:
                found.append(
                    (round(message.timestamp * 1e9), message.arbitration_id, bytes(message.data))
                )
            while (frames := quick.receive_frames(2)).size:
                assert len(frames) <= 2
                found += [(f[0], f[1], f[4]) for f in packet.decode(frames.tobytes())]
        while (frames := quick.receive_frames(9)).size:
            found += [(f[0], f[1], f[4]) for f in packet.decode(frames.tobytes())]
        assert len(expected) > 80
        assert found == expected
        for bus in (sender, plain, quick):
            bus.shutdown()

    served(tmp_path, monkeypatch, use)


def test_a_lab_that_is_periods_late_puts_every_frame_on_the_wire_in_its_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two channels, several frames a period, nothing read by the lab for five periods."""

    async def use(lab: Lab) -> None:
        loop = asyncio.get_running_loop()
        senders = [can.Bus(interface="tonus", channel=name) for name in ("can0", "can1")]
        listeners = [can.Bus(interface="tonus", channel=name) for name in ("can0", "can1")]
        await until(lambda: all(len(lab.channels[n].ports) >= 2 for n in ("can0", "can1")))
        await asyncio.sleep(0.02)
        sent: dict[tuple[int, int], int] = {}
        start = round(loop.time() * 1e9)
        for period in range(5):
            for number, sender in enumerate(senders):
                assert isinstance(sender, SocketBus)
                at = start + period * 1_000_000 + number * 10_000
                sender.send_frame(0x100 + period, b"", at)
                sender.send_frames([(0x200 + period, b""), (0x300 + period, b"")], at + 300_000)
                for identifier, more in ((0x100, 0), (0x200, 300_000), (0x300, 300_000)):
                    sent[number, identifier + period] = at + more
        threading.Event().wait(0.006)  # the whole loop stands
        found: dict[tuple[int, int], int] = {}

        def all_heard() -> bool:
            for number, bus in enumerate(listeners):
                for heard in drain(bus):
                    found[number, heard.arbitration_id] = round(heard.timestamp * 1e9)
            return len(found) == len(sent)

        await until(all_heard)
        late_us = {key: (found[key] - sent[key]) / 1000 for key in sent}
        # Two frames without data, one behind the other, are over in 100 us.
        assert max(late_us.values()) < 150, late_us
        for bus in (*senders, *listeners):
            bus.shutdown()

    served(tmp_path, monkeypatch, use)


def test_a_filtered_message_does_not_end_a_recv(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def use(lab: Lab) -> None:
        only = [{"can_id": 0x717, "can_mask": 0x7FF}]
        with can.Bus(interface="tonus", channel="can0", can_filters=only) as bus:
            bus.send(message(0, b"\x82\0"))
            heard = await asyncio.to_thread(bus.recv, 10)
            assert heard is not None
            assert heard.arbitration_id == 0x717, "the last of four boot-up messages"
            done = lab.channels["can0"].frames + 5
            bus.send(message(0, b"\x82\0"))
            await until(lambda: lab.channels["can0"].frames >= done)
            await asyncio.sleep(0.01)
            heard = bus.recv(0)
            assert heard is not None
            assert heard.arbitration_id == 0x717

    served(tmp_path, monkeypatch, use)
