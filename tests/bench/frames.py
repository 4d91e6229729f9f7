"""What a frame costs on the lab's bus, beside python-can's own virtual bus."""

from __future__ import annotations

import can

from config import load
from sim.can.timing import frame_bits
from sim.lab import Lab
from tests.bench.measure import Figure, microseconds

RECEIVERS = 9
FRAMES = 2000


def frames() -> list[Figure]:
    """Nine nodes and a master on one channel: frames a second, ours timed to the bit."""
    ours, theirs = _timed(), _untimed()
    data = bytes(range(8))
    bits = microseconds(lambda: frame_bits(0x181, 8, data), repeats=20_000)
    return [
        Figure(
            "a frame sent and received by nine",
            ours,
            "us",
            "python-can virtual",
            theirs,
            "ours has bit timing, stuffing and arbitration",
        ),
        Figure("length of a frame with its stuff bits", bits, "us"),
    ]


def _timed() -> float:
    config, scenario = load("config/can.yaml")
    now = [0]
    lab = Lab(config, scenario.lab, seed=1, clock=lambda: now[0])
    lab.open()
    buses = [can.Bus(interface="tonus", channel="can0") for _ in range(RECEIVERS + 1)]
    message = can.Message(arbitration_id=0x7A0, data=bytes(8), is_extended_id=False)

    def once() -> None:
        buses[0].send(message)
        now[0] += 200_000
        for bus in buses[1:]:
            while bus.recv(timeout=0) is not None:
                pass

    try:
        return microseconds(once, repeats=FRAMES, rounds=3)
    finally:
        for bus in buses:
            bus.shutdown()
        lab.close()


def _untimed() -> float:
    buses = [can.Bus(interface="virtual", channel="bench") for _ in range(RECEIVERS + 1)]
    message = can.Message(arbitration_id=0x7A0, data=bytes(8), is_extended_id=False)

    def once() -> None:
        buses[0].send(message)
        for bus in buses[1:]:
            while bus.recv(timeout=0) is not None:
                pass

    try:
        return microseconds(once, repeats=FRAMES, rounds=3)
    finally:
        for bus in buses:
            bus.shutdown()
