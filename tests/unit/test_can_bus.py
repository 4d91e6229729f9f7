"""The timed channel: order, times, queues, load."""

from __future__ import annotations

from tonus.sim.can.wire.channel import NEVER, Channel
from tonus.sim.can.wire.frame import Frame
from tonus.sim.can.wire.timing import frame_bits

US = 1000


def test_a_frame_arrives_at_the_end_of_its_last_bit() -> None:
    channel = Channel("x", 1_000_000, 8, 0)
    sender, receiver = channel.attach(listens=True), channel.attach(listens=True)
    channel.send(sender, Frame(0x123, b"\x55\xaa"), 5 * US)
    end = 5 * US + frame_bits(0x123, 2, b"\x55\xaa") * US
    channel.run(end - 1)
    assert not receiver.received
    channel.run(end)
    assert receiver.received is not None
    assert [frame.stamp_ns for frame in receiver.received] == [end]
    assert not sender.received, "a controller does not hear itself"


def test_three_bits_lie_between_frames() -> None:
    channel = Channel("x", 500_000, 8, 0)
    sender, receiver = channel.attach(listens=False), channel.attach(listens=True)
    for _ in range(3):
        channel.send(sender, Frame(0x080, b""), 0)
    channel.run(NEVER - 1)
    length = frame_bits(0x080, 0, b"")
    assert receiver.received is not None
    stamps = [frame.stamp_ns for frame in receiver.received]
    assert stamps == [(length + n * (length + 3)) * 2 * US for n in range(3)]
    assert channel.busy_ns == 3 * (length + 3) * 2 * US


def test_a_frame_on_the_wire_is_not_interrupted() -> None:
    channel = Channel("x", 1_000_000, 8, 0)
    low, high = channel.attach(listens=False), channel.attach(listens=False)
    receiver = channel.attach(listens=True)
    channel.send(low, Frame(0x700, b"\5"), 0)
    channel.run(1 * US)
    channel.send(high, Frame(0x001, b""), 1 * US)
    channel.run(1000 * US)
    assert receiver.received is not None
    assert [frame.identifier for frame in receiver.received] == [0x700, 0x001]


def test_frames_that_start_together_compete() -> None:
    channel = Channel("x", 1_000_000, 8, 0)
    receiver = channel.attach(listens=True)
    for identifier in (0x300, 0x100, 0x200):
        channel.send(channel.attach(listens=False), Frame(identifier, b""), 0)
        channel.run(0)
    channel.run(1000 * US)
    assert receiver.received is not None
    assert [frame.identifier for frame in receiver.received] == [0x100, 0x200, 0x300]


def test_a_full_queue_refuses_and_counts() -> None:
    channel = Channel("x", 1_000_000, 4, 0)
    sender = channel.attach(listens=False)
    assert [channel.send(sender, Frame(1, b""), 0) for _ in range(6)] == [True] * 4 + [False] * 2
    assert channel.overflows == 2
    channel.run(60 * US)
    assert channel.send(sender, Frame(1, b""), 60 * US), "the first frame has left the queue"


def test_an_answer_waits_its_response_time() -> None:
    channel = Channel("x", 1_000_000, 4, 10 * US)
    device, receiver = channel.attach(listens=False), channel.attach(listens=True)
    channel.answer(device, Frame(0x80, b""), 0)
    channel.run(1000 * US)
    assert receiver.received is not None
    assert next(iter(receiver.received)).stamp_ns == 10 * US + frame_bits(0x80, 0, b"") * US
