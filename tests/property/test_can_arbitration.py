"""Whatever is sent when, the bus carries one frame at a time and the strongest first."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from tonus.sim.can.wire.channel import Channel
from tonus.sim.can.wire.frame import Frame
from tonus.sim.can.wire.timing import frame_bits

US = 1000
_SENT = st.tuples(
    st.integers(0, 3),  # sender
    st.integers(0, 400),  # us
    st.integers(0, 0x7FF),
    st.binary(max_size=8),
)


def run(sent: list[tuple[int, int, int, bytes]], steps: list[int]) -> list[tuple[int, int, bytes]]:
    """Frames (time, identifier, data) as a listener sees them, with the bus brought forward at
    the times of sending and at ``steps``."""
    channel = Channel("x", 1_000_000, 1000, 0)
    senders = [channel.attach(listens=False) for _ in range(4)]
    listener = channel.attach(listens=True)
    moments = sorted({at for _, at, _, _ in sent} | set(steps) | {100_000})
    for moment in moments:
        channel.run(moment * US)
        for sender, at, identifier, data in sent:
            if at == moment:
                channel.send(senders[sender], Frame(identifier, data), moment * US)
    assert listener.received is not None
    return [(frame.stamp_ns, frame.identifier, frame.data) for frame in listener.received]


@settings(max_examples=150, deadline=None)
@given(st.lists(_SENT, max_size=25), st.lists(st.integers(0, 3000), max_size=10))
def test_the_bus_is_fair_and_indifferent_to_steps(
    sent: list[tuple[int, int, int, bytes]], steps: list[int]
) -> None:
    seen = run(sent, [])
    assert seen == run(sent, steps), "bringing time forward in other steps changed something"
    assert len(seen) == len(sent)
    # By the book: whenever the bus is free, the smallest head of all queues goes.
    queues: list[list[tuple[int, int, bytes]]] = [[] for _ in range(4)]
    for sender, at, identifier, data in sorted(sent, key=lambda item: item[1]):
        queues[sender].append((at * US, identifier, data))
    free = 0
    for stamp, identifier, data in seen:
        start = max(free, min(queue[0][0] for queue in queues if queue))
        heads = [queue for queue in queues if queue and queue[0][0] <= start]
        best = min(queue[0][1] for queue in heads)
        assert identifier == best
        length = frame_bits(identifier, len(data), data) * US
        assert stamp == start + length
        winner = next(q for q in heads if q[0][1] == identifier and q[0][2] == data)
        winner.pop(0)
        free = stamp + 3 * US
