"""What no controller can put on a wire does not get onto the lab's bus either."""

from __future__ import annotations

import sys

import can
import pytest

from tests.lab_bench import Bench


@pytest.mark.parametrize(
    ("identifier", "length", "data"),
    [
        pytest.param(0x800, 1, b"\1", id="a base identifier of 12 bits"),
        pytest.param(0x20000123, 1, b"\1", id="an identifier that reaches into the flags"),
        pytest.param(-1, 1, b"\1", id="a negative identifier"),
        pytest.param(0x123, 8, b"\1", id="fewer data than its length says"),
    ],
)
def test_a_message_no_controller_can_send_is_refused(
    identifier: int, length: int, data: bytes
) -> None:
    message = can.Message(arbitration_id=identifier, is_extended_id=False, dlc=length, data=data)
    with Bench() as bench, pytest.raises(can.CanOperationError):
        bench.buses["can0"].send(message)


def test_a_bus_forgets_the_identifiers_it_sent() -> None:
    with Bench() as bench:
        bus = bench.buses["can0"]
        before = 0
        for number in range(4000):
            # Eight bytes: the times of short frames are kept, up to a bound.
            bus.send(can.Message(arbitration_id=number, is_extended_id=True, data=bytes(8)))
            bench.wait(0.2)
            before = before or sys.getallocatedblocks()
        bench.lab.tracker.poll(bench.now)
        assert sys.getallocatedblocks() - before < 2000
