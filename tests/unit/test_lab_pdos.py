"""When a node sends its process data: on SYNC, on change, when asked."""

from __future__ import annotations

from itertools import pairwise

import can
import pytest
from lab_bench import Bench

NODE = 17
TPDO = 0x180 + NODE


def setup(bench: Bench, transmission: int, inhibit: int = 0, cob: int = 0x40000000) -> None:
    """The cell's TPDO, and its node operational."""
    steps = (
        (1, 0x80000000 | cob | TPDO, 4),
        (2, transmission, 1),
        (3, inhibit, 2),
        (1, cob | TPDO, 4),
    )
    for sub, value, size in steps:
        assert bench.write("can0", NODE, 0x1800, sub, value, size) == 0
    bench.send("can0", 0, bytes((1, NODE)))
    bench.wait(3)
    bench.read("can0")


def ask(bench: Bench) -> None:
    bench.buses["can0"].send(
        can.Message(arbitration_id=TPDO, is_extended_id=False, is_remote_frame=True, dlc=4)
    )


def data(messages: list[can.Message]) -> list[can.Message]:
    return [m for m in messages if m.arbitration_id == TPDO and not m.is_remote_frame]


@pytest.mark.parametrize("transmission", [1, 253])
def test_a_remote_frame_is_answered(transmission: int) -> None:
    with Bench() as bench:
        setup(bench, transmission, cob=0)
        bench.wait(20)
        assert not data(bench.read("can0")), "nobody asked"
        ask(bench)
        bench.wait(1)
        (answer,) = data(bench.read("can0"))
        assert len(answer.data) == 4


def test_a_remote_frame_is_not_answered_where_it_is_not_allowed() -> None:
    with Bench() as bench:
        setup(bench, 1)
        ask(bench)
        bench.wait(5)
        assert not data(bench.read("can0"))


def test_on_request_is_not_for_what_a_device_receives() -> None:
    with Bench() as bench:
        assert bench.write("can0", 1, 0x1400, 2, 253, 1) == 0x06090030


@pytest.mark.parametrize("inhibit_us", [0, 2500, 10_000])
def test_a_changing_value_is_sent_at_its_inhibit_time(inhibit_us: int) -> None:
    with Bench() as bench:
        setup(bench, 255, inhibit=inhibit_us // 100)
        bench.wait(100)
        stamps = [m.timestamp for m in data(bench.read("can0"))]
        # The cell's noise changes its last digits in nearly every look; a look is 1 ms.
        period = max(inhibit_us, 1000) * 1e-6
        gaps = [b - a for a, b in pairwise(stamps)]
        bits = 20e-6  # by which the stuffing of two frames differs
        assert min(gaps) > period - bits
        assert sorted(gaps)[len(gaps) // 2] == pytest.approx(period, abs=bits)


def test_one_pdos_inhibit_time_holds_no_other_back() -> None:
    with Bench() as bench:
        for number, inhibit in ((0, 5000), (1, 0)):
            identifier = (0x180 + 0x100 * number) + 1
            for sub, value, size in (
                (1, 0xC0000000 | identifier, 4),
                (2, 255, 1),
                (3, inhibit, 2),
                (1, 0x40000000 | identifier, 4),
            ):
                assert bench.write("can0", 1, 0x1800 + number, sub, value, size) == 0
        bench.send("can0", 0, b"\1\1")
        bench.wait(5)
        bench.read("can0")
        bench.send("can0", 0x601, bytes((0x2B, 0x40, 0x60, 0, 6, 0, 0, 0)))
        bench.wait(5)
        seen = [m.arbitration_id for m in bench.read("can0")]
        assert 0x281 in seen
        assert 0x181 not in seen, "half a second has not passed"


def test_a_sync_with_a_counter_is_a_sync() -> None:
    with Bench() as bench:
        setup(bench, 1)
        for counter in range(1, 4):
            bench.send("can0", 0x080, bytes((counter,)))
            bench.wait(1)
        assert len(data(bench.read("can0"))) == 3


def test_a_node_that_is_operational_is_not_started() -> None:
    """The command leads nowhere (CiA 301), and what waits for the next SYNC acts."""
    with Bench() as bench:
        bench.configure_all()
        bench.enable()
        bench.tick(0x07)
        assert all(drive.enabled for drive in bench.lab.drives)
        for spec in bench.config.fieldbus.channels:
            bench.send(spec.name, 0x000, b"\1\0")
            bench.send(spec.name, 0x080)
        bench.wait(20)
        assert not any(drive.enabled for drive in bench.lab.drives)
