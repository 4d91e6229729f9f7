"""Error confinement by the book: what an error costs, who counts it, who falls silent."""

from __future__ import annotations

import numpy as np
import pytest

from tonus.config.schema.faults import Corruption, Duplicate, Loss
from tonus.sim.can.wire.confinement import Counters, ErrorState
from tonus.sim.can.wire.faulty import FaultyChannel
from tonus.sim.can.wire.frame import ERROR, Frame
from tonus.sim.can.wire.frame_faults import FrameFault
from tonus.sim.can.wire.port import Notice, Port
from tonus.sim.can.wire.timing import frame_bits

US = 1000
MS = 1_000_000
BITS = frame_bits(0x123, 2, b"\x55\xaa")


def channel(listeners: int = 1, bitrate: int = 1_000_000) -> tuple[FaultyChannel, list[Port]]:
    made = FaultyChannel("x", bitrate, 32, 0)
    ports = [made.attach(listens=True) for _ in range(1 + listeners)]
    for port in ports:
        port.reports = True
    return made, ports


def frame(identifier: int = 0x123, data: bytes = b"\x55\xaa") -> Frame:
    return Frame(identifier, data)


def corrupt(bus: FaultyChannel, frames: int | None = None, seed: int = 1) -> FrameFault:
    fault = Corruption(kind="corruption", channel="x", frames=frames)
    played = FrameFault(fault, np.random.default_rng(seed))
    bus.add(played)
    return played


def sound(port: Port) -> list[Frame]:
    assert port.received is not None
    return [found for found in port.received if not found.identifier & ERROR]


def reports(port: Port) -> list[Frame]:
    assert port.received is not None
    return [found for found in port.received if found.identifier & ERROR]


def test_a_controller_alone_becomes_passive_and_never_goes_bus_off() -> None:
    bus, (alone,) = channel(listeners=0)
    bus.send(alone, frame(), 0)
    bus.run(16 * (BITS + 20) * US)
    assert alone.errors.transmit == 128
    bus.run(1000 * MS)
    assert (alone.errors.state, alone.errors.transmit) == (ErrorState.PASSIVE, 128)
    assert bus.frames == 0
    assert alone.retransmissions > 5000, "it is still trying"


def test_an_unacknowledged_frame_lasts_to_its_acknowledge_and_an_error_frame() -> None:
    bus, (alone,) = channel(listeners=0)
    bus.send(alone, frame(), 0)
    bus.run((BITS - 8 + 6 + 8 + 3) * US)
    assert alone.errors.transmit == 8
    # Delimiter, end of frame and their place are missing; flag, delimiter and space are there.
    assert bus.busy_ns == (BITS - 8 + 6 + 8 + 3) * US
    bus.run(2 * (BITS - 8 + 6 + 8 + 3) * US)
    assert alone.errors.transmit == 16


def test_a_passive_transmitter_waits_eight_bits_more() -> None:
    bus, (alone,) = channel(listeners=0)
    bus.send(alone, frame(), 0)
    attempt = (BITS - 8 + 6 + 8 + 3) * US
    bus.run(16 * attempt)
    assert alone.retransmissions == 16
    bus.run(16 * attempt + (BITS - 8) * US)
    assert alone.retransmissions == 16, "the seventeenth begins eight bits later"
    bus.run(16 * attempt + BITS * US)
    assert alone.retransmissions == 17


def test_when_somebody_joins_the_waiting_frame_arrives_once() -> None:
    bus, (alone,) = channel(listeners=0)
    bus.send(alone, frame(), 0)
    bus.run(10 * MS)
    listener = bus.attach(listens=True)
    bus.run(20 * MS)
    assert [found.data for found in sound(listener)] == [b"\x55\xaa"]
    assert (alone.errors.state, alone.errors.transmit) == (ErrorState.WARNING, 127)


def test_a_flipped_bit_costs_an_error_frame_and_the_frame_comes_again() -> None:
    bus, (sender, listener, other) = channel(listeners=2)
    corrupt(bus, frames=1)
    bus.send(sender, frame(), 0)
    bus.run(MS)
    assert (sender.errors.transmit, sender.retransmissions) == (7, 1), "8 for the error, 1 back"
    assert (listener.errors.receive, other.errors.receive) == (0, 0), "1 for the error, 1 back"
    assert (bus.frames, bus.error_frames) == (1, 1)
    arrived = sound(listener)
    assert len(arrived) == 1
    lost_us = arrived[0].stamp_ns / US - BITS
    # A bit at least and the frame at most, then 6 to 12 bits of flags, 8 and 3.
    assert 1 + 6 + 8 + 3 <= lost_us <= BITS + 12 + 8 + 3
    assert bus.busy_ns == (lost_us + BITS + 3) * US


def test_an_error_is_reported_to_hosts_as_socketcan_does() -> None:
    bus, (sender, listener) = channel()
    corrupt(bus, frames=1)
    bus.send(sender, frame(), 0)
    bus.run(MS)
    (seen,) = reports(listener)
    assert seen.identifier & 0x1FFFFFFF == 0x008 | 0x080 | 0x200, "protocol, bus error, counters"
    assert (seen.data[2], seen.data[6], seen.data[7]) == (0x04, 0, 1), "stuffing; counters"
    (own,) = reports(sender)
    assert (own.data[2], own.data[6], own.data[7]) == (0x81, 8, 0), "a bit, while sending"


def test_after_thirty_two_errors_in_a_row_the_sender_is_off() -> None:
    bus, (sender, listener) = channel()
    heard: list[tuple[Notice, int]] = []
    device = bus.attach(listens=False)
    device.told = lambda notice, now_ns: heard.append((notice, now_ns))
    fault = corrupt(bus)
    bus.send(device, frame(), 0)
    while not device.errors.off:
        assert bus.next_ns() < 100 * MS
        bus.run(bus.next_ns() + 1)
        if bus.wide_ns < 1 << 62:
            bus.deliver()
    assert device.retransmissions == 32
    assert [notice for notice, _ in heard] == [Notice.PASSIVE, Notice.BUS_OFF]
    assert listener.errors.receive == 32
    assert sender.errors.state is ErrorState.ACTIVE
    # Eleven recessive bits 128 times, counted from the end of the error frame.
    bus.remove(fault)
    back = bus.next_ns()
    assert back - heard[-1][1] >= 128 * 11 * US
    assert back - heard[-1][1] <= (128 * 11 + 12 + 8 + 3) * US
    bus.run(back - 1)
    assert device.errors.off
    bus.run(back)
    assert (device.errors.off, device.errors.transmit, device.errors.receive) == (False, 0, 0)
    bus.deliver()
    assert heard[-1] == (Notice.RECOVERED, back)
    bus.run(back + MS)
    assert len(sound(listener)) == 1, "the frame was kept"


def test_frames_of_others_bring_a_controller_back_sooner_than_they_last() -> None:
    bus, (sender, _) = channel()
    fault = corrupt(bus)
    bus.send(sender, frame(), 0)
    bus.run(5 * MS)
    assert sender.errors.off
    bus.remove(fault)
    now = 5 * MS
    # Back to back, each frame counts once: its end and the space are eleven recessive bits.
    other = bus.attach(listens=False)
    count = 0
    while sender.errors.off:
        bus.send(other, frame(0x100, b""), now)
        now = bus.next_ns() if bus.next_ns() > now else now + US
        bus.run(now)
        count += 1
        assert count < 2000
    assert 100 < bus.frames <= 130


def test_a_controller_that_is_off_counts_the_idle_time_round_a_frame() -> None:
    bus, (sender, _) = channel()
    fault = corrupt(bus)
    bus.send(sender, frame(), 0)
    bus.run(3 * MS)
    assert sender.errors.off
    bus.remove(fault)
    idle = bus.next_ns() - 128 * 11 * US
    other = bus.attach(listens=False)
    start = idle + 700 * US  # 63 times eleven bits
    bus.run(start)
    bus.send(other, frame(), start)
    bus.run(start + (BITS + 3) * US)
    # One for the end of the frame; 64 are left.
    assert bus.next_ns() == start + (BITS + 3 + 64 * 11) * US


def test_an_error_passive_receiver_is_active_again_with_the_next_frame() -> None:
    counters = Counters()
    for _ in range(130):
        counters.receive_failed()
    assert (counters.state, counters.receive) == (ErrorState.PASSIVE, 128)
    counters.received()
    assert 119 <= counters.receive <= 127
    for _ in range(200):
        counters.received()
    assert counters.clean


def test_without_automatic_recovery_a_controller_stays_off() -> None:
    bus = FaultyChannel("x", 1_000_000, 32, 0, recovers=False)
    sender, _ = (bus.attach(listens=True) for _ in range(2))
    fault = corrupt(bus)
    bus.send(sender, frame(), 0)
    bus.run(10 * MS)
    bus.remove(fault)
    bus.run(1000 * MS)
    assert sender.errors.off
    bus.restart(sender)
    assert sender.errors.state is ErrorState.ACTIVE


def test_a_lost_frame_reaches_nobody_and_nobody_learns_of_it() -> None:
    bus, (sender, listener) = channel()
    bus.add(FrameFault(Loss(kind="loss", channel="x", frames=1), np.random.default_rng(1)))
    for _ in range(2):
        bus.send(sender, frame(), 0)
    bus.run(MS)
    assert [found.stamp_ns for found in sound(listener)] == [(2 * BITS + 3) * US]
    assert sender.errors.clean
    assert not reports(sender)


def test_a_doubled_frame_comes_twice_and_no_more() -> None:
    bus, (sender, listener) = channel()
    fault = Duplicate(kind="duplicate", channel="x", identifier=0x123)
    bus.add(FrameFault(fault, np.random.default_rng(1)))
    bus.send(sender, frame(), 0)
    bus.send(sender, frame(0x7), 0)
    bus.run(MS)
    assert [found.identifier for found in sound(listener)] == [0x123, 0x123, 0x7]


def test_a_host_is_told_once_of_a_frame_that_its_controller_sends_twice() -> None:
    """Of another's it receives both."""
    bus, (sender, listener) = channel()
    sender.echo = True
    fault = Duplicate(kind="duplicate", channel="x")
    bus.add(FrameFault(fault, np.random.default_rng(1)))
    bus.send(sender, frame(), 0)
    bus.send(listener, frame(0x124), 0)
    bus.run(MS)
    assert [found.identifier for found in sound(sender)] == [0x123, 0x124, 0x124]
    assert [found.identifier for found in sound(listener)] == [0x123, 0x123]


def test_held_dominant_everybody_is_passive_and_who_was_sending_is_off() -> None:
    bus, (sender, listener) = channel()
    bus.send(sender, frame(), 0)
    bus.run(10 * US)
    bus.jam("dominant", 10 * US)
    bus.send(listener, frame(), 10 * US)
    bus.run(MS)
    # 16 counts of 8 bits after flags and fourteen bits, twice that for the transmitter.
    assert listener.errors.state is ErrorState.PASSIVE
    assert sender.errors.off
    assert bus.frames == 0
    bus.release(2 * MS)
    bus.run(2 * MS + 11 * US)
    assert not sound(sender)
    bus.run(20 * MS)
    assert [len(sound(port)) for port in (sender, listener)] == [1, 1]
    assert sender.errors.clean, "it came back, and only then was the other acknowledged"


def test_held_dominant_from_rest_nobody_goes_off() -> None:
    bus, (sender, listener) = channel()
    bus.jam("dominant", 0)
    for _ in range(40):
        bus.send(sender, frame(), 0)
    bus.run(1000 * MS)
    assert [port.errors.state for port in (sender, listener)] == [ErrorState.PASSIVE] * 2
    assert (sender.errors.transmit, sender.overflows) == (0, 8), "it has not even tried"
    bus.release(1000 * MS)
    bus.run(1010 * MS)
    assert len(sound(listener)) == 32


def test_with_its_wires_touching_a_bus_throws_off_whoever_sends() -> None:
    bus, (sender, listener) = channel()
    bus.jam("recessive", 0)
    bus.send(sender, frame(), 0)
    bus.run(MS)
    assert sender.errors.off
    assert listener.errors.clean
    assert not bus.frames


def test_a_cut_off_host_is_alone_and_its_frames_wait() -> None:
    bus, (host,) = channel(listeners=0)
    devices = [bus.attach(listens=False) for _ in range(2)]
    bus.cut(0)
    host.channel.send(host, frame(), 0)
    for port in devices:
        bus.send(port, frame(0x700 + port.number), 0)
    late = bus.attach(listens=True)
    for wire in (bus, *bus.severed):
        wire.run(10 * MS)
    assert bus.frames == 2, "the devices go on"
    assert host.errors.state is ErrorState.PASSIVE
    assert not sound(host)
    assert late.channel is not bus
    bus.mend(10 * MS)
    bus.run(20 * MS)
    assert not bus.severed
    assert [found.identifier for found in sound(late)] == [0x123]


def test_a_controller_that_is_off_recovers_alone_when_it_is_cut_off_meanwhile() -> None:
    bus, (sender, _) = channel()
    fault = corrupt(bus)
    bus.send(sender, frame(), 0)
    bus.run(3 * MS)
    bus.remove(fault)
    bus.sever(sender, 3 * MS)
    wire = sender.channel
    wire.run(3 * MS + (128 * 11 - 1) * US)
    assert (sender.errors.off, sender.retransmissions) == (True, 32)
    wire.run(10 * MS)
    assert (sender.errors.state, sender.errors.transmit) == (ErrorState.PASSIVE, 128)
    bus.rejoin(sender, 10 * MS)
    assert sender.channel is bus
    bus.run(20 * MS)
    assert bus.frames == 1


def test_switched_off_and_on_a_controller_forgets_what_it_was_sending() -> None:
    bus, (alone,) = channel(listeners=0)
    for _ in range(3):
        bus.send(alone, frame(), 0)
    bus.run(50 * US)
    bus.restart(alone)
    assert (alone.errors.clean, len(alone.queue)) == (True, 0)
    bus.run(10 * MS)
    listener = bus.attach(listens=True)
    bus.send(alone, frame(0x321), 10 * MS)
    bus.run(20 * MS)
    assert [found.identifier for found in sound(listener)] == [0x321]


@pytest.mark.parametrize("bitrate", [125_000, 500_000, 1_000_000])
def test_times_follow_the_bit_rate(bitrate: int) -> None:
    bus, (alone,) = channel(listeners=0, bitrate=bitrate)
    bus.send(alone, frame(), 0)
    bus.run((BITS - 8 + 6 + 8 + 3) * 1_000_000_000 // bitrate)
    assert bus.busy_ns == (BITS - 8 + 6 + 8 + 3) * 1_000_000_000 // bitrate
